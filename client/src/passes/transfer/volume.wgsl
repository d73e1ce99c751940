// Irradiance that objects with volumes change around them, before walls; twin: reference.rs, and `Standing` of the contract.
// Joined behind `shadow_map.wgsl` and with `silhouettes.wgsl`; whoever joins it binds `movers`, `codes` and `part_light`.

struct MoverLevel {
    // First node, nodes before and behind the object, and last node, in metres.
    stops_m: array<vec4f, 3>,
    // Intervals on each side of the object along each axis, and between.
    outer: vec3f,
    // Half side of its cube in metres.
    half_m: f32,
    inner: vec3f,
    nodes: u32,
    first_part: u32,
    part_count: u32,
    first_code: u32,
    pad: u32,
}

struct Mover {
    // Rows of the map from the world to its own space.
    rows: array<vec4f, 3>,
    middle_m: vec3f,
    // Half of its longest side.
    half_side_m: f32,
    // Metres of its own space in one of the world.
    scale: f32,
    // Points of emitters before it.
    points: u32,
    pad1: u32,
    pad2: u32,
    levels: array<MoverLevel, 4>,
}

struct Movers {
    count: u32,
    // Of the lights that stand for what objects see; of their faces, and the layer of these.
    first_light: u32,
    first_face: u32,
    first_layer: u32,
    // First number of light of parts, behind their planes and steps.
    first_of_light: u32,
    // First row of points of emitters, and first face in which one sees an object.
    first_point: u32,
    first_silhouette: u32,
    pad: u32,
    each: array<Mover, 16>,
}

// An object as a point sees it.
struct Changed {
    change: vec3f,
    distance_m: f32,
    towards: vec3f,
    half_angle: f32,
    // Solid angle as a share of half a sphere.
    share: f32,
    is_near: bool,
}

const MOVERS_MAX = 16u;
const TRANSFER_LEVELS = 4u;
const BLEND_FROM = 0.9;
const FADE_H = 10.0;
const REACH_H = 12.0;
const TAU = 6.28318530717959;
// Means over caps: nodes along a side of the unfolded octahedron, widths and their ratio in solid angle, and the narrowest as a share of half a
// sphere.
const HIDDEN_SIDE = 17u;
const HIDDEN_WIDTHS = 6u;
const WIDER = 2.1885;
const NARROWEST = 0.019933422;
// Numbers of light of a part: its radiance, then what it hides. Before all light stand, of each part, unit normal and offset of a plane behind which
// nothing of it is seen, the normal 0 where there is none; then steps of F and of the solid angle. Between both stand points of emitters.
const OF_PART = 1u + HIDDEN_WIDTHS * HIDDEN_SIDE * HIDDEN_SIDE;

// What each object changes, walls aside.
var<private> changes: array<vec3f, MOVERS_MAX>;

fn share_along(low: f32, high: f32, place: f32) -> f32 {
    return select(0.0, clamp((place - low) / (high - low), 0.0, 1.0), high > low);
}

// Number of a node, with its fraction.
fn node_at(stops: vec4f, outer: f32, inner: f32, place: f32) -> f32 {
    if place < stops.y {
        return share_along(stops.x, stops.y, place) * outer;
    }
    if place <= stops.z {
        return outer + share_along(stops.y, stops.z, place) * inner;
    }
    return outer + inner + share_along(stops.z, stops.w, place) * outer;
}

fn signs_of(at: vec2f) -> vec2f {
    return select(vec2f(1.0), vec2f(-1.0), at < vec2f(0.0));
}

// Mean radiance that a part hides over a cap of a solid angle about an axis.
fn hidden(first: u32, axis: vec3f, solid_angle: f32) -> vec3f {
    var width = max(solid_angle / (TAU * NARROWEST), 1.0);
    var narrower = 0u;
    while narrower < HIDDEN_WIDTHS - 2u && width >= WIDER {
        width /= WIDER;
        narrower++;
    }
    let wider = min((width - 1.0) / (WIDER - 1.0), 1.0);
    let on = axis / max(abs(axis.x) + abs(axis.y) + abs(axis.z), 1e-30);
    let flat = select(on.xy, (1.0 - abs(on.yx)) * signs_of(on.xy), on.z < 0.0);
    let at = max((0.5 + 0.5 * flat) * f32(HIDDEN_SIDE - 1u), vec2f(0.0));
    let low = min(floor(at), vec2f(f32(HIDDEN_SIDE - 2u)));
    let share = at - low;
    let node = first + 1u + (narrower * HIDDEN_SIDE + u32(low.y)) * HIDDEN_SIDE + u32(low.x);
    var sum = vec3f(0.0);
    for (var corner = 0u; corner < 8u; corner++) {
        let bits = vec3u(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let weights = select(1.0 - vec3f(share, wider), vec3f(share, wider), bits == vec3u(1u));
        let place = node + (bits.z * HIDDEN_SIDE + bits.y) * HIDDEN_SIDE + bits.x;
        sum += weights.x * weights.y * weights.z * part_light[place].rgb;
    }
    return sum;
}

// What an object changes at a point about a normal, without walls and other objects between.
fn changed_by(index: u32, at_m: vec3f, about: vec3f) -> Changed {
    let row0 = movers.each[index].rows[0];
    let row1 = movers.each[index].rows[1];
    let row2 = movers.each[index].rows[2];
    let scale = movers.each[index].scale;
    let place = vec4f(at_m, 1.0);
    let local = vec3f(dot(row0, place), dot(row1, place), dot(row2, place));
    let normal = vec3f(dot(row0.xyz, about), dot(row1.xyz, about), dot(row2.xyz, about)) / scale;
    let offset = movers.each[index].middle_m - local;
    let far_m = max(max(abs(offset.x), abs(offset.y)), abs(offset.z));
    let t = clamp((far_m / max(movers.each[index].half_side_m, 1e-30) - FADE_H) / (REACH_H - FADE_H), 0.0, 1.0);
    let fade = (2.0 * t - 3.0) * t * t + 1.0;
    var found = Changed(vec3f(0.0), length(offset) / scale, vec3f(0.0), 0.0, 0.0, fade > 0.0);
    var finest = 0u;
    while finest < TRANSFER_LEVELS && far_m >= movers.each[index].levels[finest].half_m {
        finest++;
    }
    if fade <= 0.0 || finest == TRANSFER_LEVELS {
        return found;
    }
    var blend = clamp((far_m / movers.each[index].levels[finest].half_m - BLEND_FROM) / (1.0 - BLEND_FROM), 0.0, 1.0);
    blend = select(blend, 0.0, finest + 1u == TRANSFER_LEVELS);
    var all = vec4f(0.0);
    for (var step = 0u; step < 2u; step++) {
        let weight = select(1.0 - blend, blend, step == 1u);
        if weight <= 0.0 {
            continue;
        }
        let level = movers.each[index].levels[finest + step];
        let at = vec3f(
            node_at(level.stops_m[0], level.outer.x, level.inner.x, local.x),
            node_at(level.stops_m[1], level.outer.y, level.inner.y, local.y),
            node_at(level.stops_m[2], level.outer.z, level.inner.z, local.z),
        );
        let first = clamp(floor(at), vec3f(0.0), vec3f(f32(level.nodes - 2u)));
        let share = at - first;
        let low = vec3u(first);
        for (var part = 0u; part < level.part_count; part++) {
            let row = level.first_part + part;
            let plane = part_light[2u * row];
            if dot(plane.xyz, local) < plane.w {
                continue;
            }
            let own = level.first_code + part * level.nodes * level.nodes * level.nodes;
            var sum = vec4f(0.0);
            for (var corner = 0u; corner < 8u; corner++) {
                let bits = vec3u(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
                let weights = select(1.0 - share, share, bits == vec3u(1u));
                let node = low + bits;
                let code = codes[own + (node.z * level.nodes + node.y) * level.nodes + node.x];
                sum += weights.x * weights.y * weights.z * (127.0 * unpack4x8snorm(code));
            }
            let steps = part_light[2u * row + 1u].xy;
            let seen = vec4f(sum.xyz * steps.x, sum.w * steps.y);
            if seen.w <= 0.0 {
                continue;
            }
            all += weight * seen;
            let received = dot(normal, seen.xyz);
            if received > 0.0 {
                let light = movers.first_of_light + row * OF_PART;
                let axis = seen.xyz * inverseSqrt(max(dot(seen.xyz, seen.xyz), 1e-38));
                found.change += weight * received * (part_light[light].rgb - hidden(light, axis, seen.w));
            }
        }
    }
    found.change = fade * (found.change - kept_by(index, at_m, about));
    let direct = select(offset, all.xyz, dot(all.xyz, all.xyz) > 0.0);
    let towards = direct * inverseSqrt(max(dot(direct, direct), 1e-38));
    found.towards = (row0.xyz * towards.x + row1.xyz * towards.y + row2.xyz * towards.z) / scale;
    found.share = clamp(all.w / TAU, 0.0, 2.0);
    found.half_angle = acos(1.0 - found.share);
    return found;
}

// Share of an object's cap that a nearer one hides.
fn hidden_by(own: Changed, nearer: Changed) -> f32 {
    if nearer.distance_m >= own.distance_m || min(own.half_angle, nearer.half_angle) <= 0.0 {
        return 0.0;
    }
    let apart = acos(clamp(dot(own.towards, nearer.towards), -1.0, 1.0));
    let touching = own.half_angle + nearer.half_angle;
    let within = abs(own.half_angle - nearer.half_angle);
    let share = min(own.share, nearer.share) / own.share;
    let t = clamp((touching - apart) / max(touching - within, 1e-30), 0.0, 1.0);
    return share * t * t * (3.0 - 2.0 * t);
}

// Writes what each object but one changes at a point, of what nearer ones leave in sight.
fn find_changes(but: u32, at_m: vec3f, normal: vec3f) {
    var seen: array<Changed, MOVERS_MAX>;
    for (var index = 0u; index < movers.count; index++) {
        seen[index].is_near = false;
        if index != but {
            seen[index] = changed_by(index, at_m, normal);
        }
    }
    for (var index = 0u; index < movers.count; index++) {
        var left = select(0.0, 1.0, seen[index].is_near);
        for (var other = 0u; other < movers.count; other++) {
            if seen[other].is_near && left > 0.0 {
                left *= 1.0 - hidden_by(seen[index], seen[other]);
            }
        }
        changes[index] = left * seen[index].change;
    }
}
