// Directions and widths of bundles of walks; twin: kinds/voxels/cones.rs in proto.

const PI = 3.14159265358979;
const EYE_MIN = 0.05;

// The first walks of the R2 sequence, shifted by an identity.
struct Bundle {
    count: u32,
    shift: vec2u,
}

struct Cone {
    direction: vec3f,
    // Tangent of the half angle.
    tangent: f32,
}

// The axes across one.
struct Across {
    x: vec3f,
    y: vec3f,
}

fn bundle(count: u32, identity: u32) -> Bundle {
    let first = mixed(identity ^ 0x6b696c6eu);
    return Bundle(count, vec2u(first, mixed(first ^ 0x9e3779b9u)));
}

// Point of a walk in the unit square.
fn point(walks: Bundle, index: u32) -> vec2f {
    return vec2f((walks.shift + index * vec2u(3242174889u, 2447445413u)) >> vec2u(8u)) * (1.0 / 16777216.0);
}

fn tangent_of(walks: Bundle, pdf: f32) -> f32 {
    let share = PI * f32(walks.count) * pdf;
    return select(1.0, sqrt(1.0 / share), share > 1.0);
}

fn across(axis: vec3f) -> Across {
    let sign = select(1.0, -1.0, axis.z < 0.0);
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    return Across(vec3f(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x), vec3f(b, sign + axis.y * axis.y * a, -axis.y));
}

// Cosine-distributed about a normal.
fn cosine_cone(walks: Bundle, index: u32, normal: vec3f) -> Cone {
    let at = 2.0 * point(walks, index) - 1.0;
    var radius = 0.0;
    var angle = 0.0;
    if abs(at.x) > abs(at.y) {
        radius = at.x;
        angle = 0.25 * PI * (at.y / at.x);
    } else if at.y != 0.0 {
        radius = at.y;
        angle = 0.5 * PI - 0.25 * PI * (at.x / at.y);
    }
    let flat = radius * vec2f(cos(angle), sin(angle));
    let z = sqrt(max(1.0 - dot(flat, flat), 0.0));
    let axes = across(normal);
    return Cone(axes.x * flat.x + axes.y * flat.y + normal * z, tangent_of(walks, z / PI));
}

// Reflected from the eye by a microfacet that the eye sees.
fn reflected_cone(walks: Bundle, index: u32, normal: vec3f, eye: vec3f, alpha: f32) -> Cone {
    let at = point(walks, index);
    let axes = across(normal);
    let seen = normalize(vec3f(dot(axes.x, eye), dot(axes.y, eye), max(dot(normal, eye), EYE_MIN)));
    let stretched = normalize(vec3f(alpha * seen.xy, seen.z));
    let turn = 2.0 * PI * at.x;
    let up = (1.0 - at.y) * (1.0 + stretched.z) - stretched.z;
    let radius = sqrt(max(1.0 - up * up, 0.0));
    let half = vec3f(radius * cos(turn), radius * sin(turn), up) + stretched;
    let sloped = vec3f(alpha * half.xy, max(half.z, 0.0));
    let length2 = dot(sloped, sloped);
    let facet = select(vec3f(0.0, 0.0, 1.0), sloped * inverseSqrt(max(length2, 1e-38)), length2 > 1e-30);
    let local = facet * (2.0 * dot(facet, seen)) - seen;
    let a2 = alpha * alpha;
    let spread = dot(facet.xy, facet.xy) + a2 * facet.z * facet.z;
    let slopes = a2 / (PI * spread * spread);
    let pdf = slopes / (2.0 * (seen.z + sqrt(a2 + (1.0 - a2) * seen.z * seen.z)));
    return Cone(axes.x * local.x + axes.y * local.y + normal * local.z, tangent_of(walks, pdf));
}

// Mirrored above a face where it lies below.
fn above(cone: Cone, face: vec3f) -> Cone {
    return Cone(cone.direction - face * (2.0 * min(dot(cone.direction, face), 0.0)), cone.tangent);
}
