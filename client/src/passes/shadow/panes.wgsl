// Glass as a light sees it: depth of the nearest, and the share of light that passes all of it; twin: reference.rs.
// `glass.wgsl` is joined in front.

struct Pane {
    // 2×3 maps from uv to the textures' coordinates.
    base_row0: vec4f,
    base_row1: vec4f,
    transmission_row0: vec4f,
    transmission_row1: vec4f,
    base_colour: vec4f,
    transmission: f32,
    // 1 where alpha is the share that is there.
    blends: f32,
    // Alpha below it is a hole.
    cutoff: f32,
    pad: f32,
}

@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
@group(1) @binding(0) var<uniform> pane: Pane;
@group(1) @binding(1) var base_colour: texture_2d<f32>;
@group(1) @binding(2) var base_sampler: sampler;
@group(1) @binding(3) var transmission: texture_2d<f32>;
@group(1) @binding(4) var transmission_sampler: sampler;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) base_uv: vec2f,
    @location(1) transmission_uv: vec2f,
    @location(2) colour: vec4f,
}

@vertex
fn corner(@location(0) position: vec3f, @location(2) uv: vec2f, @location(3) colour: vec4f) -> Corner {
    let at = vec3f(uv, 1.0);
    let base_uv = vec2f(dot(pane.base_row0.xyz, at), dot(pane.base_row1.xyz, at));
    let transmission_uv = vec2f(dot(pane.transmission_row0.xyz, at), dot(pane.transmission_row1.xyz, at));
    return Corner(clip_from_world * vec4f(position, 1.0), base_uv, transmission_uv, colour * pane.base_colour);
}

fn stopped_at(corner: Corner) -> f32 {
    let colour = corner.colour * textureSampleLevel(base_colour, base_sampler, corner.base_uv, 0.0);
    if colour.a < pane.cutoff {
        return 0.0;
    }
    let texel = textureSampleLevel(transmission, transmission_sampler, corner.transmission_uv, 0.0).a;
    return stopped(mix(1.0, colour.a, pane.blends), colour.rgb, pane.transmission * texel).share;
}

@fragment
fn depth(corner: Corner) {
    if stopped_at(corner) <= 0.0 {
        discard;
    }
}

@fragment
fn passed(corner: Corner) -> @location(0) vec4f {
    return vec4f(1.0 - stopped_at(corner));
}
