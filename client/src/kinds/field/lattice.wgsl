// Probes by their points of a lattice; twin: `LatticeTable` of the run time. Joined before `field.wgsl`.

struct LatticeField {
    // Least point of the lattice, and points along each axis.
    low: vec4i,
    size: vec4i,
    spacing_m: f32,
    // First word of the first probe, behind the probe of each point of the lattice, x fastest, and that of each cell.
    first_probe: u32,
    probe_count: u32,
    pad: u32,
}

@group(1) @binding(3) var<uniform> field: LatticeField;

const NO_PROBE = 0xffffffffu;
const HIDDEN_M = 0.04;
const LATTICE_MAX = 1048575.0;

fn distance_between_probes_m() -> f32 {
    return field.spacing_m;
}

// Depth at which a point that no probe sees is lit by none.
fn rounded_most_m() -> f32 {
    return max(0.06 * field.spacing_m, 0.04);
}

fn is_nowhere(point: vec3f) -> bool {
    return any(abs(point / field.spacing_m) > vec3f(LATTICE_MAX));
}

// Light of the probes around a point's cage that see it, tents for weights, twice as wide where that is asked for.
fn from_probes(point: vec3f, is_wide: bool, how: u32, least_m: f32) -> Gathered {
    let at = point / field.spacing_m;
    let cage = vec3i(floor(at));
    let range = select(vec2i(0, 2), vec2i(-1, 3), is_wide);
    let reach = select(1.0, 2.0, is_wide);
    var sum = Gathered();
    sum.weight = select(0.0, -1.0, how == FIND_LEAST);
    for (var z = range.x; z < range.y; z++) {
        for (var y = range.x; y < range.y; y++) {
            // The probe of each point, and that of its cell.
            for (var twice = 2 * range.x; twice < 2 * range.y; twice++) {
                let corner = cage + vec3i(twice >> 1u, y, z);
                let of_cell = u32(twice & 1);
                let place = corner - field.low.xyz;
                if any(place < vec3i(0)) || any(place >= field.size.xyz) {
                    continue;
                }
                let index = u32((place.z * field.size.y + place.y) * field.size.x + place.x);
                let half = 0.5 * f32(of_cell);
                let probe = probes[of_cell * field.first_probe / 2u + index];
                let tent = max(1.0 - abs(at - vec3f(corner) - half) / (reach - half), vec3f(0.0));
                let weight = tent.x * tent.y * tent.z;
                if weight > 0.0 && probe != NO_PROBE {
                    with_probe(&sum, probe, weight, point, how, least_m);
                }
            }
        }
    }
    return sum;
}
