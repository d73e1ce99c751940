// Nothing walks: stands for `walked.wgsl`.

const WALKED_PIXELS = 1.0;

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

fn walked_at(at: vec2f, by_pixels: u32, surface: Surface, tolerance: f32) -> Walked {
    return Walked(vec3f(0.0), false, 1.0, vec3f(0.0), 0.0);
}
