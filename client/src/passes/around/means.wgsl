// Means of what walks met: of the parts of the sphere around an object, and over the caps that its parts may hide; twin: `Surroundings` and `Hidden`
// of the contract. Joined behind `viewpoints.wgsl`.

@group(0) @binding(0) var<uniform> viewpoints: Viewpoints;
@group(0) @binding(1) var<storage, read> met: array<vec4f>;
@group(0) @binding(2) var<uniform> directions: array<vec4f, 256>;
// 1 of a viewpoint that sees something.
@group(0) @binding(3) var<storage, read_write> present: array<u32>;
// Radiance of parts of the sphere, viewpoint after viewpoint.
@group(0) @binding(4) var<storage, read_write> around: array<vec4f>;
// Means over caps, viewpoint after viewpoint.
@group(0) @binding(5) var<storage, read_write> over_caps: array<vec4f>;
// Axes of caps; and of each width the cosine.
@group(0) @binding(6) var<uniform> axes: array<vec4f, 295>;

const AXES = 289u;
const WIDTHS = 6u;
const RIM = 0.06;
// Share of walks that end at backs above which a viewpoint lies in geometry.
const BACKS_MAX = 0.25;

// One thread per part of the sphere and viewpoint.
@compute @workgroup_size(64)
fn mean_of_parts(@builtin(global_invocation_id) thread: vec3u) {
    if thread.x >= viewpoints.count * viewpoints.parts {
        return;
    }
    let viewpoint = thread.x / viewpoints.parts;
    let part = thread.x % viewpoints.parts;
    var sum = vec4f(0.0);
    var backs = 0.0;
    for (var index = 0u; index < viewpoints.walks; index++) {
        let own = met[viewpoint * viewpoints.walks + index];
        sum += select(vec4f(0.0), vec4f(own.rgb, 1.0), u32(directions[index].w) == part);
        backs += own.w;
    }
    around[thread.x] = vec4f(sum.rgb / max(sum.w, 1.0), 0.0);
    if part == 0u {
        present[viewpoint] = select(0u, 1u, backs <= BACKS_MAX * f32(viewpoints.walks));
    }
}

// One thread per cap and viewpoint.
@compute @workgroup_size(64)
fn mean_over_caps(@builtin(global_invocation_id) thread: vec3u) {
    if thread.x >= viewpoints.count * WIDTHS * AXES {
        return;
    }
    let viewpoint = thread.x / (WIDTHS * AXES);
    let cap = thread.x % (WIDTHS * AXES);
    let axis = axes[cap % AXES].xyz;
    let cosine = axes[AXES + cap / AXES].x;
    var sum = vec4f(0.0);
    for (var index = 0u; index < viewpoints.walks; index++) {
        let t = clamp((dot(axis, directions[index].xyz) - cosine + RIM) / (2.0 * RIM), 0.0, 1.0);
        sum += t * t * (3.0 - 2.0 * t) * vec4f(met[viewpoint * viewpoints.walks + index].rgb, 1.0);
    }
    over_caps[thread.x] = vec4f(sum.rgb / max(sum.w, 1e-30), 0.0);
}
