// E_r = max(N_r + U_r · b_c, −F_r), or the sum itself; twin: reference.rs. One thread per row of one cluster.

struct Cluster {
    first_row: u32,
    row_count: u32,
    first_support: u32,
    support_count: u32,
    coefficients: u32,
    rank: u32,
    first_b: u32,
    // First element of this cluster's factor in the page's buffer.
    first_factor: u32,
}

struct Reconstruct {
    // Clusters in a row of the dispatch.
    stride: u32,
    cluster_count: u32,
    // Whether there is F; else rows have a sign.
    has_beside: u32,
}

@group(0) @binding(0) var<uniform> reconstruct: Reconstruct;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
// u[r·k + i] of the page's clusters.
@group(0) @binding(2) var<storage, read> u: array<f32>;
@group(0) @binding(3) var<storage, read> b: array<vec4f>;
// N.
@group(0) @binding(4) var<storage, read> start: array<vec4f>;
// F, or anything where there is none.
@group(0) @binding(5) var<storage, read> beside: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> result: array<vec4f>;

@compute @workgroup_size(64)
fn expand(@builtin(global_invocation_id) id: vec3u) {
    let index = id.z * reconstruct.stride + id.y;
    if index >= reconstruct.cluster_count {
        return;
    }
    let cluster = clusters[index];
    if id.x >= cluster.row_count {
        return;
    }
    let first = cluster.first_factor + id.x * cluster.rank;
    let row = cluster.first_row + id.x;
    var sum = start[row].rgb;
    for (var i = 0u; i < cluster.rank; i++) {
        sum += u[first + i] * b[cluster.first_b + i].rgb;
    }
    if reconstruct.has_beside != 0u {
        sum = max(sum, -beside[row].rgb);
    }
    result[row] = vec4f(sum, 0.0);
}
