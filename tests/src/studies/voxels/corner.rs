//! Values at a corner of a voxel, and their means.

use glam::Vec3;

/// Values at a corner. A mean counts what is empty as 0: values are kept times what they are weighted by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corner {
    /// Share of light along each axis that is stopped.
    pub opacity: Vec3,
    /// Share of the place that is filled.
    pub weight: f32,
    /// Of `axes`: light towards −x, +x, −y, +y, −z, +z. Of `lobes`: [`lobe`].
    pub values: [Vec3; 6],
}

/// Places of the values of `lobes`.
pub mod lobe {
    /// Albedo ρ.
    pub const ALBEDO: usize = 0;
    /// Mean normal.
    pub const NORMAL: usize = 1;
    /// Mean direction towards the light.
    pub const LIGHT_DIRECTION: usize = 2;
    /// Incoming light.
    pub const INCOMING: usize = 3;
}

impl Corner {
    /// The sum of corners by weights.
    pub fn sum<'a>(corners: impl IntoIterator<Item = (&'a Self, f32)>) -> Self {
        corners.into_iter().fold(Self::default(), |sum, (corner, share)| Self {
            opacity: sum.opacity + corner.opacity * share,
            weight: sum.weight + corner.weight * share,
            values: std::array::from_fn(|at| sum.values[at] + corner.values[at] * share),
        })
    }

    /// The mean of two.
    pub fn between(&self, other: &Self, share: f32) -> Self {
        Self::sum([(self, 1.0 - share), (other, share)])
    }

    /// A value as it is where the place is filled; 0 where nothing is.
    pub fn unweighted(&self, at: usize) -> Vec3 {
        if self.weight > 0.0 { self.values[at] / self.weight } else { Vec3::ZERO }
    }
}

/// The place of light towards an axis, which points up it or down.
pub fn towards(axis: usize, is_up: bool) -> usize {
    2 * axis + usize::from(is_up)
}
