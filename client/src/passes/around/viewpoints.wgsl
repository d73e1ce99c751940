// Viewpoints of an object, from which its surroundings are looked at; twin: `Viewpoints` of the contract.

struct Viewpoints {
    // Rows of the map from the object's space to the world.
    rows: array<vec4f, 3>,
    middle_m: vec3f,
    count: u32,
    // From the middle to a corner.
    half_m: vec3f,
    // Walks of each.
    walks: u32,
    // Viewpoints along each axis.
    counts: vec3u,
    // Parts of the sphere around.
    parts: u32,
    // A bit of each to which nothing is in the way from the middle.
    open: vec2u,
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

const EMITTERS_MAX = 16u;
// Least share of the way along an axis where those that are nearer see nothing.
const ASIDE = 0.02;
// Least sum of the weights of those that see something; below it the others around count.
const TOTAL_MIN = 1e-3;

// Steps along each axis from the first viewpoint.
fn step_of(viewpoint: u32) -> vec3f {
    let counts = viewpoints.counts;
    return vec3f(vec3u(viewpoint % counts.x, viewpoint / counts.x % counts.y, viewpoint / (counts.x * counts.y)));
}
