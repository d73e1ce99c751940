//! Rays of lamps without extent, as seen from the lamp: a unit square of them for each.

use std::f64::consts::TAU;

use glam::{Vec2, Vec3};

use super::Site;
use super::punctual::{Punctual, Shape};
use crate::rays::sampling::tangent_frame;

/// Share by which a sun's rectangle is wider than the scene.
const MARGIN: f32 = 1e-3;

/// The rays of one lamp.
#[derive(Clone, Copy, Debug)]
pub(super) enum Beam {
    /// Parallel rays through a rectangle before the scene.
    Sun { corner_m: Vec3, u: Vec3, v: Vec3, size_m: Vec2, direction: Vec3 },
    /// Rays from a point, even over the cap about `axis`.
    Lamp { position_m: Vec3, axis: Vec3, u: Vec3, v: Vec3, cos_outer: f32 },
}

impl Beam {
    /// The rays of a lamp that can reach a scene of these bounds.
    pub fn of(lamp: &Punctual, [low, high]: [Vec3; 2]) -> Self {
        match lamp.shape {
            Shape::Sun { towards } => {
                let direction = -towards;
                let (u, v) = tangent_frame(direction);
                let middle = (low + high) * 0.5;
                let half = (high - low) * (0.5 + MARGIN);
                let reach = |axis: Vec3| axis.abs().dot(half).max(f32::MIN_POSITIVE);
                let corner_m = middle - u * reach(u) - v * reach(v) - direction * (2.0 * reach(direction));
                Self::Sun { corner_m, u, v, size_m: 2.0 * Vec2::new(reach(u), reach(v)), direction }
            }
            Shape::Lamp { position_m, cone, .. } => {
                let (axis, cos_outer) = cone.map_or((Vec3::Z, -1.0), |cone| (cone.direction, cone.cos_outer));
                let (u, v) = tangent_frame(axis);
                Self::Lamp { position_m, axis, u, v, cos_outer }
            }
        }
    }

    /// Origin and direction of the ray of a point of the square.
    pub fn ray(&self, [s, t]: [f32; 2]) -> (Vec3, Vec3) {
        match *self {
            Self::Sun { corner_m, u, v, size_m, direction } => {
                (corner_m + u * (s * size_m.x) + v * (t * size_m.y), direction)
            }
            Self::Lamp { position_m, axis, u, v, cos_outer } => {
                let cosine = 1.0 - s * (1.0 - cos_outer);
                let radius = (1.0 - cosine * cosine).max(0.0).sqrt();
                let (y, x) = libm::sincosf(t * std::f32::consts::TAU);
                (position_m, u * (radius * x) + v * (radius * y) + axis * cosine)
            }
        }
    }

    /// Point of the square whose ray passes a place that the lamp lights.
    pub fn square_at(&self, position_m: Vec3) -> [f32; 2] {
        let within = |share: f32| share.clamp(0.0, 1.0 - f32::EPSILON / 2.0);
        match *self {
            Self::Sun { corner_m, u, v, size_m, .. } => {
                let from = position_m - corner_m;
                [within(from.dot(u) / size_m.x), within(from.dot(v) / size_m.y)]
            }
            Self::Lamp { position_m: lamp_m, axis, u, v, cos_outer } => {
                let towards = (position_m - lamp_m).normalize_or(axis);
                let turn = libm::atan2f(towards.dot(v), towards.dot(u)) / std::f32::consts::TAU;
                [within((1.0 - towards.dot(axis)) / (1.0 - cos_outer)), within(turn - turn.floor())]
            }
        }
    }

    /// Density per m² with which rays of even density over the square end on a site that the lamp lights.
    pub fn density(&self, site: &Site) -> f64 {
        match *self {
            Self::Sun { size_m, direction, .. } => {
                f64::from(-direction.dot(site.face_normal)).max(0.0) / f64::from(size_m.x * size_m.y)
            }
            Self::Lamp { position_m, cos_outer, .. } => {
                let from = site.position_m - position_m;
                let squared_m2 = f64::from(from.length_squared()).max(f64::MIN_POSITIVE);
                let cosine = f64::from(-from.dot(site.face_normal)).max(0.0) / squared_m2.sqrt();
                cosine / (squared_m2 * TAU * f64::from(1.0 - cos_outer))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::scene::{LightKind, SceneLight};

    use super::*;
    use crate::rays::sampling::R2;

    fn beams() -> Vec<Beam> {
        let direction = [0.3, -0.8, 0.2];
        let position_m = [0.4, 0.9, 0.6];
        let kinds = [
            LightKind::Sun { direction },
            LightKind::Point { position_m, range_m: None },
            LightKind::Spot { position_m, direction, inner_rad: 0.2, outer_rad: 0.5, range_m: None },
        ];
        let beam = |kind| {
            let lamp = Punctual::new(&SceneLight { name: String::new(), kind, strength: [1.0; 3] }).unwrap();
            Beam::of(&lamp, [Vec3::ZERO, Vec3::ONE])
        };
        kinds.map(beam).into()
    }

    #[test]
    fn a_place_on_a_ray_leads_back_to_its_point_of_the_square() {
        for beam in beams() {
            let points = R2::new(6);
            for index in 0..200 {
                let [s, t] = points.point(index);
                let (origin_m, direction) = beam.ray([s, t]);
                let [found_s, found_t] = beam.square_at(origin_m + direction * 1.7);
                let off_t = (found_t - t).abs();
                assert!((found_s - s).abs() < 1e-4 && off_t.min(1.0 - off_t) < 1e-3, "{beam:?} {s} {t}");
            }
        }
    }

    #[test]
    fn density_is_the_number_of_rays_that_end_on_an_area() {
        let square = |site: &Site, point: Vec3| {
            (point.x - site.position_m.x).abs() < 0.05 && (point.z - site.position_m.z).abs() < 0.05
        };
        let site = Site { position_m: Vec3::new(0.6, 0.0, 0.7), normal: Vec3::Y, face_normal: Vec3::Y };
        for beam in beams() {
            let points = R2::new(7);
            let count = 200_000;
            let ends = (0..count).filter(|&index| {
                let (origin_m, direction) = beam.ray(points.point(index));
                direction.y < 0.0 && square(&site, origin_m - direction * (origin_m.y / direction.y))
            });
            let found = ends.count() as f64 / f64::from(count) / 0.01;
            let stated = beam.density(&site);
            assert!((found / stated - 1.0).abs() < 0.03, "{beam:?}: {found} and {stated}");
        }
    }
}
