// A grid of a picture's pixels, for the exposure; twin: reference.rs. One thread per grid point.

struct Meter {
    // Grid points along x and y.
    columns: u32,
    rows: u32,
    // Pixels.
    width: u32,
    height: u32,
}

@group(0) @binding(0) var<uniform> meter: Meter;
@group(0) @binding(1) var radiance: texture_2d<f32>;
@group(0) @binding(2) var<storage, read_write> seen: array<vec4f>;

@compute @workgroup_size(8, 8)
fn gather(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= meter.columns || id.y >= meter.rows {
        return;
    }
    let x = (2u * id.x + 1u) * meter.width / (2u * meter.columns);
    let y = (2u * id.y + 1u) * meter.height / (2u * meter.rows);
    seen[id.y * meter.columns + id.x] = textureLoad(radiance, vec2u(x, y), 0);
}
