// Probes in tetrahedra; twin: `TetrahedraTable` of the run time. Joined before `field.wgsl`.

struct TetrahedraField {
    // Corners of the box that the tetrahedra fill, in metres.
    low_m: vec4f,
    high_m: vec4f,
    // Cells that walks begin in, along each axis; their number.
    cells: vec4i,
    cell_m: f32,
    spacing_m: f32,
    // First word of the first probe, behind the tetrahedron of each cell, x fastest, and of each tetrahedron its vertices and those beyond
    // its faces.
    first_probe: u32,
    probe_count: u32,
}

@group(1) @binding(3) var<uniform> field: TetrahedraField;

const NO_TETRAHEDRON = 0xffffffffu;
const TETRAHEDRON_WORDS = 8u;
const HIDDEN_M = 0.02;
// Probes of a tetrahedron, of those beyond its faces, and of those beyond theirs.
const WIDE_MOST = 20u;
const STEPS_MAX = 64u;
const WITHIN = -1e-5;
const NEAREST = 0.05;
// A walk that met nothing.
const NOWHERE = -1e30;

fn distance_between_probes_m() -> f32 {
    return field.cell_m;
}

// Depth at which a point that no probe sees is lit by none.
fn rounded_most_m() -> f32 {
    return HIDDEN_M;
}

fn is_nowhere(point: vec3f) -> bool {
    return field.cells.w == 0 || any(!(abs(point) <= vec3f(1e30)));
}

fn tetrahedron_word(tetrahedron: u32, word: u32) -> u32 {
    return probes[u32(field.cells.w) + tetrahedron * TETRAHEDRON_WORDS + word];
}

// Place of a probe, or of a corner of the box behind them.
fn vertex_place(vertex: u32) -> vec3f {
    if vertex >= field.probe_count {
        let corner = vertex - field.probe_count;
        let is_high = vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
        return select(field.low_m.xyz, field.high_m.xyz, is_high);
    }
    let first = field.first_probe + vertex * PROBE_WORDS;
    return bitcast<vec3f>(vec3u(probes[first], probes[first + 1u], probes[first + 2u]));
}

// Barycentric coordinates of a point.
fn within(tetrahedron: u32, point: vec3f) -> vec4f {
    let first = vertex_place(tetrahedron_word(tetrahedron, 0u));
    let a = vertex_place(tetrahedron_word(tetrahedron, 1u)) - first;
    let b = vertex_place(tetrahedron_word(tetrahedron, 2u)) - first;
    let c = vertex_place(tetrahedron_word(tetrahedron, 3u)) - first;
    let away = point - first;
    let parts = vec3f(dot(away, cross(b, c)), dot(away, cross(c, a)), dot(away, cross(a, b))) / dot(a, cross(b, c));
    return vec4f(1.0 - parts.x - parts.y - parts.z, parts);
}

struct Located {
    tetrahedron: u32,
    shares: vec4f,
}

// The tetrahedron of a point, or of the nearest one of the box, by a walk from the middle of its cell.
fn locate(anywhere: vec3f) -> Located {
    let point = clamp(anywhere, field.low_m.xyz, field.high_m.xyz);
    let cell = clamp(vec3i((point - field.low_m.xyz) / field.cell_m), vec3i(0), field.cells.xyz - 1);
    var at = probes[u32((cell.z * field.cells.y + cell.y) * field.cells.x + cell.x)];
    var best = Located(at, vec4f(0.0));
    var best_least = NOWHERE;
    for (var step = 0u; step < STEPS_MAX; step++) {
        let shares = within(at, point);
        var side = 0u;
        for (var other = 1u; other < 4u; other++) {
            if shares[other] < shares[side] {
                side = other;
            }
        }
        if shares[side] > best_least {
            best = Located(at, shares);
            best_least = shares[side];
        }
        let next = tetrahedron_word(at, 4u + side);
        if shares[side] >= WITHIN || next == NO_TETRAHEDRON {
            break;
        }
        at = next;
    }
    best.shares = max(best.shares, vec4f(0.0));
    return best;
}

fn by_distance(vertex: u32, point: vec3f) -> f32 {
    let away = (vertex_place(vertex) - point) / field.cell_m;
    return 1.0 / max(dot(away, away), NEAREST * NEAREST);
}

// Light of the probes at the corners of a point's tetrahedron that see it, barycentric coordinates for weights; of those of tetrahedra around
// it too, by distance, where that is asked for.
fn from_probes(point: vec3f, is_wide: bool, how: u32, least_m: f32) -> Gathered {
    var sum = Gathered();
    sum.weight = select(0.0, -1.0, how == FIND_LEAST);
    let located = locate(point);
    let at = located.tetrahedron;
    var found: array<u32, WIDE_MOST>;
    var count = 0u;
    // Itself; then by face that which is beyond it, and those beyond its faces.
    for (var turn = 0u; turn < select(1u, 21u, is_wide); turn++) {
        var around = at;
        if turn > 0u {
            around = tetrahedron_word(at, 4u + (turn - 1u) / 5u);
            let way = (turn - 1u) % 5u;
            if way > 0u && around != NO_TETRAHEDRON {
                around = tetrahedron_word(around, 3u + way);
            }
        }
        if around == NO_TETRAHEDRON {
            continue;
        }
        for (var corner = 0u; corner < 4u; corner++) {
            let vertex = tetrahedron_word(around, corner);
            var is_new = count < WIDE_MOST;
            for (var other = 0u; other < count; other++) {
                is_new = is_new && found[other] != vertex;
            }
            if !is_new {
                continue;
            }
            found[count] = vertex;
            count++;
            let share = select(located.shares[corner], by_distance(vertex, point), is_wide);
            if vertex < field.probe_count && share > 0.0 {
                with_probe(&sum, vertex, share, point, how, least_m);
            }
        }
    }
    return sum;
}
