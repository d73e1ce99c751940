// Light of near hits → irradiance at the receivers that have any; twin: reference.rs. One thread per receiver.
// `L = ρ/π·(E_dir(y) + E_emit + E_ind)`: E_dir at the very point, the rest of a texel.

struct Near {
    row_count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
}

struct NearRow {
    slot: u32,
    first: u32,
    count: u32,
    weight: f32,
}

const PI = 3.14159265358979;

@group(0) @binding(0) var<uniform> numbers: Near;
@group(0) @binding(1) var<storage, read> rows: array<NearRow>;
// Slot of the light that is not read at the very point.
@group(0) @binding(2) var<storage, read> slots: array<u32>;
// Of each hit, as is e_dir.
@group(0) @binding(3) var<storage, read> albedo: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_dir: array<vec4f>;
@group(0) @binding(5) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(6) var<storage, read> e_ind: array<vec4f>;
// Of receivers, by slot.
@group(0) @binding(7) var<storage, read_write> e_near: array<vec4f>;

@compute @workgroup_size(64)
fn gather(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.row_count {
        return;
    }
    let row = rows[index];
    var sum = vec3f(0.0);
    for (var hit = row.first; hit < row.first + row.count; hit++) {
        let slot = slots[hit];
        sum += albedo[hit].rgb * (1.0 / PI) * (e_dir[hit].rgb + e_emit[slot].rgb + e_ind[slot].rgb);
    }
    e_near[row.slot] = vec4f(row.weight * sum, 0.0);
}
