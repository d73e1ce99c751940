// Walks through voxels: which element a ray or a narrow cone meets first; twin: kinds/voxels/walk in proto.

const STEPS_MAX = 16384u;
const KAPPA = 0.25;
const TANGENT_MIN = 1e-20;
const STEP_VOXELS = 7.0;

// The end of a walk from where it enters the box of all bricks. `top` is the coarsest level that it looks at.
fn end_of(line: Line, path: Path, entered: Place, first_level: u32, top: u32, first_rise: f32, finest_alone: bool, first_limit: f32) -> Hit {
    var place = entered;
    var level = first_level;
    // Level of the cone's width, and the length at which it rises.
    var wanted = first_level;
    var rise = first_rise;
    var limit = first_limit;
    var met = nothing();
    // The brick that answers for the box around: level that was asked for, that answers, size and cell of the box.
    var held_wanted = NO_BRICK;
    var held_level = 0u;
    var held_size = 0u;
    var held_cell = vec3i(0);
    var held_brick = NO_BRICK;
    // Elements of the voxel around, and sub-voxels that candidates among them touch.
    var in_level = NO_BRICK;
    var in_cell = vec3i(0);
    var in_first = 0u;
    var in_end = 0u;
    var in_bits = vec2u(0u);
    for (var steps = 0u; steps < STEPS_MAX; steps++) {
        if place.t >= limit || !holds(place.tick) {
            return met;
        }
        while wanted < top && place.t >= rise {
            level += select(0u, 1u, level == wanted);
            wanted += 1u;
            rise *= 2.0;
        }
        let tick = place.tick;
        if held_wanted != level || any((tick >> vec3u(held_size)) != held_cell) {
            held_wanted = level;
            held_brick = NO_BRICK;
            held_level = level;
            var found = NO_BRICK;
            loop {
                found = brick_at(held_level, tick >> vec3u(held_level + BRICK_SIZE));
                if found != NO_BRICK || held_level >= top {
                    break;
                }
                held_level += 1u;
            }
            held_size = held_level + BRICK_SIZE;
            if found != NO_BRICK && held_level != level {
                held_size -= 1u;
                if !is_bare(found, (tick >> vec3u(held_size)) & vec3i(1)) {
                    held_brick = found;
                }
            } else {
                held_brick = found;
            }
            held_cell = tick >> vec3u(held_size);
            in_level = NO_BRICK;
        }
        var size = held_size;
        var sub = 64u;
        let side = voxels.voxel_m * f32(1u << held_level);
        let cell = tick >> vec3u(held_level + VOXEL_SIZE);
        let middle = (vec3f(cell) + 0.5) * side;
        if held_brick != NO_BRICK {
            size = held_level + VOXEL_SIZE;
            if in_level != held_level || any(cell != in_cell) {
                in_level = held_level;
                in_cell = cell;
                let all_of = elements_at(held_brick, cell);
                in_first = all_of.x;
                in_end = all_of.y;
                in_bits = vec2u(0u);
                for (var index = in_first; index < in_end; index++) {
                    let row = elements[index];
                    if (!finest_alone || (row.marks & IS_FINEST) != 0u) && candidate(line, row, middle, side).side != 0u {
                        in_bits |= row.bits;
                    }
                }
            }
            if all(in_bits == vec2u(0u)) {
                if in_first == in_end {
                    size += bare_around(held_brick, cell);
                }
            } else {
                let within = (tick >> vec3u(held_level)) & vec3i(3);
                sub = u32(within.x + 4 * within.y + 16 * within.z);
                size = held_level;
            }
        }
        let next = leave(path, place, size);
        if sub < 64u && has(in_bits, sub) {
            var every = Nearest(nothing(), 0.0, false);
            var finest = every;
            var has_finer = false;
            for (var index = in_first; index < in_end; index++) {
                let row = elements[index];
                let is_finest = (row.marks & IS_FINEST) != 0u;
                if !has(row.bits, sub) || (finest_alone && !is_finest) {
                    continue;
                }
                let found = candidate(line, row, middle, side);
                if found.side == 0u || (found.side == 2u && is_beside(line, place.tick, held_level, row, found.t)) {
                    continue;
                }
                let hit = Hit(index, select(row.patch_number, DARK, found.side == 2u), found.t, found.side == 2u);
                every = added(every, hit, place.t, next.t);
                if is_finest {
                    finest = added(finest, hit, place.t, next.t);
                } else {
                    has_finer = true;
                }
            }
            var goes_finer = every.is_mixed && has_finer && held_level > 0u && held_level == held_wanted;
            if goes_finer {
                goes_finer = brick_at(held_level - 1u, tick >> vec3u(held_level - 1u + BRICK_SIZE)) != NO_BRICK;
            }
            if !goes_finer && every.hit.element != NOTHING {
                return nearer(met, every.hit);
            }
            if goes_finer {
                level = held_level - 1u;
                met = nearer(met, finest.hit);
                if met.element != NOTHING {
                    limit = min(limit, met.t);
                }
                continue;
            }
        }
        place = next;
        while level < wanted && any((tick >> vec3u(level + 1u)) != (place.tick >> vec3u(level + 1u))) {
            level += 1u;
        }
    }
    return nearer(met, Hit(NO_ELEMENT, DARK, place.t, false));
}

// End of a walk from a point, on a surface or with normal 0 in free space, along a direction of length 1, of a cone whose half angle has that
// tangent, within a length in metres.
fn walk(at: vec3f, normal: vec3f, direction: vec3f, tangent: f32, reach: f32) -> Hit {
    let line = Line(at + normal * (RAISED * voxels.voxel_m), direction, normal);
    let ticks_per_m = 4.0 / voxels.voxel_m;
    let ascends = direction >= vec3f(0.0);
    let least = select(vec3f(-SPEED_MIN), vec3f(SPEED_MIN), ascends);
    let speed = select(least, direction, abs(direction) >= vec3f(SPEED_MIN)) * ticks_per_m;
    let path = Path(line.begin * ticks_per_m, speed, 1.0 / speed, ascends);
    var place = Place(vec3i(floor(path.start)), 0.0);
    if voxels.bricks == 0u {
        return nothing();
    }
    if !holds(place.tick) {
        let low = (vec3f(voxels.low) - path.start) * path.pace;
        let high = (vec3f(voxels.high) - path.start) * path.pace;
        let nearest = min(low, high);
        let farthest = max(low, high);
        let t = max(max(max(nearest.x, nearest.y), nearest.z), 0.0);
        if t > min(min(farthest.x, farthest.y), farthest.z) {
            return nothing();
        }
        place = Place(clamp(vec3i(floor(path.start + path.speed * t)), voxels.low, voxels.high - 1), t);
    }
    let rise = voxels.voxel_m / (KAPPA * max(tangent, TANGENT_MIN));
    var met = nothing();
    for (var own = 0u; own <= voxels.top; own++) {
        var limit = reach;
        if own > 0u {
            if (voxels.finest >> own & 1u) == 0u {
                continue;
            }
            let scale = f32(1u << own);
            limit = min(min(reach, met.t), 0.5 * scale * rise + STEP_VOXELS * scale * voxels.voxel_m);
        }
        met = nearer(met, end_of(line, path, place, own, select(own, voxels.top, own == 0u), select(FAR, rise, own == 0u), own > 0u, limit));
    }
    if met.t > reach {
        return nothing();
    }
    return met;
}
