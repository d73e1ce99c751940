//! Counts of the rays that are cast, by kind: made where rays are cast, so that none is left out.

use std::cell::Cell;
use std::ops::AddAssign;

/// Rays cast, by kind. No ray is of two kinds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RayCount {
    /// Rays that look for the nearest hit.
    pub closest: u64,
    /// Rays that ask whether something lies between two points.
    pub occlusion: u64,
    /// Rays of either sort that look for walls between a hit and the receivers around it.
    pub linking: u64,
}

impl RayCount {
    /// Rays of all kinds.
    pub fn total(&self) -> u64 {
        self.closest + self.occlusion + self.linking
    }
}

impl AddAssign for RayCount {
    fn add_assign(&mut self, other: Self) {
        self.closest += other.closest;
        self.occlusion += other.occlusion;
        self.linking += other.linking;
    }
}

thread_local! {
    /// Rays of this thread that nobody has counted yet.
    static CAST: Cell<RayCount> = const { Cell::new(RayCount { closest: 0, occlusion: 0, linking: 0 }) };
}

/// Notes rays that this thread has cast.
pub(super) fn note(cast: RayCount) {
    CAST.with(|all| {
        let mut sum = all.get();
        sum += cast;
        all.set(sum);
    });
}

/// Does work of one thread, and counts the rays that it casts itself: not those of work that counts its own within it,
/// which may be another task's that this thread takes up while it waits.
pub fn counted<T>(work: impl FnOnce() -> T) -> (T, RayCount) {
    let before = CAST.replace(RayCount::default());
    let done = work();
    (done, CAST.replace(before))
}

/// Does work whose rays count as linking ones.
pub fn linking<T>(work: impl FnOnce() -> T) -> T {
    let (done, cast) = counted(work);
    note(RayCount { linking: cast.total(), ..RayCount::default() });
    done
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::rays::Tracer;

    #[test]
    fn rays_are_counted_by_kind_and_by_those_who_count_them_alone() {
        let tracer = Tracer::new(&[[Vec3::X, Vec3::Y, Vec3::Z]], None);
        let closest = || tracer.closest(Vec3::ZERO, Vec3::ONE, f32::INFINITY);
        let occluded = || tracer.is_occluded(Vec3::ZERO, Vec3::ONE);
        let (inner, outer) = counted(|| {
            closest();
            occluded();
            linking(|| (closest(), occluded()));
            counted(|| [closest(), closest()]).1
        });
        assert_eq!(inner, RayCount { closest: 2, occlusion: 0, linking: 0 });
        assert_eq!(outer, RayCount { closest: 1, occlusion: 1, linking: 2 });
        assert_eq!(counted(|| ()).1, RayCount::default());
    }
}
