// Samples of radiance → the picture on a screen; twin: reference.rs.

struct Show {
    // Factor on radiance.
    exposure: f32,
    // Curve: 0 none, 1 Reinhard's, 2 filmic.
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

fn mapped(colour: vec3f) -> vec3f {
    if show.tone == 1u {
        let y = dot(colour, vec3f(0.2126, 0.7152, 0.0722));
        return colour * ((1.0 + y / 16.0) / (1.0 + y));
    }
    if show.tone == 2u {
        return (colour * (2.51 * colour + 0.03)) / (colour * (2.43 * colour + 0.59) + 0.14);
    }
    return colour;
}

// One sample, blended into the sum; alpha counts.
@fragment
fn add(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let radiance = max(textureLoad(picture, vec2u(at.xy), 0).rgb, vec3f(0.0));
    return vec4f(clamp(mapped(radiance * show.exposure), vec3f(0.0), vec3f(1.0)), 1.0);
}

fn srgb(linear: vec3f) -> vec3f {
    let low = 12.92 * linear;
    let high = 1.055 * pow(max(linear, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3f(0.0031308));
}

// The mean of the samples as a screen takes it.
@fragment
fn present(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let sum = textureLoad(picture, vec2u(at.xy), 0);
    let mean = clamp(sum.rgb / max(sum.a, 1.0), vec3f(0.0), vec3f(1.0));
    return vec4f(select(mean, srgb(mean), show.encodes == 1u), 1.0);
}
