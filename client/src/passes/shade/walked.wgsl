// Light that walks of pixels found, for shading (passes/walk); joined in front of `shade.wgsl`.

// Reflected radiance and the share that is open, then irradiance; the points, normals and facets that they started at.
@group(2) @binding(1) var walked: texture_2d_array<f32>;
@group(2) @binding(2) var walked_points: texture_2d<f32>;
@group(2) @binding(3) var walked_normals: texture_2d<u32>;

// Pixels' sides by which a walk's start may lie off a plane, and least weight of starts on one.
const WALKED_PIXELS = 1.0;
const WALKED_MIN = 1e-3;

// Light that walks of a point and its neighbours found.
struct Walked {
    reflected: vec3f,
    // Some of them are of surfaces that reflect.
    reflects: bool,
    open: f32,
    irradiance: vec3f,
    // 0 where no neighbour is on its surface.
    weight: f32,
}

// Walks of pixels near one, as far as they start on its surface: on its plane, and facing where it faces.
fn walked_at(at: vec2f, by_pixels: u32, surface: Surface, tolerance: f32) -> Walked {
    let size = vec2i(textureDimensions(walked_points));
    let cells = vec2i(textureDimensions(walked));
    let step = i32(by_pixels);
    let place = floor(at) / f32(step);
    let first = vec2i(floor(place));
    let share = place - vec2f(first);
    var open = 0.0;
    var irradiance = vec3f(0.0);
    var weight = 0.0;
    // Starts on surfaces that reflect nothing know nothing of reflections.
    var reflecting = 0.0;
    var reflected = vec3f(0.0);
    for (var tap = 0; tap < 4; tap++) {
        let across = vec2i(tap & 1, tap >> 1u);
        let cell = min(first + across, cells - 1);
        let by = select(1.0 - share, share, across == vec2i(1));
        let pixel = min(cell * step, size - 1);
        let point = textureLoad(walked_points, pixel, 0);
        if by.x * by.y == 0.0 || point.w < 0.0 {
            continue;
        }
        let off = dot(surface.facet, point.xyz - surface.position) / tolerance;
        let turn = max(dot(octahedral_of(textureLoad(walked_normals, pixel, 0).x), surface.towards), 0.0);
        let turn4 = turn * turn * turn * turn;
        let own = by.x * by.y * turn4 * turn4 * exp(-off * off);
        weight += own;
        let found = textureLoad(walked, cell, 0, 0);
        open += own * found.a;
        if point.w > 0.0 {
            reflecting += own;
            reflected += own * found.rgb;
        }
        if textureNumLayers(walked) > 1u {
            irradiance += own * textureLoad(walked, cell, 1, 0).rgb;
        }
    }
    let scale = 1.0 / max(weight, 1e-30);
    return Walked(reflected / max(reflecting, 1e-30), reflecting > WALKED_MIN, open * scale, irradiance * scale, select(0.0, weight, weight > WALKED_MIN));
}
