// Irradiance at an object's receivers of what its viewpoints see, mixed by their place. Joined behind `viewpoints.wgsl` and `weights.wgsl`. One thread
// per receiver.

struct MixNumbers {
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    viewpoint: u32,
}

@group(0) @binding(0) var<uniform> viewpoints: Viewpoints;
@group(0) @binding(1) var<storage, read> present: array<u32>;
@group(0) @binding(2) var<uniform> numbers: MixNumbers;
// By slot.
@group(0) @binding(3) var<storage, read> positions: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_seen: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> e_around: array<vec4f>;

@compute @workgroup_size(64)
fn mix_viewpoint(@builtin(global_invocation_id) thread: vec3u) {
    let slot = thread.y * numbers.stride + thread.x;
    if slot >= numbers.count {
        return;
    }
    let before = select(e_around[slot].rgb, vec3f(0.0), numbers.viewpoint == 0u);
    let weight = weight_of(numbers.viewpoint, positions[slot].xyz);
    e_around[slot] = vec4f(before + weight * e_seen[slot].rgb, 0.0);
}
