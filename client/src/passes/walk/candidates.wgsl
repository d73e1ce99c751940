// Candidates of a walk: elements that can end it. `octahedral.wgsl` is joined in front. Twin: kinds/voxels/walk/candidates.rs in proto.

// Stands for the element of a walk that was too long, and of one that met nothing.
const NO_ELEMENT = 0xffffffffu;
const NOTHING = 0xfffffffeu;
const FAR = 3.0e38;
const RAISED = 1.0 / 256.0;
const OWN_HEIGHT = 0.02;
const OWN_COSINE = 0.9;
const OWN_FACING = 1.0 / 256.0;
const BESIDE_SUBS = 2.0;
const BESIDE_RISE = 0.1;
const BESIDE_COSINE = 0.9;
const RIM = 1.0 / 2048.0;

struct Line {
    // x, raised off the surface.
    begin: vec3f,
    direction: vec3f,
    // n of the surface that it starts on; 0 in free space.
    normal: vec3f,
}

struct Hit {
    element: u32,
    // Patch, or DARK.
    of_patch: u32,
    t: f32,
    is_back: bool,
}

struct Nearest {
    hit: Hit,
    off: f32,
    is_mixed: bool,
}

// Length to the plane of an element; side 0: it is no candidate, 1: its front, 2: its back.
struct Candidate {
    t: f32,
    side: u32,
}

fn nothing() -> Hit {
    return Hit(NOTHING, DARK, FAR, false);
}

fn candidate(line: Line, row: ElementRow, middle: vec3f, side: f32) -> Candidate {
    let normal = octahedral_of(row.normal);
    let height = dot(normal, line.begin - middle) - row.height_m;
    let facing = dot(normal, line.direction);
    let turn = dot(normal, line.normal);
    let is_own = abs(height) < OWN_HEIGHT * side && abs(turn) > OWN_COSINE;
    // The start's own sheet ends walks where it bends towards them.
    let before = facing < 0.0 && height > -RIM * voxels.voxel_m;
    let is_front = select(before, turn > 0.0 && facing < -OWN_FACING, is_own);
    let is_back = !is_own && (row.marks & IS_BACKED) != 0u && facing > 0.0 && height < 0.0;
    return Candidate(-height / facing, select(select(0u, 1u, is_front), 2u, is_back));
}

fn added(best: Nearest, hit: Hit, begin: f32, end: f32) -> Nearest {
    let off = max(max(begin - hit.t, hit.t - end), 0.0);
    var held = hit;
    held.t = clamp(hit.t, begin, end);
    if best.hit.element == NOTHING {
        return Nearest(held, off, false);
    }
    let is_mixed = best.is_mixed || best.hit.of_patch != hit.of_patch;
    let is_nearer = off < best.off || (off == best.off && held.t < best.hit.t);
    if (best.hit.is_back && !hit.is_back) || (best.hit.is_back == hit.is_back && is_nearer) {
        return Nearest(held, off, is_mixed);
    }
    return Nearest(best.hit, best.off, is_mixed);
}

fn nearer(former: Hit, latter: Hit) -> Hit {
    if latter.element != NOTHING && (former.element == NOTHING || latter.t < former.t) {
        return latter;
    }
    return former;
}

fn has(bits: vec2u, sub: u32) -> bool {
    return (select(bits.x, bits.y, sub >= 32u) >> (sub & 31u) & 1u) == 1u;
}

// The back of an element, whose plane the walk crosses at a length, ends at the start's own sheet: the walk goes by beside it.
fn is_beside(line: Line, at: vec3i, level: u32, row: ElementRow, t: f32) -> bool {
    let normal = octahedral_of(row.normal);
    let sub_m = voxels.voxel_m / 4.0 * f32(1u << level);
    let middle = (vec3f(at >> vec3u(level)) + 0.5) * sub_m;
    let reaches = 0.5 * sub_m * (abs(line.normal.x) + abs(line.normal.y) + abs(line.normal.z));
    // Along the back, away from the sheet.
    let up = line.normal - normal * dot(line.normal, normal);
    let rise = dot(up, up);
    if all(line.normal == vec3f(0.0)) || dot(line.normal, middle - line.begin) > reaches || rise < BESIDE_RISE {
        return false;
    }
    let on = line.begin + line.direction * t + up * (BESIDE_SUBS * sub_m / rise);
    let tick = vec3i(floor(on * (4.0 / voxels.voxel_m)));
    let brick = brick_at(level, tick >> vec3u(level + BRICK_SIZE));
    if brick == NO_BRICK {
        return true;
    }
    let voxel = elements_at(brick, tick >> vec3u(level + VOXEL_SIZE));
    let within = (tick >> vec3u(level)) & vec3i(3);
    for (var index = voxel.x; index < voxel.y; index++) {
        let other = elements[index];
        let is_there = (other.marks & IS_BACKED) != 0u && has(other.bits, u32(within.x + 4 * within.y + 16 * within.z));
        if is_there && dot(octahedral_of(other.normal), normal) > BESIDE_COSINE {
            return false;
        }
    }
    return true;
}
