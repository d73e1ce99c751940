// Irradiance at an object's receivers of what its viewpoints see, mixed by their place. Joined behind `viewpoints.wgsl` and `weights.wgsl`. One thread
// per receiver.

struct MixNumbers {
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    // Words of a receiver's row.
    words: u32,
}

@group(0) @binding(0) var<uniform> viewpoints: Viewpoints;
@group(0) @binding(1) var<storage, read> present: array<u32>;
@group(0) @binding(2) var<uniform> numbers: MixNumbers;
// By slot.
@group(0) @binding(3) var<storage, read> positions: array<vec4f>;
// Radiance of parts of the sphere, viewpoint after viewpoint.
@group(0) @binding(4) var<storage, read> around: array<vec4f>;
// Irradiance by radiance 1 of each part, four parts a word, row after row.
@group(0) @binding(5) var<storage, read> rows: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> e_around: array<vec4f>;

@compute @workgroup_size(64)
fn mix_viewpoints(@builtin(global_invocation_id) thread: vec3u) {
    let slot = thread.y * numbers.stride + thread.x;
    if slot >= numbers.count {
        return;
    }
    let at_m = positions[slot].xyz;
    let weighing = weighing_at(at_m);
    var sum = vec3f(0.0);
    for (var viewpoint = 0u; viewpoint < viewpoints.count; viewpoint++) {
        let weight = weight_of(viewpoint, at_m, weighing);
        if weight > 0.0 {
            for (var word = 0u; word < numbers.words; word++) {
                let row = weight * rows[slot * numbers.words + word];
                let first = viewpoint * viewpoints.parts + 4u * word;
                let last = (viewpoint + 1u) * viewpoints.parts - 1u;
                // Of a part past the last, the last one stands in: its share is 0.
                sum += row.x * around[first].rgb + row.y * around[min(first + 1u, last)].rgb
                    + row.z * around[min(first + 2u, last)].rgb + row.w * around[min(first + 3u, last)].rgb;
            }
        }
    }
    e_around[slot] = vec4f(max(sum, vec3f(0.0)), 0.0);
}
