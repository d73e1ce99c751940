// Walks from the viewpoints of an object through the voxels around it; joined behind the walks and `viewpoints.wgsl`. One thread per walk.

@group(1) @binding(0) var<uniform> viewpoints: Viewpoints;
// Radiance that walks meet, viewpoint after viewpoint; w is 1 of those that end at a back.
@group(1) @binding(1) var<storage, read_write> met: array<vec4f>;
// Directions of walks, and the part of the sphere that each is of.
@group(1) @binding(2) var<uniform> directions: array<vec4f, 256>;

// Share of an emitter for which no points stand.
fn left_of(emitter: f32) -> f32 {
    for (var row = 0u; row < EMITTERS_MAX; row++) {
        let own = viewpoints.pointed[row];
        if own.x == emitter && own.y > 0.0 {
            return 1.0 - own.y;
        }
    }
    return 1.0;
}

@compute @workgroup_size(64)
fn look(@builtin(global_invocation_id) thread: vec3u) {
    if thread.x >= viewpoints.count * viewpoints.walks {
        return;
    }
    let viewpoint = thread.x / viewpoints.walks;
    if (viewpoints.open[viewpoint / 32u] >> (viewpoint % 32u) & 1u) == 0u {
        met[thread.x] = vec4f(0.0, 0.0, 0.0, 1.0);
        return;
    }
    let along = 2.0 * step_of(viewpoint) / vec3f(viewpoints.counts - 1u) - 1.0;
    let own = vec4f(viewpoints.middle_m + viewpoints.half_m * along, 1.0);
    let at = vec3f(dot(viewpoints.rows[0], own), dot(viewpoints.rows[1], own), dot(viewpoints.rows[2], own));
    let local = directions[thread.x % viewpoints.walks].xyz;
    let direction = normalize(vec3f(dot(viewpoints.rows[0].xyz, local), dot(viewpoints.rows[1].xyz, local), dot(viewpoints.rows[2].xyz, local)));
    let hit = walk(at, vec3f(0.0), direction, viewpoints.tangent, FAR);
    let glow = glow_of(hit);
    var seen = reflected(hit, direction);
    if glow != 0u {
        let emitted = glows[glow - 1u];
        seen += left_of(emitted.w) * emitted.rgb;
    }
    met[thread.x] = vec4f(seen, select(0.0, 1.0, hit.element != NOTHING && hit.is_back));
}
