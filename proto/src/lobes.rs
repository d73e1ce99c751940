//! Means of distances over lobes of a power of the cosine, as fields of other engines keep them (\[Luo2022\], eq. 4.9).

use std::sync::LazyLock;

use glam::Vec3;

use crate::harmonics::relight_direction;

/// Farthest distance that counts: one and a half diagonals of a cell, in steps of the lattice.
pub const FARTHEST: f32 = 2.598_076;
/// Directions in which a probe's depth is asked for.
const RAYS: u32 = 4096;
/// Power of the cosine.
const SHARPNESS: i32 = 50;
/// Least weight that counts.
const WEIGHT_MIN: f32 = 1e-3;

static DIRECTIONS: LazyLock<Vec<Vec3>> =
    LazyLock::new(|| (0..RAYS).map(|ray| relight_direction(ray, RAYS)).collect());

/// Directions of all lobes; numbers of [`Lobe`] count them.
pub fn directions() -> &'static [Vec3] {
    &DIRECTIONS
}

/// Directions around one of them, and their weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Lobe(Vec<(u32, f32)>);

impl Lobe {
    /// Around a direction of length 1.
    pub fn around(direction: Vec3) -> Self {
        let weight = |of: &Vec3| direction.dot(*of).max(0.0).powi(SHARPNESS);
        let all = (0..).zip(directions()).map(|(ray, of)| (ray, weight(of)));
        let found: Vec<(u32, f32)> = all.filter(|(_, weight)| *weight > WEIGHT_MIN).collect();
        let sum: f32 = found.iter().map(|(_, weight)| weight).sum();
        Self(found.into_iter().map(|(ray, weight)| (ray, weight / sum)).collect())
    }

    /// Mean of distances and of their squares, by direction's number.
    pub fn moments(&self, distance: impl Fn(usize) -> f32) -> [f32; 2] {
        self.0.iter().fold([0.0; 2], |[mean, square], (ray, weight)| {
            let distance = distance(*ray as usize);
            [mean + weight * distance, square + weight * distance * distance]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lobes_add_up_to_one_and_lie_around_their_direction() {
        for direction in [Vec3::X, Vec3::NEG_Z, Vec3::new(0.6, -0.48, 0.64)] {
            let lobe = Lobe::around(direction);
            let of = |of: &dyn Fn(Vec3) -> f32| lobe.moments(|ray| of(directions()[ray]));
            let [mean, square] = of(&|_| 2.0);
            assert!((mean - 2.0).abs() < 1e-4 && (square - 4.0).abs() < 1e-4, "{mean} {square}");
            // The mean of x over x^50 is 51/52.
            let [mean, _] = of(&|ray| ray.dot(direction));
            assert!((mean - 51.0 / 52.0).abs() < 2e-3, "{mean}");
        }
    }
}
