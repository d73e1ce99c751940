// λ_pj = 4π/K Σ_k L(y_pk) Y_j(ω_k); twin: reference.rs. One workgroup per probe.
// [Sedlacek2019] §3.3.1. We differ: L carries no emission, whose irradiance is baked with its own shadows.

struct Relight {
    // First probe of this page of hits.
    first_probe: u32,
    // Receivers; hits above are the sky or dark and give nothing.
    receiver_count: u32,
    // Relight rays per probe K.
    rays: u32,
    // Coefficients per probe J.
    coefficients: u32,
}

const PI = 3.14159265358979;
// Rays whose radiance the group reads at a time; also the threads.
const TILE = 64u;

@group(0) @binding(0) var<uniform> relight: Relight;
// hits[p·K + k] of the page's probes.
@group(0) @binding(1) var<storage, read> hits: array<u32>;
@group(0) @binding(2) var<storage, read> albedo: array<vec4f>;
@group(0) @binding(3) var<storage, read> e_dir: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(5) var<storage, read> e_ind: array<vec4f>;
// 4π/K · Y_j(ω_k) at k·J + j.
@group(0) @binding(6) var<storage, read> basis: array<f32>;
// lambda[p·J + j].
@group(0) @binding(7) var<storage, read_write> lambda: array<vec4f>;

var<workgroup> radiance: array<vec3f, TILE>;

fn hit_radiance(probe: u32, ray: u32) -> vec3f {
    let hit = hits[(probe - relight.first_probe) * relight.rays + ray];
    if hit >= relight.receiver_count {
        return vec3f(0.0);
    }
    return albedo[hit].rgb * (1.0 / PI) * (e_dir[hit].rgb + e_emit[hit].rgb + e_ind[hit].rgb);
}

@compute @workgroup_size(64)
fn project(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let probe = relight.first_probe + group.x;
    // At most 121 coefficients: two per thread.
    var sum: vec3f;
    var sum_upper: vec3f;
    for (var first = 0u; first < relight.rays; first += TILE) {
        let ray = first + thread;
        if ray < relight.rays {
            radiance[thread] = hit_radiance(probe, ray);
        }
        workgroupBarrier();
        for (var k = 0u; k < min(TILE, relight.rays - first); k++) {
            let row = (first + k) * relight.coefficients;
            if thread < relight.coefficients {
                sum += radiance[k] * basis[row + thread];
            }
            if thread + TILE < relight.coefficients {
                sum_upper += radiance[k] * basis[row + thread + TILE];
            }
        }
        workgroupBarrier();
    }
    if thread < relight.coefficients {
        lambda[probe * relight.coefficients + thread] = vec4f(sum, 0.0);
    }
    if thread + TILE < relight.coefficients {
        lambda[probe * relight.coefficients + thread + TILE] = vec4f(sum_upper, 0.0);
    }
}
