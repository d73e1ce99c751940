//! Light of emitters that an object keeps from others: points of the emitters, and the object as each sees it; twin of `silhouettes.wgsl`.

use glam::{Affine3A, Mat4, Vec2, Vec3, Vec4};

use crate::passes::shadow::look_up::lifted;
use crate::passes::shadow::reference::{ShadowMaps, draw_own};
use crate::passes::shadow::{Face, SIGHT_SIDE, ShadowPlan};
use crate::scene::LoadedScene;

/// Least distance of a point from an object's middle in radii: what is nearer sees no more than this much of it.
const OUTSIDE: f32 = 1.05;

/// A point that stands for emitters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmitterPoint {
    /// Place.
    pub position_m: Vec3,
    /// Their area.
    pub area_m2: f32,
    /// Radiance times area, W·sr⁻¹.
    pub radiant: Vec3,
    /// Length of their mean normal: 1 of a plane, 0 of a ball.
    pub flatness: f32,
    /// Unit normal, 0 of none.
    pub normal: Vec3,
}

/// Points of emitters that an object has before it, and the object as they see it.
#[derive(Clone, Debug, Default)]
pub struct Silhouettes {
    points: Vec<EmitterPoint>,
    plan: Option<ShadowPlan>,
    maps: ShadowMaps,
}

impl EmitterPoint {
    /// Irradiance in W·m⁻² without occluders at a place, about a normal or facing it.
    pub fn irradiance(&self, at_m: Vec3, normal: Option<Vec3>) -> Vec3 {
        let way_m = self.position_m - at_m;
        let squared = way_m.length_squared();
        let towards = way_m * squared.max(1e-30).sqrt().recip();
        let received = normal.map_or(1.0, |normal| normal.dot(towards).max(0.0));
        let facing = (-self.normal.dot(towards)).max(0.0);
        let sent = 0.25 + (facing - 0.25) * self.flatness;
        self.radiant * (received * sent / (squared + self.area_m2 * std::f32::consts::FRAC_1_PI))
    }

    /// As the shader has it.
    pub fn rows(&self) -> [Vec4; 3] {
        [self.position_m.extend(self.area_m2), self.radiant.extend(self.flatness), self.normal.extend(0.0)]
    }
}

/// Face in which each point sees an object, whose bounding ball is at `middle_m` in a scene with such bounds.
pub fn silhouette_plan(
    points: &[EmitterPoint],
    (middle_m, radius_m): (Vec3, f32),
    bounds_m: [[f32; 3]; 2],
) -> ShadowPlan {
    let frustum = |point: &EmitterPoint| {
        let way_m = middle_m - point.position_m;
        let ratio = (way_m.length() / radius_m.max(f32::MIN_POSITIVE)).max(OUTSIDE);
        (point.position_m, way_m.normalize_or(Vec3::NEG_Y), (ratio * ratio - 1.0).sqrt().recip())
    };
    ShadowPlan::frusta(points.iter().map(frustum), bounds_m, SIGHT_SIDE)
}

impl Silhouettes {
    /// Of an object's own meshes at a place.
    pub fn new(
        points: Vec<EmitterPoint>,
        plan: ShadowPlan,
        (object, world_from_object): (&LoadedScene, &Affine3A),
    ) -> Self {
        if points.is_empty() {
            return Self::default();
        }
        let place = Mat4::from(*world_from_object);
        let in_object =
            |face: &Face| Face { clip_from_world: (face.projection() * place).to_cols_array_2d(), ..*face };
        let local = ShadowPlan { faces: plan.faces.iter().map(in_object).collect(), ..plan.clone() };
        let maps = draw_own(object, &local);
        Self { points, plan: Some(plan), maps }
    }

    /// Irradiance in W·m⁻² that the object keeps from a point about a normal.
    pub fn kept(&self, at_m: Vec3, normal: Vec3) -> Vec3 {
        let of = |(index, point): (usize, &EmitterPoint)| {
            let light = point.irradiance(at_m, Some(normal));
            if light == Vec3::ZERO { light } else { light * self.covered(index, at_m) }
        };
        self.points.iter().enumerate().map(of).sum()
    }

    /// Irradiance in W·m⁻² that it has itself at a point of its surface about a normal.
    pub fn given(&self, at_m: Vec3, normal: Vec3, facet: Vec3) -> Vec3 {
        let Some(plan) = &self.plan else { return Vec3::ZERO };
        let of = |(index, point): (usize, &EmitterPoint)| {
            let light = point.irradiance(at_m, Some(normal));
            if light == Vec3::ZERO {
                return light;
            }
            light * (1.0 - self.covered(index, lifted(plan, index as u32, at_m, facet)))
        };
        self.points.iter().enumerate().map(of).sum()
    }

    /// Share of a point of emitters that the object covers, from 4 × 4 texels as shadow maps have it.
    fn covered(&self, face: usize, at_m: Vec3) -> f32 {
        let Some(plan) = &self.plan else { return 0.0 };
        let clip = plan.faces[face].projection() * at_m.extend(1.0);
        if clip.w <= 0.0 || clip.x.abs().max(clip.y.abs()) > clip.w {
            return 0.0;
        }
        let depth = clip.z / clip.w;
        let at = (Vec2::new(clip.x, -clip.y) / clip.w * 0.5 + 0.5) * SIGHT_SIDE as f32 - 0.5;
        let base = at.floor();
        let share = at - base;
        let [of_x, of_y] = [share.x, share.y].map(|share| [1.0 - share, 1.0, 1.0, share]);
        let mut covered = 0.0;
        for (row, of_y) in (-1..3).zip(of_y) {
            for (column, of_x) in (-1..3).zip(of_x) {
                let texel = base.as_ivec2() + glam::IVec2::new(column, row);
                if self.maps.depth_at(face as u32, texel) > depth {
                    covered += of_x * of_y;
                }
            }
        }
        covered / 9.0
    }
}
