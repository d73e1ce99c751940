// E_dir at points; twin: reference.rs. One thread per point.

struct DirectNumbers {
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
}

@group(1) @binding(0) var<uniform> points: DirectNumbers;
@group(1) @binding(1) var<storage, read> positions: array<vec4f>;
@group(1) @binding(2) var<storage, read> normals: array<vec4f>;
@group(1) @binding(3) var<storage, read_write> e_dir: array<vec4f>;

@compute @workgroup_size(64)
fn direct(@builtin(global_invocation_id) id: vec3u) {
    let r = id.y * points.stride + id.x;
    if r >= points.count {
        return;
    }
    let normal = normals[r].xyz;
    e_dir[r] = vec4f(direct_irradiance(positions[r].xyz, normal, normal), 0.0);
}
