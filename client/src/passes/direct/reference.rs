//! E_dir on the processor; twin of `shared/light.wgsl`, `direct.wgsl` and `texels.wgsl`, function by function.

use glam::{IVec2, Vec2, Vec3, Vec4};
use lightkiln_proto::relight::ReceiverTable;
use rayon::prelude::*;

use super::points::{ALL_LIT, FEW_POINTS, TexelPoints};
use crate::lights::Shape;
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{Face, Light, ShadowPlan};

const FILTER_REACH: f32 = 2.0;
const FILTER_MARGIN: f32 = 0.5;
const FILTER_WIDTH: f32 = 4.0;
const PARALLEL_BIAS: f32 = 0.1;
const SNAP: f32 = 0.007_812_5;
/// Least cosine that the filter's reach along a surface grows by.
const GRAZING_COS: f32 = 0.05;

/// `E_dir` at points in metres with their normals, in W·m⁻².
pub fn direct(positions_m: &[Vec4], normals: &[Vec4], plan: &ShadowPlan, maps: &ShadowMaps) -> Vec<Vec4> {
    let at = |(position, normal): (&Vec4, &Vec4)| {
        let normal = normal.truncate();
        direct_irradiance(plan, maps, position.truncate(), normal, normal).extend(0.0)
    };
    positions_m.par_iter().zip(normals).map(at).collect()
}

/// `E_dir` of receivers by slot, each the mean over the points of its texel, in W·m⁻²; twin of `texels.wgsl`.
pub fn direct_texels(
    receivers: &ReceiverTable,
    points: &TexelPoints,
    plan: &ShadowPlan,
    maps: &ShadowMaps,
) -> Vec<Vec4> {
    let of_slot = |slot: usize| {
        let own = (receivers.position_m[slot].truncate(), receivers.normal[slot].truncate());
        let texel = points.of(slot, own.0);
        let mut sum = Vec3::ZERO;
        for light in &plan.lights {
            let at = |(position, normal): (Vec3, Vec3)| {
                light_irradiance((plan, maps), light, position, normal, normal)
            };
            sum += match texel.len() {
                0 => at(own).truncate(),
                _ => mean_over(texel.len(), |point| at(texel.point(point))),
            };
        }
        sum.extend(0.0)
    };
    (0..receivers.len()).into_par_iter().map(of_slot).collect()
}

/// Mean irradiance of a light over the points of a texel: of the first few, and of all where these do not agree.
fn mean_over(count: usize, at: impl Fn(usize) -> Vec4) -> Vec3 {
    let few = count.min(FEW_POINTS);
    let (mut sum, mut least, mut most) = (Vec3::ZERO, 1.0_f32, 0.0_f32);
    for point in 0..few {
        let found = at(point);
        sum += found.truncate();
        (least, most) = (least.min(found.w), most.max(found.w));
    }
    if most <= 0.0 || least >= ALL_LIT {
        return sum / few as f32;
    }
    (few..count).for_each(|point| sum += at(point).truncate());
    sum / count as f32
}

/// Irradiance of all lights at a point, shadowed, in W·m⁻²; `facet` is the surface's own normal.
pub fn direct_irradiance(
    plan: &ShadowPlan,
    maps: &ShadowMaps,
    position: Vec3,
    normal: Vec3,
    facet: Vec3,
) -> Vec3 {
    let of_light = |light| light_irradiance((plan, maps), light, position, normal, facet).truncate();
    plan.lights.iter().map(of_light).sum()
}

/// Direct light of a point, and what its shadows are judged by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shadowed {
    /// Irradiance of all lights, shadowed, in W·m⁻².
    pub irradiance: Vec3,
    /// The same without shadows.
    pub unshadowed: Vec3,
    /// Reach of the widest of the lights' filters along the surface, in metres.
    pub filter_m: f32,
}

/// As [`direct_irradiance`], with what its shadows are judged by.
pub fn shadowed(plan: &ShadowPlan, maps: &ShadowMaps, position: Vec3, normal: Vec3, facet: Vec3) -> Shadowed {
    let filter_m = |light: &Light| {
        let face = &plan.faces[face_of(plan, light, position) as usize];
        let texel_m = face.texel_at_unit_w * position.extend(1.0).dot(face.projection().row(3)).max(0.0);
        let cosine = facet.dot(towards(light, position)).max(GRAZING_COS);
        // The filter's corner lies this far from its middle.
        std::f32::consts::SQRT_2 * FILTER_REACH * texel_m / cosine
    };
    Shadowed {
        irradiance: direct_irradiance(plan, maps, position, normal, facet),
        unshadowed: plan.lights.iter().map(|light| unshadowed(light, position, normal)).sum(),
        filter_m: plan.lights.iter().map(filter_m).fold(0.0, f32::max),
    }
}

/// Unit vector towards a light.
fn towards(light: &Light, position: Vec3) -> Vec3 {
    if light.shape == Shape::Sun as u32 {
        return -Vec3::from(light.direction);
    }
    (Vec3::from(light.position) - position).normalize_or(Vec3::Y)
}

/// Irradiance of one light in W·m⁻², and the share of it that arrives.
fn light_irradiance(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    light: &Light,
    position: Vec3,
    normal: Vec3,
    facet: Vec3,
) -> Vec4 {
    let arriving = unshadowed(light, position, normal);
    if arriving.max_element() <= 0.0 {
        return Vec4::ZERO;
    }
    let face = face_of(plan, light, position);
    let at = lifted(plan, face, position, facet);
    let share = visibility(plan, maps, face_of(plan, light, at), at);
    let lift_m = at.distance(position);
    if share <= 0.0 || is_behind((plan, maps), face, light, position, facet, lift_m) {
        return Vec4::ZERO;
    }
    (arriving * share).extend(share)
}

fn cube_face(d: Vec3) -> u32 {
    let a = d.abs();
    if a.x >= a.y && a.x >= a.z {
        return u32::from(d.x < 0.0);
    }
    if a.y >= a.z { 2 + u32::from(d.y < 0.0) } else { 4 + u32::from(d.z < 0.0) }
}

fn face_of(plan: &ShadowPlan, light: &Light, position: Vec3) -> u32 {
    let d = position - Vec3::from(light.position);
    if light.shape == Shape::Sun as u32 {
        let tiles = light.face_count.isqrt();
        let first = &plan.faces[light.first_face as usize];
        let across = Vec2::new(d.dot(first.right.into()), d.dot(first.up.into())) / light.half_extent;
        let tile = ((0.5 * across + 0.5) * tiles as f32).clamp(Vec2::ZERO, Vec2::splat(tiles as f32 - 0.5));
        return light.first_face + tile.y as u32 * tiles + tile.x as u32;
    }
    light.first_face + if light.face_count == 6 { cube_face(d) } else { 0 }
}

fn visibility(plan: &ShadowPlan, maps: &ShadowMaps, face_index: u32, position: Vec3) -> f32 {
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
            if map[texel(base.y, row) * side + texel(base.x, column)] <= ndc.z {
                lit += weight_x * weight_y;
            }
        }
    }
    lit / 9.0
}

fn is_behind(
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
    let open =
        d[0] + change.dot(at - at.floor()) - ndc.z <= margin + SNAP * (change.x.abs() + change.y.abs());
    if open && d.iter().all(|depth| *depth > 0.0) && goes_on(base + IVec2::ONE, d[1] + d[2] - d[0]) {
        return false;
    }
    let depth_per_m = margin / bias_m;
    let far = depth_per_m * lift_m / facet.dot(towards).max(0.01);
    let face = &plan.faces[face_index as usize];
    let texel_m = face.texel_at_unit_w * clip.w;
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
        // The three others go on with it, or see nothing at all.
        let is_plane = own > 0.0
            && next.abs().max_element() <= margin
            && height_m > 0.0
            && goes_on(texel + x, own + slope.x)
            && goes_on(texel + y, own + slope.y)
            && goes_on(texel + x + y, own + slope.x + slope.y);
        let depth = own + slope.dot((at - texel.as_vec2()).abs()) - ndc.z;
        let steep = slope.x.abs() + slope.y.abs();
        is_plane && depth > margin + SNAP * steep && depth < far + FILTER_WIDTH * steep
    })
}

fn lifted(plan: &ShadowPlan, face_index: u32, position: Vec3, normal: Vec3) -> Vec3 {
    let face: &Face = &plan.faces[face_index as usize];
    let w = position.extend(1.0).dot(face.projection().row(3));
    let texel = face.texel_at_unit_w * w.max(0.0);
    let slope = normal.dot(face.right.into()).abs() + normal.dot(face.up.into()).abs();
    position + normal * (texel * (FILTER_REACH * slope + FILTER_MARGIN) + plan.count.bias_m)
}

fn unshadowed(light: &Light, position: Vec3, normal: Vec3) -> Vec3 {
    let strength = Vec3::from(light.strength);
    let direction = Vec3::from(light.direction);
    if light.shape == Shape::Sun as u32 {
        return strength * normal.dot(-direction).max(0.0);
    }
    let d = Vec3::from(light.position) - position;
    let distance2 = d.length_squared().max(1e-8);
    let towards = d / distance2.sqrt();
    let mut factor = normal.dot(towards).max(0.0) / distance2;
    if light.range_m > 0.0 {
        let share2 = distance2 / (light.range_m * light.range_m);
        factor *= (1.0 - share2 * share2).clamp(0.0, 1.0);
    }
    if light.shape == Shape::Spot as u32 {
        let cosine = direction.dot(-towards);
        let cone = (cosine - light.cone_cos_outer) / (light.cone_cos_inner - light.cone_cos_outer);
        factor *= cone.clamp(0.0, 1.0).powi(2);
    }
    strength * factor
}
