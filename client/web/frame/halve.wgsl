// A texture's next coarser level: means of 2 × 2 texels in linear light; edges repeat where a side is odd.

@group(0) @binding(0) var finer: texture_2d<f32>;

// One triangle over the whole level.
@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn halve(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let last = vec2i(textureDimensions(finer)) - 1;
    let first = 2 * vec2i(floor(at.xy));
    var sum = vec4f(0.0);
    for (var tap = 0; tap < 4; tap++) {
        sum += textureLoad(finer, min(first + vec2i(tap & 1, tap >> 1u), last), 0);
    }
    return 0.25 * sum;
}

// The red of a file's numbers for alpha, all else white: textures' alpha is linear, as that channel is.
@fragment
fn red_as_alpha(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return vec4f(1.0, 1.0, 1.0, textureLoad(finer, vec2i(floor(at.xy)), 0).r);
}
