// Radiance → film: exposure and tone curve; twin: `Tone::map` in client/src/picture/tone.rs. Film → the screen: sRGB. The film is the mean
// of tone-mapped samples, which keeps the edge of a lamp far above white smooth.
// `curve.wgsl` is joined in front.

// Factor on radiance; then the curve of `curved`.
@group(0) @binding(0) var<uniform> exposure_and_curve: vec2f;
// Radiance, or the film.
@group(0) @binding(1) var picture: texture_2d<f32>;

// One triangle over the whole picture.
@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn tone(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let found = max(textureLoad(picture, vec2i(floor(at.xy)), 0).rgb, vec3f(0.0));
    return vec4f(clamp(curved(found * exposure_and_curve.x, u32(exposure_and_curve.y)), vec3f(0.0), vec3f(1.0)), 1.0);
}

@fragment
fn show(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return vec4f(srgb(textureLoad(picture, vec2i(floor(at.xy)), 0).rgb), 1.0);
}
