// Light of receivers from those of higher levels beside them, by their distance; twin: `filled` of the contract. One thread per
// receiver of a level: those that are left out take all of it.

struct Fill {
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    // Level of the receivers.
    level: u32,
}

struct LodView {
    position_m: vec3f,
    // Cosine of the angle to the corners of the picture.
    view_cos: f32,
    forward: vec3f,
    // Factors on distances.
    beside: f32,
    // Where receivers of the levels 0, 1 and 2 begin to go over to their stand-ins, and where they have.
    starts_m: vec3f,
    behind: f32,
    ends_m: vec3f,
    pad: f32,
}

struct StandIn {
    slot: u32,
    cluster: u32,
    // Slots, and past all behind the last.
    sources: array<u32, 4>,
}

const NO_STAND_IN = 0xffffffffu;

@group(0) @binding(0) var<uniform> numbers: Fill;
@group(0) @binding(1) var<uniform> turn: Turn;
@group(0) @binding(2) var<uniform> view: LodView;
@group(0) @binding(3) var<storage, read> details: array<Detail>;
@group(0) @binding(4) var<storage, read> stand_ins: array<StandIn>;
@group(0) @binding(5) var<storage, read> positions: array<vec4f>;
@group(0) @binding(6) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> e_ind: array<vec4f>;

// Factor on the distance of a place at a cosine from the view.
fn zone(cosine: f32) -> f32 {
    if cosine >= view.view_cos {
        return 1.0;
    }
    if cosine >= 0.0 {
        return view.beside + (1.0 - view.beside) * (cosine / view.view_cos);
    }
    return view.beside + (view.behind - view.beside) * -cosine;
}

// Share of the stand-ins in a receiver's light.
fn share_at(place: vec3f) -> f32 {
    let way = place - view.position_m;
    let length_m = length(way);
    let cosine = select(1.0, dot(way, view.forward) / length_m, length_m > 0.0);
    let start = view.starts_m[numbers.level];
    let width = max(view.ends_m[numbers.level] - start, 1e-6);
    let along = clamp((length_m * zone(cosine) - start) / width, 0.0, 1.0);
    return along * along * (3.0 - 2.0 * along);
}

@compute @workgroup_size(64)
fn fill(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.count {
        return;
    }
    let stand_in = stand_ins[index];
    let detail = details[stand_in.cluster];
    if !is_due(detail.interval, stand_in.cluster, turn.bounce) {
        return;
    }
    let slot = stand_in.slot;
    var share = 1.0;
    if detail.level <= numbers.level {
        share = share_at(positions[slot].xyz);
    }
    if share <= 0.0 {
        return;
    }
    var sum = vec3f(0.0);
    var count = 0.0;
    for (var i = 0u; i < 4u && stand_in.sources[i] != NO_STAND_IN; i++) {
        sum += e_ind[stand_in.sources[i]].rgb;
        count += 1.0;
    }
    var light = sum / count;
    if share < 1.0 {
        light = mix(e_ind[slot].rgb, light, share);
    }
    e_ind[slot] = vec4f(max(light, -e_emit[slot].rgb), 0.0);
}
