// Depth of the scene as a light sees it; twin: reference.rs. Both sides of every surface block light.

struct Mask {
    // 2×3 map from uv to the base-colour texture's coordinates.
    uv_row0: vec4f,
    uv_row1: vec4f,
    // Base colour's alpha; alpha below `cutoff` lets light through.
    alpha: f32,
    cutoff: f32,
    pad0: f32,
    pad1: f32,
}

@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
@group(1) @binding(0) var<uniform> material: Mask;
@group(1) @binding(1) var base_colour: texture_2d<f32>;
@group(1) @binding(2) var base_sampler: sampler;

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
    @location(1) alpha: f32,
}

@vertex
fn solid(@location(0) position: vec3f) -> @builtin(position) vec4f {
    return clip_from_world * vec4f(position, 1.0);
}

@vertex
fn masked(@location(0) position: vec3f, @location(2) uv: vec2f, @location(3) colour: vec4f) -> Corner {
    let at = vec3f(uv, 1.0);
    let mapped = vec2f(dot(material.uv_row0.xyz, at), dot(material.uv_row1.xyz, at));
    return Corner(clip_from_world * vec4f(position, 1.0), mapped, colour.a * material.alpha);
}

@fragment
fn mask(corner: Corner) {
    let alpha = textureSampleLevel(base_colour, base_sampler, corner.uv, 0.0).a * corner.alpha;
    if alpha < material.cutoff {
        discard;
    }
}
