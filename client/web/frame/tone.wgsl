// Radiance → film: exposure and tone curve; twin: `Tone::map` in client/src/picture/tone.rs. Film → the screen: sRGB. The film is the mean
// of tone-mapped samples, which keeps the edge of a lamp far above white smooth.

// Factor on radiance; then the curve: 0 linear, 1 by luminance, 2 film-like.
@group(0) @binding(0) var<uniform> exposure_and_curve: vec2f;
// Radiance, or the film.
@group(0) @binding(1) var picture: texture_2d<f32>;

// One triangle over the whole picture.
@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

fn toned(colour: vec3f) -> vec3f {
    if exposure_and_curve.y == 0.0 {
        return colour;
    }
    if exposure_and_curve.y == 1.0 {
        let y = dot(colour, vec3f(0.2126, 0.7152, 0.0722));
        return colour * ((1.0 + y / 16.0) / (1.0 + y));
    }
    return (colour * (2.51 * colour + 0.03)) / (colour * (2.43 * colour + 0.59) + 0.14);
}

fn srgb(linear: vec3f) -> vec3f {
    let bright = 1.055 * pow(linear, vec3f(1.0 / 2.4)) - 0.055;
    return select(bright, 12.92 * linear, linear <= vec3f(0.0031308));
}

@fragment
fn tone(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let found = max(textureLoad(picture, vec2i(floor(at.xy)), 0).rgb, vec3f(0.0));
    return vec4f(clamp(toned(found * exposure_and_curve.x), vec3f(0.0), vec3f(1.0)), 1.0);
}

@fragment
fn show(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return vec4f(srgb(textureLoad(picture, vec2i(floor(at.xy)), 0).rgb), 1.0);
}
