// Light of an object's parts: their own radiance, and what they hide; twin: `TransferTable` of the contract. Joined behind `viewpoints.wgsl` and
// `weights.wgsl`. One thread per number of a part.

struct PartOwn {
    middle_m: vec3f,
    // Of its patches among all.
    first: u32,
    // Radiance of emitters.
    emitted: vec3f,
    count: u32,
}

struct PartShare {
    // Place in λ.
    place: u32,
    share: f32,
}

@group(0) @binding(0) var<uniform> viewpoints: Viewpoints;
@group(0) @binding(1) var<storage, read> present: array<u32>;
@group(0) @binding(2) var<storage, read> over_caps: array<vec4f>;
@group(0) @binding(3) var<storage, read> own: array<PartOwn>;
@group(0) @binding(4) var<storage, read> shares: array<PartShare>;
@group(0) @binding(5) var<storage, read> lambda: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> part_light: array<vec4f>;

const CAPS = 1734u;

@compute @workgroup_size(64)
fn light_parts(@builtin(global_invocation_id) thread: vec3u) {
    if thread.x >= viewpoints.part_count * (1u + CAPS) {
        return;
    }
    let part = own[thread.x / (1u + CAPS)];
    let number = thread.x % (1u + CAPS);
    var sum = vec3f(0.0);
    if number == 0u {
        sum = part.emitted;
        for (var at = part.first; at < part.first + part.count; at++) {
            sum += shares[at].share * lambda[shares[at].place].rgb;
        }
    } else {
        let weighing = weighing_at(part.middle_m);
        for (var viewpoint = 0u; viewpoint < viewpoints.count; viewpoint++) {
            let weight = weight_of(viewpoint, part.middle_m, weighing);
            if weight > 0.0 {
                sum += weight * over_caps[viewpoint * CAPS + number - 1u].rgb;
            }
        }
    }
    part_light[viewpoints.first_light + thread.x] = vec4f(sum, 0.0);
}
