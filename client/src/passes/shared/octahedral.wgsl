// Unit vectors in 2 × 16 bits, octahedral, x the lower; twin: NormalCode in proto.

fn octahedral_of(code: u32) -> vec3f {
    let both = unpack2x16snorm(code);
    let z = 1.0 - abs(both.x) - abs(both.y);
    let fold = max(-z, 0.0);
    return normalize(vec3f(both + select(vec2f(-fold), vec2f(fold), both < vec2f(0.0)), z));
}

fn octahedral_code(direction: vec3f) -> u32 {
    let flat = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
    let folded = (1.0 - abs(flat.yx)) * select(vec2f(1.0), vec2f(-1.0), flat.xy < vec2f(0.0));
    return pack2x16snorm(select(flat.xy, folded, flat.z < 0.0));
}
