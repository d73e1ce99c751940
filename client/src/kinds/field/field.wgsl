// Light of surfaces without a lightmap, from probes in free space; twin: `FieldTable` of the run time. Joined behind
// `lattice.wgsl` or `tetrahedra.wgsl`, which say what is between probes, and before `beside.wgsl` or `alone.wgsl`, which say what it lights.

// The lattice or the tetrahedra between probes; then of each probe its place and its depth map, 16 bits a point.
@group(1) @binding(4) var<storage, read> probes: array<u32>;
// Coefficients of irradiance by normal, nine a probe.
@group(1) @binding(5) var<storage, read> light_at_probes: array<vec4f>;

const MAP_SIDE = 17u;
const MAP_HALF = 8u;
const PROBE_WORDS = 148u;
const PROBE_ROWS = 9u;
// Reciprocal distance, in steps of the lattice, of a unit of depths' codes.
const DEPTH_UNIT = 40.0 / 65535.0;
const HIDDEN_SHARE = 0.05;
const ROUNDED_SHARE = 0.15;
const ROUNDED_M = 0.01;
const WEIGHT_MIN = 1e-4;

fn signs(at: vec2f) -> vec2f {
    return select(vec2f(-1.0), vec2f(1.0), at >= vec2f(0.0));
}

// s h at a point of a probe's map.
fn map_at(first: u32, point: vec2u) -> f32 {
    let at = point.y * MAP_SIDE + point.x;
    let word = probes[first + 3u + at / 2u];
    return f32(select(word & 0xffffu, word >> 16u, (at & 1u) == 1u)) * DEPTH_UNIT;
}

// s h of a direction: exact for planes.
fn map_depth(first: u32, direction: vec3f) -> f32 {
    let on = direction / dot(abs(direction), vec3f(1.0));
    let unfolded = select((1.0 - abs(on.yx)) * signs(on.xy), on.xy, on.z >= 0.0);
    let at = (unfolded + 1.0) * f32(MAP_HALF);
    let square = min(vec2u(at), vec2u(MAP_SIDE - 2u));
    let share = clamp(at - vec2f(square), vec2f(0.0), vec2f(1.0));
    let right = map_at(first, square + vec2u(1u, 0u));
    let below = map_at(first, square + vec2u(0u, 1u));
    // Squares are cut along the edges of the octahedron's faces.
    if (square.x >= MAP_HALF) == (square.y >= MAP_HALF) {
        if share.x + share.y <= 1.0 {
            return (1.0 - share.x - share.y) * map_at(first, square) + share.x * right + share.y * below;
        }
        let far = map_at(first, square + vec2u(1u, 1u));
        return (share.x + share.y - 1.0) * far + (1.0 - share.x) * below + (1.0 - share.y) * right;
    }
    let near = map_at(first, square);
    let far = map_at(first, square + vec2u(1u, 1u));
    if share.x >= share.y {
        return (1.0 - share.x) * near + (share.x - share.y) * right + share.y * far;
    }
    return (1.0 - share.y) * near + (share.y - share.x) * below + share.x * far;
}

// How far behind the nearest surface that a probe sees a point lies, and the point's distance; octahedral, in metres.
fn excess(probe: u32, point: vec3f) -> vec2f {
    let first = field.first_probe + probe * PROBE_WORDS;
    let place = bitcast<vec3f>(vec3u(probes[first], probes[first + 1u], probes[first + 2u]));
    let away = point - place;
    let distance_m = dot(abs(away), vec3f(1.0));
    if distance_m <= 1e-6 * field.spacing_m {
        return vec2f(0.0, distance_m);
    }
    let beyond = map_depth(first, away) / field.spacing_m * distance_m;
    return vec2f(select(distance_m * (1.0 - 1.0 / max(beyond, 1.0)), 0.0, beyond <= 1.0), distance_m);
}

// Y_j of a normal, bands 0 to 2.
fn harmonics(n: vec3f) -> array<f32, 9> {
    return array<f32, 9>(
        0.28209479,
        0.48860251 * n.y, 0.48860251 * n.z, 0.48860251 * n.x,
        1.09254843 * n.x * n.y, 1.09254843 * n.y * n.z, 0.31539157 * (3.0 * n.z * n.z - 1.0),
        1.09254843 * n.x * n.z, 0.54627422 * (n.x * n.x - n.y * n.y),
    );
}

// How probes around a point count.
const BY_DEPTH = 0u;
const FIND_LEAST = 1u;
const BY_LEAST = 2u;

// Light at a point: Σ w q_j of probes' coefficients by normal, and Σ w.
struct Gathered {
    rows: array<vec3f, 9>,
    weight: f32,
}

// Adds a probe to Σ w q_j and Σ w, if it sees the point. `FIND_LEAST` keeps in place of Σ w the least depth in metres at which the point
// lies behind what one of them sees, below 0 for none; `BY_LEAST` takes those of about that depth.
fn with_probe(sum: ptr<function, Gathered>, probe: u32, tent: f32, point: vec3f, how: u32, least_m: f32) {
    let behind = excess(probe, point);
    let is_near = behind.x <= ROUNDED_SHARE * behind.y && behind.x < rounded_most_m();
    if how == FIND_LEAST {
        let before = (*sum).weight;
        (*sum).weight = select(before, behind.x, is_near && (before < 0.0 || behind.x < before));
        return;
    }
    var weight = tent;
    if how == BY_LEAST {
        weight *= select(0.0, max(1.0 - (behind.x - least_m) / ROUNDED_M, 0.0), is_near);
    } else if behind.x > 0.0 {
        weight *= max(1.0 - behind.x / min(HIDDEN_M, HIDDEN_SHARE * behind.y), 0.0);
    }
    if weight <= 0.0 {
        return;
    }
    for (var j = 0u; j < PROBE_ROWS; j++) {
        (*sum).rows[j] += weight * light_at_probes[probe * PROBE_ROWS + j].rgb;
    }
    (*sum).weight += weight;
}

// Light at a point: of the probes around it that see it; else of those further around; else of those that nearly see it. `from_probes` is
// called here alone: adapters compile a copy of it for each call.
fn field_at(point: vec3f) -> Gathered {
    var found = Gathered();
    if field.probe_count == 0u || is_nowhere(point) {
        return found;
    }
    var is_wide = false;
    var how = BY_DEPTH;
    var least_m = 0.0;
    loop {
        found = from_probes(point, is_wide, how, least_m);
        if how == BY_LEAST || (how == BY_DEPTH && found.weight >= WEIGHT_MIN) || found.weight < 0.0 {
            break;
        }
        if how == FIND_LEAST {
            least_m = found.weight;
            how = BY_LEAST;
        } else if is_wide {
            how = FIND_LEAST;
        }
        is_wide = true;
    }
    return found;
}

// Each coefficient by a factor, and summed; none where no probe sees the point.
fn field_sum(found: Gathered, factors: array<f32, 9>) -> vec3f {
    var sum = vec3f(0.0);
    for (var j = 0u; j < PROBE_ROWS; j++) {
        sum += factors[j] * found.rows[j];
    }
    return select(vec3f(0.0), max(sum / max(found.weight, WEIGHT_MIN), vec3f(0.0)), found.weight >= WEIGHT_MIN);
}

// Irradiance about a direction.
fn field_about(found: Gathered, direction: vec3f) -> vec3f {
    return field_sum(found, harmonics(direction));
}
