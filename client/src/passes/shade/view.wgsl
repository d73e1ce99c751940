// The camera and the sky's gradient; joined in front of what draws surfaces and of what draws a panorama behind them, which bind
// `view`. Twin: view.rs.

struct ShadeView {
    clip_from_world: mat4x4f,
    // Radiance straight up, then 1 where specular reflection is left out; at the horizon, then 1 where surfaces show irradiance in place
    // of radiance.
    zenith: vec4f,
    horizon: vec4f,
    // World direction through the picture's middle, then 1 where normal maps are left out; its change per unit of ndc x and y.
    ray: vec4f,
    // w of the former: parts of light that walks make, a bit each: 1 reflections, 2 occlusion, 4 irradiance; and 8 times their step in pixels.
    ray_per_x: vec4f,
    // w: side of a pixel in metres where clip w is 1.
    ray_per_y: vec4f,
}

struct SkyCorner {
    @builtin(position) clip: vec4f,
    @location(0) ray: vec3f,
}

// One triangle over the whole picture at infinite distance.
@vertex
fn sky_corner(@builtin(vertex_index) index: u32) -> SkyCorner {
    let ndc = vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    let ray = view.ray.xyz + view.ray_per_x.xyz * ndc.x + view.ray_per_y.xyz * ndc.y;
    return SkyCorner(vec4f(ndc, 0.0, 1.0), ray);
}

// World direction of the view through a point in clip space.
fn ray_to(clip: vec4f) -> vec3f {
    let ndc = clip.xy / clip.w;
    return view.ray.xyz + view.ray_per_x.xyz * ndc.x + view.ray_per_y.xyz * ndc.y;
}

// Radiance of the gradient in a unit direction.
fn gradient(direction: vec3f) -> vec3f {
    return mix(view.horizon.rgb, view.zenith.rgb, clamp(direction.y, 0.0, 1.0));
}
