// E_ind(r) = max(N(r) + U_r · b_c, −E_emit(r)); twin: reference.rs. One thread per receiver of one cluster.

struct Cluster {
    first_receiver: u32,
    receiver_count: u32,
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
}

@group(0) @binding(0) var<uniform> reconstruct: Reconstruct;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
// u[r·k + i] of the page's clusters.
@group(0) @binding(2) var<storage, read> u: array<f32>;
@group(0) @binding(3) var<storage, read> b: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_emit: array<vec4f>;
// Of near hits.
@group(0) @binding(5) var<storage, read> e_near: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> e_ind: array<vec4f>;

@compute @workgroup_size(64)
fn expand(@builtin(global_invocation_id) id: vec3u) {
    let index = id.z * reconstruct.stride + id.y;
    if index >= reconstruct.cluster_count {
        return;
    }
    let cluster = clusters[index];
    if id.x >= cluster.receiver_count {
        return;
    }
    let row = cluster.first_factor + id.x * cluster.rank;
    let slot = cluster.first_receiver + id.x;
    var sum = e_near[slot].rgb;
    for (var i = 0u; i < cluster.rank; i++) {
        sum += u[row + i] * b[cluster.first_b + i].rgb;
    }
    e_ind[slot] = vec4f(max(sum, -e_emit[slot].rgb), 0.0);
}
