//! E_dir on the processor; twin of `shared/light.wgsl` and `texels.wgsl`, function by function. Rectangles: `rect.rs`.

use glam::{Affine3A, Vec2, Vec3, Vec4};
use lightkiln_proto::content::COVERAGE_POINTS;
use lightkiln_proto::relight::ReceiverTable;
use rayon::prelude::*;

use super::points::{ALL_LIT, FEW_POINTS, TexelPoints};
use super::rect::{half_cube_face, rect_irradiance, rect_unshadowed};
use crate::lights::Shape;
use crate::passes::shadow::look_up::{FILTER_REACH, is_behind, lifted, towards, visibility};
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{Light, ShadowPlan};
use crate::scene::turn_of;

const CASCADE_GUARD: f32 = 8.0;
const CASCADE_RIM: f32 = 0.1;
/// Least cosine that the filter's reach along a surface grows by.
const GRAZING_COS: f32 = 0.05;

/// `E_dir` at points in metres with their normals, in W·m⁻²; their space stands in that of the lights.
pub fn direct(
    positions_m: &[Vec4],
    normals: &[Vec4],
    world_from_scene: &Affine3A,
    plan: &ShadowPlan,
    maps: &ShadowMaps,
) -> Vec<Vec4> {
    let turn = turn_of(world_from_scene);
    let at = |(position, normal): (&Vec4, &Vec4)| {
        let normal = turn * normal.truncate();
        let position = world_from_scene.transform_point3(position.truncate());
        direct_irradiance(plan, maps, position, normal, normal).extend(0.0)
    };
    positions_m.par_iter().zip(normals).map(at).collect()
}

/// `E_dir` of receivers by slot, each the mean over the points of its texel, in W·m⁻²; their space stands in that of the lights. Twin of `texels.wgsl`.
pub fn direct_texels(
    receivers: &ReceiverTable,
    points: &TexelPoints,
    world_from_scene: &Affine3A,
    plan: &ShadowPlan,
    maps: &ShadowMaps,
) -> Vec<Vec4> {
    let turn = turn_of(world_from_scene);
    let of_slot = |slot: usize| {
        let own = (receivers.position_m[slot].truncate(), receivers.normal[slot].truncate());
        let texel = points.of(slot, own.0);
        let mut sum = Vec3::ZERO;
        for light in &plan.lights {
            let at = |(position, normal): (Vec3, Vec3)| {
                let (position, normal) = (world_from_scene.transform_point3(position), turn * normal);
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

/// Mean irradiance of a light over the points of a texel: of the first few, and of all where these do not agree or there are more
/// than one texel has.
fn mean_over(count: usize, at: impl Fn(usize) -> Vec4) -> Vec3 {
    // A receiver of more points stands for other texels.
    let few = if count > COVERAGE_POINTS as usize { count } else { count.min(FEW_POINTS) };
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

/// Irradiance of a lamp at a point that is seen, in W·m⁻², and the share of it that arrives: by cascades where it has some. Shadows are
/// those of `before`.
pub fn lamp_irradiance(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    light: &Light,
    [position, before]: [Vec3; 2],
    normal: Vec3,
    facet: Vec3,
) -> Vec4 {
    if light.shape == Shape::Rect as u32 {
        return rect_irradiance((plan, maps), light, [position, before], normal, facet);
    }
    let arriving = unshadowed(light, position, normal);
    if arriving.max_element() <= 0.0 {
        return Vec4::ZERO;
    }
    let share = share_seen((plan, maps), light, before, facet);
    (arriving * share).extend(share)
}

/// Irradiance of a lamp without shadows, in W·m⁻².
pub fn free_irradiance(plan: &ShadowPlan, light: &Light, position: Vec3, normal: Vec3) -> Vec3 {
    match light.shape == Shape::Rect as u32 {
        true => rect_unshadowed(plan, light, position, normal),
        false => unshadowed(light, position, normal),
    }
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
    let of_light = |light: &Light| free_irradiance(plan, light, position, normal);
    Shadowed {
        irradiance: direct_irradiance(plan, maps, position, normal, facet),
        unshadowed: plan.lights.iter().map(of_light).sum(),
        filter_m: plan.lights.iter().map(filter_m).fold(0.0, f32::max),
    }
}

/// Irradiance of one light in W·m⁻², and the share of it that arrives.
fn light_irradiance(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    light: &Light,
    position: Vec3,
    normal: Vec3,
    facet: Vec3,
) -> Vec4 {
    if light.shape == Shape::Rect as u32 {
        return rect_irradiance((plan, maps), light, [position; 2], normal, facet);
    }
    let arriving = unshadowed(light, position, normal);
    if arriving.max_element() <= 0.0 {
        return Vec4::ZERO;
    }
    let share = share_by((plan, maps), face_of(plan, light, position), light, position, facet);
    (arriving * share).extend(share)
}

/// A point lies beyond the box that a sun's maps are of: far from the core of its scene, where no map tells of shadows.
fn is_beyond(plan: &ShadowPlan, light: &Light, position: Vec3) -> bool {
    if light.shape != Shape::Sun as u32 {
        return false;
    }
    let first = &plan.faces[light.first_face as usize];
    let d = position - Vec3::from(light.position);
    let across = d.dot(first.right.into()).abs().max(d.dot(first.up.into()).abs());
    let depth = (first.projection() * position.extend(1.0)).z;
    across > light.half_extent || !(0.0..=1.0).contains(&depth)
}

/// Share of a light that arrives by one of its faces.
pub(in crate::passes) fn share_by(
    (plan, maps): (&ShadowPlan, &ShadowMaps),
    face: u32,
    light: &Light,
    position: Vec3,
    facet: Vec3,
) -> f32 {
    if is_beyond(plan, light, position) {
        return 1.0;
    }
    let mut read = face;
    let mut at = lifted(plan, face, position, facet);
    if face < light.first_face + light.face_count {
        // The lift may lead into the next face, to which the same surface has another slope.
        read = face_of(plan, light, at);
        at = lifted(plan, read, position, facet);
    }
    let share = visibility(plan, maps, read, at);
    let lift_m = at.distance(position);
    if share <= 0.0 || is_behind((plan, maps), face, light, position, facet, lift_m) {
        return 0.0;
    }
    share
}

/// Share of a light that arrives at a point that is seen: by the narrowest cascade that holds it, fading in at its rim.
fn share_seen((plan, maps): (&ShadowPlan, &ShadowMaps), light: &Light, position: Vec3, facet: Vec3) -> f32 {
    let by = |face| share_by((plan, maps), face, light, position, facet);
    for cascade in (0..light.cascades).rev() {
        let face = light.first_cascade + cascade;
        let clip = plan.faces[face as usize].projection() * position.extend(1.0);
        let inside = 1.0 - clip.x.abs().max(clip.y.abs()) - 2.0 * CASCADE_GUARD / maps.side as f32;
        if inside > 0.0 {
            let own = by(face);
            if inside >= CASCADE_RIM {
                return own;
            }
            let wider = by(if cascade == 0 { face_of(plan, light, position) } else { face - 1 });
            return wider + (own - wider) * (inside / CASCADE_RIM);
        }
    }
    by(face_of(plan, light, position))
}

pub(super) fn cube_face(d: Vec3) -> u32 {
    let a = d.abs();
    if a.x >= a.y && a.x >= a.z {
        return u32::from(d.x < 0.0);
    }
    if a.y >= a.z { 2 + u32::from(d.y < 0.0) } else { 4 + u32::from(d.z < 0.0) }
}

pub(in crate::passes) fn face_of(plan: &ShadowPlan, light: &Light, position: Vec3) -> u32 {
    let d = position - Vec3::from(light.position);
    if light.shape == Shape::Sun as u32 {
        let tiles = light.face_count.isqrt();
        let first = &plan.faces[light.first_face as usize];
        let across = Vec2::new(d.dot(first.right.into()), d.dot(first.up.into())) / light.half_extent;
        let tile = ((0.5 * across + 0.5) * tiles as f32).clamp(Vec2::ZERO, Vec2::splat(tiles as f32 - 0.5));
        return light.first_face + tile.y as u32 * tiles + tile.x as u32;
    }
    if light.shape == Shape::Rect as u32 {
        return light.first_face + half_cube_face(plan, light, d);
    }
    light.first_face + if light.face_count == 6 { cube_face(d) } else { 0 }
}

fn unshadowed(light: &Light, position: Vec3, normal: Vec3) -> Vec3 {
    let strength = Vec3::from(light.strength);
    let direction = Vec3::from(light.direction);
    if light.shape == Shape::Sun as u32 {
        return strength * normal.dot(-direction).max(0.0);
    }
    let d = Vec3::from(light.position) - position;
    let distance2 = d.length_squared().max(1e-30);
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
