//! Clipping at the near plane, in homogeneous coordinates: z ≤ w.

use glam::{DVec4, Vec2};

/// A corner of a polygon in clip space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    /// Position in clip space.
    pub clip: DVec4,
    /// Weights of the source triangle's second and third corner.
    pub barycentric: Vec2,
}

impl Corner {
    fn inside(&self) -> f64 {
        self.clip.w - self.clip.z
    }

    fn between(&self, other: &Self) -> Self {
        let share = self.inside() / (self.inside() - other.inside());
        Self {
            clip: self.clip.lerp(other.clip, share),
            barycentric: self.barycentric.lerp(other.barycentric, share as f32),
        }
    }
}

/// Clips a triangle; gives a polygon and its number of corners: 0, 3 or 4.
pub(super) fn clip_near(corners: [Corner; 3]) -> ([Corner; 4], usize) {
    let mut polygon = [corners[0]; 4];
    let mut count = 0;
    if corners.iter().any(|corner| !corner.clip.is_finite()) {
        return (polygon, 0);
    }
    for index in 0..3 {
        let (this, next) = (corners[index], corners[(index + 1) % 3]);
        let (this_in, next_in) = (this.inside() >= 0.0, next.inside() >= 0.0);
        if this_in {
            polygon[count] = this;
            count += 1;
        }
        if this_in != next_in {
            // From the inside out, so that both triangles of a shared edge get the same point.
            polygon[count] = if this_in { this.between(&next) } else { next.between(&this) };
            count += 1;
        }
    }
    let whole = polygon[..count].iter().all(|corner| corner.clip.w > 0.0);
    (polygon, if whole { count } else { 0 })
}
