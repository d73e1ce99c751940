// Sights of objects: lights without light behind the others, whose faces are tiles of the last layers of shadow maps.
// Joined with `volume.wgsl`.

// Texels along a face of what an object sees.
const SIGHT_SIDE = 64u;

fn side_of(face_index: u32) -> f32 {
    return f32(select(light_count.side, SIGHT_SIDE, face_index >= movers.first_face));
}

// Place of a texel of a face in the maps: faces of what objects see are tiles of the last layers.
fn texel_at(face_index: u32, texel: vec2i) -> vec3i {
    if face_index < movers.first_face {
        return vec3i(texel, i32(face_index));
    }
    let tile = face_index - movers.first_face;
    let along = light_count.side / SIGHT_SIDE;
    let within = tile % (along * along);
    let layer = movers.first_layer + tile / (along * along);
    return vec3i(vec2i(vec2u(within % along, within / along) * SIGHT_SIDE) + texel, i32(layer));
}

// Lights, and what objects see behind them.
fn lamp_count() -> u32 {
    return light_count.count + movers.count;
}

fn lamp_at(index: u32) -> Light {
    if index < light_count.count {
        return lights[index];
    }
    return lights[movers.first_light + index - light_count.count];
}
