// How much E_ind changed since the last call that ran: Σ|E − E before|, Σ|E|; twin: reference.rs. Threads go through the receivers in
// strides, workgroups add up trees, and the last step adds up workgroups.

struct Change {
    receiver_count: u32,
    // Threads of the first step.
    stride: u32,
}

@group(0) @binding(0) var<uniform> change: Change;
@group(0) @binding(1) var<storage, read> e_ind: array<vec4f>;
// E_ind of the last call, which the first step writes.
@group(0) @binding(2) var<storage, read_write> before: array<vec4f>;
// Both sums, by workgroup of the first step.
@group(0) @binding(3) var<storage, read_write> sums: array<vec2f>;
// Both sums.
@group(0) @binding(4) var<storage, read_write> result: array<vec2f>;

var<workgroup> shares: array<vec2f, 64>;

// Adds up the shares of a workgroup.
fn added(thread: u32, share: vec2f) -> vec2f {
    shares[thread] = share;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            shares[thread] += shares[thread + half];
        }
    }
    workgroupBarrier();
    return shares[0];
}

@compute @workgroup_size(64)
fn sum_of_groups(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_index) thread: u32,
    @builtin(workgroup_id) group: vec3u,
) {
    var share = vec2f(0.0);
    for (var slot = id.x; slot < change.receiver_count; slot += change.stride) {
        let now = e_ind[slot].rgb;
        share += vec2f(dot(abs(now - before[slot].rgb), vec3f(1.0)), dot(abs(now), vec3f(1.0)));
        before[slot] = vec4f(now, 0.0);
    }
    let sum = added(thread, share);
    if thread == 0u {
        sums[group.x] = sum;
    }
}

@compute @workgroup_size(64)
fn sum_of_all(@builtin(local_invocation_index) thread: u32) {
    var share = vec2f(0.0);
    for (var group = thread; group < arrayLength(&sums); group += 64u) {
        share += sums[group];
    }
    let sum = added(thread, share);
    if thread == 0u {
        result[0] = sum;
    }
}
