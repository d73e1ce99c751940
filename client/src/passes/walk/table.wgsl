// Elements and the bricks that hold them; twin: kinds/voxels/table in proto.

struct Voxels {
    // Box of all bricks in ticks: the least, and beyond the greatest.
    low: vec3i,
    // The coarsest level.
    top: u32,
    high: vec3i,
    // Levels above 0 that have elements of surfaces without elements below, a bit each.
    finest: u32,
    // Side of voxels of level 0 in metres.
    voxel_m: f32,
    // Levels that have bricks, a bit each.
    levels: u32,
    // The last slot; all slots are a power of two.
    slot_last: u32,
    // Place of the sky's first part in λ, its parts, and place of their directions behind the glows.
    first_of_sky: u32,
    sky_parts: u32,
    first_direction: u32,
    bricks: u32,
    pad: u32,
}

struct BrickRow {
    cell: vec3i,
    level: u32,
}

struct ElementRow {
    // Octahedral, 2 × 16 bits, x the lower.
    normal: u32,
    // n·(x − m) of its plane in metres, m the middle of its voxel.
    height_m: f32,
    // Sub-voxels that it touches.
    bits: vec2u,
    patch_number: u32,
    marks: u32,
}

@group(0) @binding(0) var<uniform> voxels: Voxels;
// Bricks by hash.
@group(0) @binding(1) var<storage, read> slots: array<u32>;
@group(0) @binding(2) var<storage, read> bricks: array<BrickRow>;
// Of each brick, 16 times: 32 voxels' bits, and the number of their first voxel.
@group(0) @binding(3) var<storage, read> words: array<vec2u>;
@group(0) @binding(4) var<storage, read> first_elements: array<u32>;
@group(0) @binding(5) var<storage, read> elements: array<ElementRow>;
@group(0) @binding(6) var<storage, read> lambda: array<vec4f>;
// Radiance of glows, w being the emitter; then directions of the sky's parts.
@group(0) @binding(7) var<storage, read> glows: array<vec4f>;

const DARK = 0xffffffffu;
const NO_BRICK = 0xffffffffu;
const GLOW_MARK = 0x3fffffffu;
const IS_BACKED = 0x40000000u;
const IS_FINEST = 0x80000000u;
// Binary logarithms of ticks along a voxel of level 0, and along a brick.
const VOXEL_SIZE = 2u;
const BRICK_SIZE = 5u;

// Mixes 32 bits: the finaliser of MurmurHash3.
fn mixed(value: u32) -> u32 {
    let first = (value ^ (value >> 16u)) * 0x85ebca6bu;
    let second = (first ^ (first >> 13u)) * 0xc2b2ae35u;
    return second ^ (second >> 16u);
}

// The brick of a cell on the lattice of a level's bricks.
fn brick_at(level: u32, cell: vec3i) -> u32 {
    if (voxels.levels >> level & 1u) == 0u {
        return NO_BRICK;
    }
    let key = bitcast<vec3u>(cell);
    var slot = mixed(key.x * 0x8da6b343u ^ key.y * 0xd8163841u ^ key.z * 0xcb1ab31fu ^ level * 0x9e3779b9u) & voxels.slot_last;
    // Half of the slots are free, so that one ends it.
    for (var tries = 0u; tries <= voxels.slot_last; tries++) {
        let brick = slots[slot];
        if brick == NO_BRICK {
            return NO_BRICK;
        }
        let row = bricks[brick];
        if row.level == level && all(row.cell == cell) {
            return brick;
        }
        slot = (slot + 1u) & voxels.slot_last;
    }
    return NO_BRICK;
}

// Whether a brick has no voxel in one eighth of it, 0 or 1 along each axis.
fn is_bare(brick: u32, eighth: vec3i) -> bool {
    let columns = select(0xf0f0f0f0u, 0x0f0f0f0fu, eighth.x == 0);
    let first = 16u * brick + u32(8 * eighth.z + eighth.y);
    return ((words[first].x | words[first + 2u].x | words[first + 4u].x | words[first + 6u].x) & columns) == 0u;
}

// How often a voxel that holds nothing can be doubled for a box that holds nothing.
fn bare_around(brick: u32, voxel: vec3i) -> u32 {
    if is_bare(brick, (voxel >> vec3u(2u)) & vec3i(1)) {
        return 2u;
    }
    let even = voxel & vec3i(6);
    let first = 16u * brick + u32(2 * even.z + (even.y >> 2u));
    let square = 0x0303u << u32(even.x + 8 * (even.y & 3));
    return select(0u, 1u, ((words[first].x | words[first + 2u].x) & square) == 0u);
}

// The first element of a voxel in a brick, and the end; none where it holds nothing.
fn elements_at(brick: u32, voxel: vec3i) -> vec2u {
    let at = voxel & vec3i(7);
    let number = u32(at.x + 8 * at.y + 64 * at.z);
    let word = words[16u * brick + (number >> 5u)];
    let bit = 1u << (number & 31u);
    if (word.x & bit) == 0u {
        return vec2u(0u);
    }
    let place = word.y + countOneBits(word.x & (bit - 1u));
    return vec2u(first_elements[place], first_elements[place + 1u]);
}
