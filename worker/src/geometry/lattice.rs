//! Sizes and cells of the world-aligned lattices: the same place has the same cell whatever else the scene holds.

use glam::{IVec3, Vec3};
use lightkiln_proto::ids::Digest;

/// The size of {1, 1.5} × 2^n nearest to `size_m` by ratio; sizes so chosen change seldom when a scene is edited.
pub fn snapped_size_m(size_m: f64) -> f64 {
    let mut step = 1.0_f64;
    while step > size_m {
        step *= 0.5;
    }
    while step * 2.0 <= size_m {
        step *= 2.0;
    }
    // step ≤ size < 2·step: the borders are the geometric means √1.5 and √3.
    let ratio = size_m / step;
    if ratio * ratio < 1.5 {
        step
    } else if ratio * ratio < 3.0 {
        step * 1.5
    } else {
        step * 2.0
    }
}

/// Cell of a point on the lattice of `step_m` through the world origin.
pub fn cell_of(point_m: Vec3, step_m: f32) -> IVec3 {
    (point_m / step_m).floor().as_ivec3()
}

/// Centre of a cell in metres.
pub fn centre_of(cell: IVec3, step_m: f32) -> Vec3 {
    (cell.as_vec3() + 0.5) * step_m
}

/// Identity of a cell of the lattice of `step_m`.
pub fn key_of(cell: IVec3, step_m: f32) -> u64 {
    let mut bytes = [0; 16];
    for (slot, value) in bytes.chunks_exact_mut(4).zip([cell.x, cell.y, cell.z]) {
        slot.copy_from_slice(&value.to_le_bytes());
    }
    bytes[12..].copy_from_slice(&step_m.to_bits().to_le_bytes());
    Digest::of(&bytes).short()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_snap_to_the_nearest_of_the_series() {
        for (given, wanted) in
            [(1.0, 1.0), (1.3, 1.5), (1.7, 1.5), (1.8, 2.0), (0.3, 0.25), (0.32, 0.375), (100.0, 96.0)]
        {
            assert_eq!(snapped_size_m(given), wanted, "{given}");
        }
    }

    #[test]
    fn cell_and_centre_agree_on_both_sides_of_the_origin() {
        for cell in [IVec3::new(-3, 0, 7), IVec3::ZERO, IVec3::splat(-1)] {
            assert_eq!(cell_of(centre_of(cell, 0.75), 0.75), cell);
        }
    }
}
