// Light of receivers that objects change, before λ is made of it, and light of what is around an object, before it bounces; twin: `settle` of the
// contract. One thread per receiver.

struct FeedNumbers {
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
}

@group(0) @binding(0) var<uniform> numbers: FeedNumbers;
// By slot.
@group(0) @binding(1) var<storage, read> added: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> result: array<vec4f>;
@group(0) @binding(3) var<storage, read> e_emit: array<vec4f>;

// max(E + ΔE, −E_emit): no more is taken from a receiver than it has.
@compute @workgroup_size(64)
fn feed(@builtin(global_invocation_id) thread: vec3u) {
    let slot = thread.y * numbers.stride + thread.x;
    if slot < numbers.count {
        result[slot] = vec4f(max(result[slot].rgb + added[slot].rgb, -e_emit[slot].rgb), 0.0);
    }
}

// E + ΔE; what marks a receiver stays.
@compute @workgroup_size(64)
fn add(@builtin(global_invocation_id) thread: vec3u) {
    let slot = thread.y * numbers.stride + thread.x;
    if slot < numbers.count {
        result[slot] = vec4f(result[slot].rgb + added[slot].rgb, result[slot].w);
    }
}
