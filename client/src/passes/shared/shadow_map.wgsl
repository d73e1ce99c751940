// Look-ups in shadow maps, whose depth is reversed: the greater, the nearer to the light. Joined behind `light.wgsl`, with `whole_maps.wgsl` or
// `passes/transfer/sights.wgsl`.
// Twin: shadow/look_up.rs.

// Reach of the filter in texels, and a margin against rounding.
const FILTER_REACH = 2.0;
const FILTER_MARGIN = 0.5;
// Texels across which the filter reads.
const FILTER_WIDTH = 4.0;
// Part of the constant offset that the test against planes needs under a sun.
const PARALLEL_BIAS = 0.03;

// Share of the light that passes the glass before a depth. Between two panes it is that of both.
fn passed(face_index: u32, texel: vec2i, depth: f32) -> f32 {
    if faces[face_index].panes == 0.0 || textureLoad(pane_maps, texel, i32(face_index), 0) <= depth {
        return 1.0;
    }
    return textureLoad(passed_maps, texel, i32(face_index), 0).r;
}

// Share of the light that arrives, from 4 × 4 texels: a box of three texels joined with bilinear weights.
fn visibility(face_index: u32, position: vec3f) -> f32 {
    let clip = faces[face_index].clip_from_world * vec4f(position, 1.0);
    if clip.w <= 0.0 {
        return 1.0;
    }
    let ndc = clip.xyz / clip.w;
    let side = side_of(face_index);
    let at = (vec2f(ndc.x, -ndc.y) * 0.5 + 0.5) * side - 0.5;
    let base = floor(at);
    let share = at - base;
    let weight_x = array<f32, 4>(1.0 - share.x, 1.0, 1.0, share.x);
    let weight_y = array<f32, 4>(1.0 - share.y, 1.0, 1.0, share.y);
    let last = i32(side) - 1;
    var lit = 0.0;
    for (var row = 0; row < 4; row++) {
        for (var column = 0; column < 4; column++) {
            let texel = clamp(vec2i(base) + vec2i(column - 1, row - 1), vec2i(0), vec2i(last));
            let place = texel_at(face_index, texel);
            let nearest = textureLoad(shadow_maps, place.xy, place.z, 0);
            if nearest <= ndc.z {
                lit += weight_x[column] * weight_y[row] * passed(face_index, texel, ndc.z);
            }
        }
    }
    return lit / 9.0;
}

// Whether a flat surface that the texels around a point see lies before it, so near that the filter finds light past its
// edge: within the filter's width along it, or within the lift along the light. It is met at the point's own place in the
// map, not at the texels'.
fn is_behind(face_index: u32, light: Light, position: vec3f, facet: vec3f, lift_m: f32) -> bool {
    let clip = faces[face_index].clip_from_world * vec4f(position, 1.0);
    let towards = select(normalize(light.position - position), -light.direction, light.shape == SUN);
    // Depth of a perspective is rounded by the nearest corner of a triangle, however far the point.
    let bias_m = select(1.0, PARALLEL_BIAS, light.shape == SUN) * light_count.bias_m;
    let nearer = faces[face_index].clip_from_world * vec4f(position + towards * bias_m, 1.0);
    if clip.w <= 0.0 || nearer.w <= 0.0 {
        return false;
    }
    let ndc = clip.xyz / clip.w;
    let margin = nearer.z / nearer.w - ndc.z;
    let at = (vec2f(ndc.x, -ndc.y) * 0.5 + 0.5) * side_of(face_index) - 0.5;
    let base = vec2i(floor(at));
    // Most points see their own surface.
    let d = vec3f(
        depth_at(face_index, base),
        depth_at(face_index, base + vec2i(1, 0)),
        depth_at(face_index, base + vec2i(0, 1)),
    );
    let change = d.yz - d.x;
    let open = d.x + dot(change, at - floor(at)) - ndc.z <= margin + light_count.snap * (abs(change.x) + abs(change.y));
    if open && min(d.x, min(d.y, d.z)) > 0.0 && goes_on(face_index, base + vec2i(1, 1), d.y + d.z - d.x, margin) {
        return false;
    }
    let depth_per_m = margin / bias_m;
    let far = depth_per_m * lift_m / max(dot(facet, towards), 0.01);
    let texel_m = faces[face_index].texel_at_unit_w * clip.w;
    // Depth of the point's own surface per texel; beyond it, as past the corner of two walls, light is no concern of the point.
    let per_texel = depth_per_m * texel_m / max(dot(facet, towards), 0.01);
    let own_slope = vec2f(-dot(facet, faces[face_index].right), dot(facet, faces[face_index].up)) * per_texel;
    let deep = margin + abs(own_slope.x) + abs(own_slope.y);
    let surface = ndc.z - deep - dot(own_slope, at);
    for (var corner = 0; corner < 4; corner++) {
        // The plane of this texel and those behind it, seen from the point.
        let inward = vec2i(1 - 2 * (corner & 1), 1 - 2 * (corner >> 1u));
        let texel = base + vec2i(corner & 1, corner >> 1u);
        let x = vec2i(inward.x, 0);
        let y = vec2i(0, inward.y);
        let own = depth_at(face_index, texel);
        let slope = own - vec2f(depth_at(face_index, texel - x), depth_at(face_index, texel - y));
        let next = own - 2.0 * slope - vec2f(depth_at(face_index, texel - 2 * x), depth_at(face_index, texel - 2 * y));
        if own <= 0.0 || max(abs(next.x), abs(next.y)) > margin {
            continue;
        }
        // An occluder is above the surface; what bends away from it, as the next facet of a thing does, is below.
        let away = (vec2f(texel) - at) * texel_m;
        let seen = faces[face_index].right * away.x - faces[face_index].up * away.y;
        if dot(seen + towards * ((own - ndc.z) / depth_per_m), facet) <= 0.0 {
            continue;
        }
        // At the three others it does not end: they see it, or what is before it as the floor beyond its foot, or nothing at all.
        if ends(face_index, texel + x, own + slope.x - margin, surface + dot(own_slope, vec2f(texel + x)))
            || ends(face_index, texel + y, own + slope.y - margin, surface + dot(own_slope, vec2f(texel + y)))
            || ends(face_index, texel + x + y, own + slope.x + slope.y - margin, surface + dot(own_slope, vec2f(texel + x + y))) {
            continue;
        }
        let depth = own + dot(slope, abs(at - vec2f(texel))) - ndc.z;
        let steep = abs(slope.x) + abs(slope.y);
        if depth > margin + light_count.snap * steep && depth < far + FILTER_WIDTH * steep {
            return true;
        }
    }
    return false;
}

fn goes_on(face_index: u32, texel: vec2i, expected: f32, margin: f32) -> bool {
    let found = depth_at(face_index, texel);
    return found <= 0.0 || abs(found - expected) <= margin;
}

// Whether a texel sees past a plane that was expected there, but not past the point's own surface.
fn ends(face_index: u32, texel: vec2i, expected: f32, surface: f32) -> bool {
    let found = depth_at(face_index, texel);
    return found > 0.0 && found < expected && found >= surface;
}

fn depth_at(face_index: u32, texel: vec2i) -> f32 {
    let last = i32(side_of(face_index)) - 1;
    let place = texel_at(face_index, clamp(texel, vec2i(0), vec2i(last)));
    return textureLoad(shadow_maps, place.xy, place.z, 0);
}

// Moves a point along its normal until the filter's reach cannot meet the point's own surface.
fn lifted(face_index: u32, position: vec3f, normal: vec3f) -> vec3f {
    let w = dot(vec4f(position, 1.0), vec4f(
        faces[face_index].clip_from_world[0].w,
        faces[face_index].clip_from_world[1].w,
        faces[face_index].clip_from_world[2].w,
        faces[face_index].clip_from_world[3].w,
    ));
    let texel = faces[face_index].texel_at_unit_w * max(w, 0.0);
    let slope = abs(dot(normal, faces[face_index].right)) + abs(dot(normal, faces[face_index].up));
    return position + normal * (texel * (FILTER_REACH * slope + FILTER_MARGIN) + light_count.bias_m);
}
