// Light of near hits → irradiance at the receivers that have any; twin: reference.rs. One thread per receiver.
// `N_r = w_r (Σ_y ρ/π E_dir(y) + Σ_y ρ/π (E_emit + E_ind))`; the first sum is that of lit.wgsl.

@group(0) @binding(0) var<uniform> numbers: Near;
@group(0) @binding(1) var<storage, read> rows: array<NearRow>;
@group(0) @binding(2) var<storage, read> hits: array<NearHit>;
@group(0) @binding(3) var<storage, read> own: array<OwnSurface>;
// By slot, as e_emit, e_ind and e_near.
@group(0) @binding(4) var<storage, read> albedo: array<vec4f>;
// Light straight from lights, by row.
@group(0) @binding(5) var<storage, read> lit: array<vec4f>;
@group(0) @binding(6) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(7) var<storage, read> e_ind: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> e_near: array<vec4f>;

@compute @workgroup_size(64)
fn gather(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.row_count {
        return;
    }
    let row = rows[index];
    // The mark of a receiver that no bounce computes.
    if e_near[row.slot].w != 0.0 {
        return;
    }
    var sum = vec3f(0.0);
    for (var at = row.first; at < row.first + row.count; at++) {
        let light = hits[at].light;
        if (light & OWN_SURFACE) != 0u {
            let surface = own[light & ~OWN_SURFACE];
            sum += surface.albedo.rgb * (1.0 / PI) * (e_emit[row.slot].rgb + e_ind[row.slot].rgb);
        } else {
            sum += albedo[light].rgb * (1.0 / PI) * (e_emit[light].rgb + e_ind[light].rgb);
        }
    }
    e_near[row.slot] = vec4f(row.weight * (lit[index].rgb + sum), 0.0);
}
