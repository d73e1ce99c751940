// The way of a walk: from box to box through faces; twin: kinds/voxels/walk/path.rs in proto.

const SPEED_MIN = 1e-12;

struct Path {
    // In ticks, ticks per metre, metres per tick.
    start: vec3f,
    speed: vec3f,
    pace: vec3f,
    ascends: vec3<bool>,
}

struct Place {
    tick: vec3i,
    t: f32,
}

fn holds(tick: vec3i) -> bool {
    return all(tick >= voxels.low) && all(tick < voxels.high);
}

// The place beyond the box of 2^size ticks around one.
fn leave(path: Path, place: Place, size: u32) -> Place {
    let shift = vec3u(size);
    let cell = place.tick >> shift;
    let planes = (cell + vec3i(path.ascends)) << shift;
    let ends = (vec3f(planes) - path.start) * path.pace;
    let is_y = ends.y <= ends.z;
    let other = select(ends.z, ends.y, is_y);
    let is_x = ends.x <= other;
    let t = max(select(other, ends.x, is_x), place.t);
    let low = cell << shift;
    let on = clamp(vec3i(floor(path.start + path.speed * t)), low, low + vec3i((1 << size) - 1));
    let along = select(min(place.tick, on), max(place.tick, on), path.ascends);
    let across = vec3<bool>(is_x, !is_x && is_y, !is_x && !is_y);
    return Place(select(along, planes - vec3i(!path.ascends), across), t);
}
