//! Look-ups in shadow maps on the processor; twin of `shared/shadow_map.wgsl`, function by function.

use glam::{IVec2, Vec2, Vec3};

use super::reference::ShadowMaps;
use super::{Face, Light, ShadowPlan};
use crate::lights::Shape;

/// Reach of the filter in texels.
pub(in crate::passes) const FILTER_REACH: f32 = 2.0;
const FILTER_MARGIN: f32 = 0.5;
const FILTER_WIDTH: f32 = 4.0;
const PARALLEL_BIAS: f32 = 0.03;

/// Unit vector towards a light.
pub(in crate::passes) fn towards(light: &Light, position: Vec3) -> Vec3 {
    if light.shape == Shape::Sun as u32 {
        return -Vec3::from(light.direction);
    }
    (Vec3::from(light.position) - position).normalize_or(Vec3::Y)
}

/// Share of the light that arrives, from 4 × 4 texels.
pub(in crate::passes) fn visibility(
    plan: &ShadowPlan,
    maps: &ShadowMaps,
    face_index: u32,
    position: Vec3,
) -> f32 {
    let side = maps.side as usize;
    let clip = plan.faces[face_index as usize].projection() * position.extend(1.0);
    if clip.w <= 0.0 {
        return 1.0;
    }
    let ndc = clip.truncate() / clip.w;
    let at = (Vec2::new(ndc.x, -ndc.y) * 0.5 + 0.5) * side as f32 - 0.5;
    let base = at.floor();
    let share = at - base;
    let weight_x = [1.0 - share.x, 1.0, 1.0, share.x];
    let weight_y = [1.0 - share.y, 1.0, 1.0, share.y];
    let map = &maps.depth[face_index as usize * side * side..][..side * side];
    let texel = |start: f32, step: usize| {
        (start as i64).saturating_add(step as i64 - 1).clamp(0, side as i64 - 1) as usize
    };
    let mut lit = 0.0;
    for (row, weight_y) in weight_y.iter().enumerate() {
        for (column, weight_x) in weight_x.iter().enumerate() {
            let index = texel(base.y, row) * side + texel(base.x, column);
            if map[index] <= ndc.z {
                lit += weight_x * weight_y * maps.passed(face_index as usize * side * side + index, ndc.z);
            }
        }
    }
    lit / 9.0
}

/// Whether a flat surface that the texels around a point see lies before it.
pub(in crate::passes) fn is_behind(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    face_index: u32,
    light: &Light,
    position: Vec3,
    facet: Vec3,
    lift_m: f32,
) -> bool {
    let projection = plan.faces[face_index as usize].projection();
    let towards = towards(light, position);
    let clip = projection * position.extend(1.0);
    // Depth of a perspective is rounded by the nearest corner of a triangle, however far the point.
    let is_sun = light.shape == Shape::Sun as u32;
    let bias_m = if is_sun { PARALLEL_BIAS } else { 1.0 } * plan.count.bias_m;
    let nearer = projection * (position + towards * bias_m).extend(1.0);
    if clip.w <= 0.0 || nearer.w <= 0.0 {
        return false;
    }
    let ndc = clip.truncate() / clip.w;
    let margin = nearer.z / nearer.w - ndc.z;
    let at = (Vec2::new(ndc.x, -ndc.y) * 0.5 + 0.5) * maps.side as f32 - 0.5;
    let base = at.floor().as_ivec2();
    let depth_at = |texel| maps.depth_at(face_index, texel);
    let goes_on = |texel, expected: f32| {
        let found = depth_at(texel);
        found <= 0.0 || (found - expected).abs() <= margin
    };
    // Most points see their own surface.
    let d = [IVec2::ZERO, IVec2::X, IVec2::Y].map(|step| depth_at(base + step));
    let change = Vec2::new(d[1], d[2]) - d[0];
    let open = d[0] + change.dot(at - at.floor()) - ndc.z
        <= margin + plan.count.snap * (change.x.abs() + change.y.abs());
    if open && d.iter().all(|depth| *depth > 0.0) && goes_on(base + IVec2::ONE, d[1] + d[2] - d[0]) {
        return false;
    }
    let depth_per_m = margin / bias_m;
    let far = depth_per_m * lift_m / facet.dot(towards).max(0.01);
    let face = &plan.faces[face_index as usize];
    let texel_m = face.texel_at_unit_w * clip.w;
    // Depth of the point's own surface per texel; beyond it, as past the corner of two walls, light is no concern of the point.
    let per_texel = depth_per_m * texel_m / facet.dot(towards).max(0.01);
    let own_slope = Vec2::new(-facet.dot(face.right.into()), facet.dot(face.up.into())) * per_texel;
    let deep = margin + own_slope.x.abs() + own_slope.y.abs();
    let ends = |texel: IVec2, expected: f32| {
        let found = depth_at(texel);
        let surface = ndc.z + own_slope.dot(texel.as_vec2() - at);
        found > 0.0 && found < expected - margin && found >= surface - deep
    };
    (0..4).any(|corner| {
        // The plane of this texel and those behind it, seen from the point.
        let inward = IVec2::new(1 - 2 * (corner & 1), 1 - 2 * (corner >> 1));
        let texel = base + IVec2::new(corner & 1, corner >> 1);
        let (x, y) = (inward * IVec2::X, inward * IVec2::Y);
        let own = depth_at(texel);
        let slope = own - Vec2::new(depth_at(texel - x), depth_at(texel - y));
        let next = own - 2.0 * slope - Vec2::new(depth_at(texel - 2 * x), depth_at(texel - 2 * y));
        // An occluder is above the surface; what bends away from it, as the next facet of a thing does, is below.
        let away = (texel.as_vec2() - at) * texel_m;
        let seen = Vec3::from(face.right) * away.x - Vec3::from(face.up) * away.y;
        let height_m = (seen + towards * ((own - ndc.z) / depth_per_m)).dot(facet);
        // At the three others it does not end: they see it, or what is before it as the floor beyond its foot, or nothing at
        // all.
        let is_plane = own > 0.0
            && next.abs().max_element() <= margin
            && height_m > 0.0
            && !ends(texel + x, own + slope.x)
            && !ends(texel + y, own + slope.y)
            && !ends(texel + x + y, own + slope.x + slope.y);
        let depth = own + slope.dot((at - texel.as_vec2()).abs()) - ndc.z;
        let steep = slope.x.abs() + slope.y.abs();
        is_plane && depth > margin + plan.count.snap * steep && depth < far + FILTER_WIDTH * steep
    })
}

/// A point moved along its normal until the filter's reach cannot meet the point's own surface.
pub(in crate::passes) fn lifted(plan: &ShadowPlan, face_index: u32, position: Vec3, normal: Vec3) -> Vec3 {
    let face: &Face = &plan.faces[face_index as usize];
    let w = position.extend(1.0).dot(face.projection().row(3));
    let texel = face.texel_at_unit_w * w.max(0.0);
    let slope = normal.dot(face.right.into()).abs() + normal.dot(face.up.into()).abs();
    position + normal * (texel * (FILTER_REACH * slope + FILTER_MARGIN) + plan.count.bias_m)
}
