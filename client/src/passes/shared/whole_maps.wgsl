// Each face has a layer of the shadow maps: stands for `passes/transfer/sights.wgsl`.

fn side_of(face_index: u32) -> f32 {
    return f32(light_count.side);
}

fn texel_at(face_index: u32, texel: vec2i) -> vec3i {
    return vec3i(texel, i32(face_index));
}
