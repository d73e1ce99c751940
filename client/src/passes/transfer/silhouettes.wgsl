// Light of emitters that an object keeps from others: points of the emitters, and the object as each sees it in faces behind the sights. Twin:
// silhouettes.rs. Joined with `volume.wgsl` and `sights.wgsl`.

const EMITTER_POINTS = 16u;

// Irradiance without occluders of a point of emitters at a place about a normal.
fn light_of_point(row: u32, at_m: vec3f, normal: vec3f) -> vec3f {
    let position = part_light[row];
    let radiant = part_light[row + 1u];
    let way_m = position.xyz - at_m;
    let squared = dot(way_m, way_m);
    let towards = way_m * inverseSqrt(max(squared, 1e-30));
    let received = max(dot(normal, towards), 0.0);
    let facing = max(-dot(part_light[row + 2u].xyz, towards), 0.0);
    let sent = 0.25 + (facing - 0.25) * radiant.w;
    return radiant.rgb * (received * sent / (squared + position.w * 0.318309886));
}

// Irradiance that an object keeps from a place about a normal.
fn kept_by(index: u32, at_m: vec3f, normal: vec3f) -> vec3f {
    var sum = vec3f(0.0);
    for (var point = 0u; point < movers.each[index].points; point++) {
        let number = EMITTER_POINTS * index + point;
        let light = light_of_point(movers.first_point + 3u * number, at_m, normal);
        if any(light > vec3f(0.0)) {
            sum += light * covered_in(movers.first_silhouette + number, at_m);
        }
    }
    return sum;
}

// Irradiance that an object has of its points of emitters at a place of its own; none of what is no object's.
fn given_to(index: u32, at_m: vec3f, normal: vec3f, facet: vec3f) -> vec3f {
    var sum = vec3f(0.0);
    if index >= movers.count {
        return sum;
    }
    for (var point = 0u; point < movers.each[index].points; point++) {
        let number = EMITTER_POINTS * index + point;
        let light = light_of_point(movers.first_point + 3u * number, at_m, normal);
        if any(light > vec3f(0.0)) {
            let face_index = movers.first_silhouette + number;
            sum += light * (1.0 - covered_in(face_index, lifted(face_index, at_m, facet)));
        }
    }
    return sum;
}

// Share of a point of emitters that the object covers.
fn covered_in(face_index: u32, at_m: vec3f) -> f32 {
    let clip = faces[face_index].clip_from_world * vec4f(at_m, 1.0);
    if clip.w <= 0.0 || max(abs(clip.x), abs(clip.y)) > clip.w {
        return 0.0;
    }
    let depth = clip.z / clip.w;
    let at = (vec2f(clip.x, -clip.y) / clip.w * 0.5 + 0.5) * f32(SIGHT_SIDE) - 0.5;
    let base = floor(at);
    let share = at - base;
    let of_x = array<f32, 4>(1.0 - share.x, 1.0, 1.0, share.x);
    let of_y = array<f32, 4>(1.0 - share.y, 1.0, 1.0, share.y);
    var covered = 0.0;
    for (var row = 0; row < 4; row++) {
        for (var column = 0; column < 4; column++) {
            if depth_at(face_index, vec2i(base) + vec2i(column - 1, row - 1)) > depth {
                covered += of_x[column] * of_y[row];
            }
        }
    }
    return covered / 9.0;
}
