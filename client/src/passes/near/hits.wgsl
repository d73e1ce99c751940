// Near hits; joined in front of the passes that read them.

struct Near {
    row_count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
}

struct NearRow {
    slot: u32,
    first: u32,
    count: u32,
    weight: f32,
}

struct NearHit {
    position_m: vec3f,
    // Slot of its texel, or OWN_SURFACE and the number of a surface of its own.
    light: u32,
}

struct OwnSurface {
    normal: vec4f,
    albedo: vec4f,
}

const PI = 3.14159265358979;
const OWN_SURFACE = 0x80000000u;

