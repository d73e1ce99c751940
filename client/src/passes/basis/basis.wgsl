// b_c = (ΣVᵀ) λ|_c; twin: reference.rs. One workgroup per row of one cluster's ΣVᵀ.

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

struct Basis {
    // Coefficients per probe in lambda.
    coefficients: u32,
    // Clusters in a row of the dispatch.
    stride: u32,
    cluster_count: u32,
    pad: u32,
}

const THREADS = 64u;

@group(0) @binding(0) var<uniform> basis: Basis;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
@group(0) @binding(2) var<storage, read> support: array<u32>;
@group(0) @binding(3) var<storage, read> vt: array<f32>;
@group(0) @binding(4) var<storage, read> lambda: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> b: array<vec4f>;

var<workgroup> sums: array<vec3f, THREADS>;

@compute @workgroup_size(64)
fn project(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let index = group.z * basis.stride + group.y;
    if index >= basis.cluster_count {
        return;
    }
    let cluster = clusters[index];
    if group.x >= cluster.rank {
        return;
    }
    let columns = cluster.support_count * cluster.coefficients;
    let row = cluster.first_factor + group.x * columns;
    var sum = vec3f(0.0);
    for (var column = thread; column < columns; column += THREADS) {
        let probe = support[cluster.first_support + column / cluster.coefficients];
        let coefficient = column % cluster.coefficients;
        sum += vt[row + column] * lambda[probe * basis.coefficients + coefficient].rgb;
    }
    sums[thread] = sum;
    workgroupBarrier();
    for (var half = THREADS / 2u; half > 0u; half /= 2u) {
        if thread < half {
            sums[thread] += sums[thread + half];
        }
        workgroupBarrier();
    }
    if thread == 0u {
        b[cluster.first_b + group.x] = vec4f(sums[0], 0.0);
    }
}
