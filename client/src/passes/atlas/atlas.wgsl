// Irradiance of receivers into atlas texels, chart edges extended; twin: reference.rs. One thread per lit texel.

struct AtlasTexel {
    x: u32,
    y: u32,
    // First of its sources.
    first: u32,
    // Page in bits 0-15, number of sources in bits 24-31.
    packed: u32,
    // 1 + links + 16 * edge for a receiver's texel, -1 for a filled one.
    kind: f32,
}

struct Atlas {
    texel_count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
}

@group(0) @binding(0) var<uniform> atlas: Atlas;
@group(0) @binding(1) var<storage, read> texels: array<AtlasTexel>;
@group(0) @binding(2) var<storage, read> sources: array<u32>;
@group(0) @binding(3) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_ind: array<vec4f>;
@group(0) @binding(5) var pages: texture_storage_2d_array<rgba32float, write>;

@compute @workgroup_size(64)
fn spread(@builtin(global_invocation_id) id: vec3u) {
    let index = id.y * atlas.stride + id.x;
    if index >= atlas.texel_count {
        return;
    }
    let texel = texels[index];
    let count = texel.packed >> 24u;
    var sum = vec3f(0.0);
    for (var i = 0u; i < count; i++) {
        let slot = sources[texel.first + i];
        sum += e_emit[slot].rgb + e_ind[slot].rgb;
    }
    textureStore(pages, vec2u(texel.x, texel.y), i32(texel.packed & 0xffffu), vec4f(sum / f32(count), texel.kind));
}
