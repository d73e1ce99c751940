// Indirect light of a surface, read from the lightmap's pages; twin: `read` and `sample` in reference.rs, `tap_weights` of the run time.
// Joined behind `shade.wgsl`, with its bindings in group 1 from 1; a kind's `indirect_irradiance` is joined behind it.

// Block of the front and of the back: page, origin; width 0 when there is none.
struct Placement {
    front: vec4u,
    front_size: vec4u,
    back: vec4u,
    back_size: vec4u,
}

@group(1) @binding(1) var lightmap_pages: texture_2d_array<f32>;
// By draw.
@group(1) @binding(2) var<storage, read> placements: array<Placement>;

// How far an edge may lie from the wall that it stands for, in texels.
const EDGE_ROUNDING = 0.012;

// Whether no wall stands between two taps that are receivers; each link is a bit of the earlier tap.
fn linked(first_kind: f32, second_kind: f32, first: u32, second: u32) -> bool {
    if first_kind <= 0.0 || second_kind <= 0.0 {
        return false;
    }
    var bit = 3u;
    if first == 0u && second == 3u {
        bit = 2u;
    } else if second - first == 2u {
        bit = 1u;
    } else if first != 1u {
        bit = 0u;
    }
    return (((u32(first_kind) - 1u) >> bit) & 1u) == 1u;
}

fn has_edge(kind: f32) -> bool {
    return (u32(kind) - 1u) / 16u != 0u;
}

// Place of a tap among the four.
fn place_of(tap: u32) -> vec2f {
    return vec2f(f32(tap & 1u), f32(tap >> 1u));
}

// Whether a place, from the middle of a receiver's texel, is beyond the edge of its side.
fn beyond_wall(kind: f32, from_middle: vec2f) -> bool {
    let edge = (u32(max(kind, 1.0)) - 1u) / 16u;
    let angle = f32(edge >> 8u) * (6.2831853 / 256.0);
    let offset = (f32(edge & 255u) - 128.0) * (0.75 / 127.0);
    return edge != 0u && dot(from_middle, vec2f(cos(angle), sin(angle))) > offset;
}

// Bilinear over the receivers that no wall parts from the nearest one, the home; over filled texels where there is no
// receiver. Beyond the home's edge, over those that no wall parts from the nearest receiver whose side has the point. On which side
// of edges the point lies is told by a place as far from it as their rounding may be, towards the place before.
fn lightmap_irradiance(block: vec4u, size: vec4u, texel: vec2f, before: vec2f) -> vec3f {
    if size.x == 0u {
        return vec3f(0.0);
    }
    let at = texel - 0.5;
    let base = floor(at);
    let share = at - base;
    let ahead = before - texel;
    let sided = share + min(EDGE_ROUNDING / max(length(ahead), 1e-9), 1.0) * ahead;
    let last = vec2f(size.xy) - 1.0;
    var taps: array<vec4f, 4>;
    var weights: array<f32, 4>;
    var home = 4u;
    for (var tap = 0u; tap < 4u; tap++) {
        let inside = vec2u(clamp(base + place_of(tap), vec2f(0.0), last));
        let weight = mix(1.0 - share, share, place_of(tap));
        // Never quite 0, so that a lone receiver counts wherever it lies.
        weights[tap] = weight.x * weight.y + 1e-6;
        taps[tap] = textureLoad(lightmap_pages, block.yz + inside, i32(block.x), 0);
        if taps[tap].w > 0.0 && (home == 4u || weights[tap] > weights[min(home, 3u)]) {
            home = tap;
        }
    }
    // A texel's edge says nothing of what lies outside of the texel: a point there asks by the nearest of its places.
    if home < 4u && beyond_wall(taps[home].w, clamp(sided - place_of(home), vec2f(-0.5), vec2f(0.5))) {
        var beyond = 4u;
        var best = 0.0;
        for (var tap = 0u; tap < 4u; tap++) {
            let kind = taps[tap].w;
            let parted = tap != home && kind > 0.0
                && !linked(taps[min(home, tap)].w, taps[max(home, tap)].w, min(home, tap), max(home, tap));
            let there = beyond_wall(taps[home].w, place_of(tap) - place_of(home));
            let has_point = !beyond_wall(kind, sided - place_of(tap));
            // Those whose side has the point before those that are merely beyond the edge.
            let rank = weights[tap] + select(0.0, 2.0, has_point);
            if parted && (there || (has_point && has_edge(kind))) && rank > best {
                beyond = tap;
                best = rank;
            }
        }
        home = select(beyond, home, beyond == 4u);
    }
    var sum = vec3f(0.0);
    var total = 0.0;
    for (var tap = 0u; tap < 4u; tap++) {
        var counts = taps[tap].w < 0.0;
        if home < 4u {
            let first = min(home, tap);
            let second = max(home, tap);
            counts = tap == home || linked(taps[first].w, taps[second].w, first, second);
        }
        if counts {
            sum += weights[tap] * taps[tap].rgb;
            total += weights[tap];
        }
    }
    return select(vec3f(0.0), sum / max(total, 1e-9), total > 0.0);
}

// Irradiance of a surface from the pages; black for one without a lightmap.
fn from_lightmap(surface: Surface) -> vec3f {
    let placement = placements[surface.draw];
    let block = select(placement.back, placement.front, surface.front);
    let size = select(placement.back_size, placement.front_size, surface.front);
    return lightmap_irradiance(block, size, surface.lightmap_texel, surface.lightmap_before);
}
