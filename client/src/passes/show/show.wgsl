// Samples of radiance → the picture on a screen; twin: reference.rs. `curve.wgsl` is joined in front.

struct Show {
    // Factor on radiance.
    exposure: f32,
    // Curve of `curved`.
    tone: u32,
    // 1 where the screen takes sRGB numbers, 0 where it makes them itself.
    encodes: u32,
    pad: u32,
}

@group(0) @binding(0) var<uniform> show: Show;
// Radiance in `add`, the samples' sum in `present`.
@group(0) @binding(1) var picture: texture_2d<f32>;

// One triangle over the whole picture.
@vertex
fn whole(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// One sample, blended into the sum; alpha counts.
@fragment
fn add(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let radiance = max(textureLoad(picture, vec2u(at.xy), 0).rgb, vec3f(0.0));
    return vec4f(clamp(curved(radiance * show.exposure, show.tone), vec3f(0.0), vec3f(1.0)), 1.0);
}

// The mean of the samples as a screen takes it.
@fragment
fn present(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let sum = textureLoad(picture, vec2u(at.xy), 0);
    let mean = clamp(sum.rgb / max(sum.a, 1.0), vec3f(0.0), vec3f(1.0));
    return vec4f(select(mean, srgb(mean), show.encodes == 1u), 1.0);
}
