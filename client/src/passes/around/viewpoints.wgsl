// Viewpoints of an object, from which its surroundings are looked at; twin: `Viewpoints` of the contract.

struct Viewpoints {
    // Rows of the map from the object's space to the world.
    rows: array<vec4f, 3>,
    middle_m: vec3f,
    // 1, the middle; or 8, corners.
    count: u32,
    // From the middle to a corner.
    half_m: vec3f,
    // A bit of each to which nothing is in the way from the middle.
    open: u32,
    walks: u32,
    // Parts of the sphere around.
    parts: u32,
    // Tangent of the half angle of walks.
    tangent: f32,
    // Parts of the volume, and the first number of their light.
    part_count: u32,
    first_light: u32,
    pad0: u32,
    pad1: u32,
    pad2: u32,
    // Emitters, and of each the share for which points stand.
    pointed: array<vec4f, 16>,
}

const VIEWPOINTS_MAX = 8u;
const EMITTERS_MAX = 16u;
// Least share of the way along an axis where those that are nearer see nothing.
const ASIDE = 0.1;

fn corner_of(viewpoint: u32) -> vec3<bool> {
    return (vec3u(viewpoint) >> vec3u(0u, 1u, 2u) & vec3u(1u)) == vec3u(1u);
}
