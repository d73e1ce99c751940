// Normals by a normal map, in a frame that the surface's own texture coordinates give; twin: normals.rs.

// Least square of a tangent's part along the surface, of its own.
const TANGENT_MIN = 1e-6;

// The normal that a texel of a map says, x along the texture's u, y towards its upper edge. `first` and `second` are two steps on the
// surface, each with its change of the map's coordinates. The interpolated normal itself where these give no frame.
fn mapped_normal(normal: vec3f, first: vec3f, second: vec3f, uv_first: vec2f, uv_second: vec2f, texel: vec2f, height: f32) -> vec3f {
    let turn = select(-1.0, 1.0, uv_first.x * uv_second.y >= uv_second.x * uv_first.y);
    let along_u = turn * (first * uv_second.y - second * uv_first.y);
    let along_v = turn * (second * uv_first.x - first * uv_second.x);
    let flat_u = along_u - normal * dot(normal, along_u);
    let squared = dot(flat_u, flat_u);
    if !(squared > TANGENT_MIN * dot(along_u, along_u)) {
        return normal;
    }
    let tangent = flat_u * inverseSqrt(squared);
    let across = cross(normal, tangent);
    // The texture's upper edge is where v is least.
    let bitangent = select(-across, across, dot(across, along_v) < 0.0);
    let bent = tangent * texel.x + bitangent * texel.y + normal * height;
    let length2 = dot(bent, bent);
    return select(normal, bent * inverseSqrt(max(length2, 1e-30)), length2 > 1e-12);
}
