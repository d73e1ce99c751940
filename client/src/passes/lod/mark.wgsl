// Marks receivers whose light no bounce computes, so that their near hits are not gathered: w of N is 0 for those that are computed.
// One workgroup per cluster.

@group(0) @binding(0) var<uniform> turn: Turn;
@group(0) @binding(1) var<storage, read> details: array<Detail>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> e_near: array<vec4f>;

@compute @workgroup_size(64)
fn mark(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let index = group.y * turn.stride + group.x;
    if index >= turn.cluster_count {
        return;
    }
    let detail = details[index];
    let due = is_due(detail.interval, index, turn.bounce);
    for (var i = thread; i < detail.row_count; i += 64u) {
        e_near[detail.first_row + order[detail.first_row + i]].w = select(1.0, 0.0, due && i < detail.rows);
    }
}
