// How far a device moves corners of triangles: a rectangle in each row of pixels, whose left edge lies a step farther right of
// the pixel's middle than in the row before. Pixels are drawn whose middle the edge was moved to.

// Pixels of the target, and the step as a share of a pixel.
const SIZE = vec2f(8.0, 256.0);
const STEP = 1.0 / 4096.0;

@vertex
fn corner(@builtin(vertex_index) vertex: u32, @builtin(instance_index) row: u32) -> @builtin(position) vec4f {
    let x = select(0.5 + f32(row) * STEP, SIZE.x, (vertex & 1u) == 1u);
    let y = f32(row) + f32(vertex >> 1u);
    return vec4f(2.0 * x / SIZE.x - 1.0, 1.0 - 2.0 * y / SIZE.y, 0.0, 1.0);
}

@fragment
fn seen() -> @location(0) vec4f {
    return vec4f(1.0);
}
