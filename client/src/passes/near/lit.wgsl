// Light straight from lights at near hits, summed by receiver: Σ_y ρ/π E_dir(y); twin: reference.rs. One thread per receiver.

@group(1) @binding(0) var<uniform> numbers: Near;
@group(1) @binding(1) var<storage, read> rows: array<NearRow>;
@group(1) @binding(2) var<storage, read> hits: array<NearHit>;
@group(1) @binding(3) var<storage, read> own: array<OwnSurface>;
// By slot, as albedo.
@group(1) @binding(4) var<storage, read> normals: array<vec4f>;
@group(1) @binding(5) var<storage, read> albedo: array<vec4f>;
// By row.
@group(1) @binding(6) var<storage, read_write> lit: array<vec4f>;

@compute @workgroup_size(64)
fn light_hits(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.row_count {
        return;
    }
    let row = rows[index];
    var sum = vec3f(0.0);
    for (var at = row.first; at < row.first + row.count; at++) {
        let hit = hits[at];
        var surface = OwnSurface();
        if (hit.light & OWN_SURFACE) != 0u {
            surface = own[hit.light & ~OWN_SURFACE];
        } else {
            surface = OwnSurface(normals[hit.light], albedo[hit.light]);
        }
        let normal = turned(surface.normal.xyz);
        sum += surface.albedo.rgb * (1.0 / PI) * direct_irradiance(placed(hit.position_m), normal, normal);
    }
    lit[index] = vec4f(sum, 0.0);
}
