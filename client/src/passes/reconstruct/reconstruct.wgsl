// E_r = max(N_r + U_r · b_c, −F_r), or the sum itself; twin: reference.rs. One thread per four rows of one cluster.

struct Reconstruct {
    // Clusters in a row of the dispatch.
    stride: u32,
    cluster_count: u32,
    // Whether there is F; else rows have a sign.
    has_beside: u32,
    // The page's first among all.
    first_cluster: u32,
}

@group(0) @binding(0) var<uniform> reconstruct: Reconstruct;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
// For each eight ranks, for each row: a group.
@group(0) @binding(2) var<storage, read> u: array<u32>;
@group(0) @binding(3) var<storage, read> b: array<vec4f>;
// N.
@group(0) @binding(4) var<storage, read> start: array<vec4f>;
// F, or anything where there is none.
@group(0) @binding(5) var<storage, read> beside: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> result: array<vec4f>;
@group(0) @binding(7) var<storage, read> details: array<Detail>;
// Rows of each cluster, those first that are computed where others are left out.
@group(0) @binding(8) var<storage, read> order: array<u32>;
@group(0) @binding(9) var<uniform> turn: Turn;

// Rows of a thread: b is read once for all of them.
const ROWS = 4u;
const THREADS = 64u;

var<private> own: array<vec3f, ROWS>;

// Adds eight ranks to a row.
fn add(i: u32, low: vec4f, high: vec4f, of_b: array<vec3f, GROUP>) {
    own[i] += low.x * of_b[0] + low.y * of_b[1] + low.z * of_b[2] + low.w * of_b[3]
        + high.x * of_b[4] + high.y * of_b[5] + high.z * of_b[6] + high.w * of_b[7];
}

// Eight numbers of b.
fn eight(first: u32) -> array<vec3f, GROUP> {
    return array<vec3f, GROUP>(
        b[first].rgb, b[first + 1u].rgb, b[first + 2u].rgb, b[first + 3u].rgb,
        b[first + 4u].rgb, b[first + 5u].rgb, b[first + 6u].rgb, b[first + 7u].rgb,
    );
}

@compute @workgroup_size(64)
fn expand(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let index = group.z * reconstruct.stride + group.y;
    if index >= reconstruct.cluster_count {
        return;
    }
    let cluster = clusters[index];
    let detail = details[reconstruct.first_cluster + index];
    let first = group.x * THREADS * ROWS + thread;
    if group.x * THREADS * ROWS >= detail.rows || !is_due(detail.interval, reconstruct.first_cluster + index, turn.bounce) {
        return;
    }
    let groups = detail.groups;
    // Of a row past the last, the last one stands in; it is not written.
    let last = detail.rows - 1u;
    var at = min(vec4u(first, first + THREADS, first + 2u * THREADS, first + 3u * THREADS), vec4u(last));
    if detail.rows < cluster.row_count {
        at = cluster.first_row + at;
        at = vec4u(order[at.x], order[at.y], order[at.z], order[at.w]);
    }
    for (var of_ranks = 0u; of_ranks < min(groups, cluster.wide); of_ranks++) {
        let of_b = eight(cluster.first_b + of_ranks * GROUP);
        let of_group = cluster.first_word + of_ranks * cluster.row_count * cluster.wide_words;
        for (var i = 0u; i < ROWS; i++) {
            let word = of_group + at[i] * cluster.wide_words;
            if cluster.wide_words == OF_16 {
                let low = of_16(u[word], u[word + 1u]);
                add(i, low, of_16(u[word + 2u], u[word + 3u]), of_b);
            } else {
                let low = bitcast<vec4f>(vec4u(u[word], u[word + 1u], u[word + 2u], u[word + 3u]));
                let high = bitcast<vec4f>(vec4u(u[word + 4u], u[word + 5u], u[word + 6u], u[word + 7u]));
                add(i, low, high, of_b);
            }
        }
    }
    let narrow = cluster.first_word + cluster.wide * cluster.row_count * cluster.wide_words;
    for (var of_ranks = cluster.wide; of_ranks < groups; of_ranks++) {
        let of_b = eight(cluster.first_b + of_ranks * GROUP);
        let of_group = narrow + (of_ranks - cluster.wide) * cluster.row_count * OF_8;
        for (var i = 0u; i < ROWS; i++) {
            let word = of_group + at[i] * OF_8;
            add(i, of_8(u[word]), of_8(u[word + 1u]), of_b);
        }
    }
    for (var i = 0u; i < ROWS; i++) {
        if first + i * THREADS < detail.rows {
            let row = cluster.first_row + at[i];
            var sum = start[row].rgb + own[i];
            if reconstruct.has_beside != 0u {
                sum = max(sum, -beside[row].rgb);
            }
            result[row] = vec4f(sum, 0.0);
        }
    }
}
