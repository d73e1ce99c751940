//! Distance between probes, and the lattice over a scene.

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::FieldSettings;

use crate::geometry::lattice::snapped_size_m;

/// Share of a size below which the next finer one of {1, 1.5} × 2ⁿ is snapped to.
const FINER: f64 = 0.72;

/// Step of the lattice in metres: as set, or of {1, 1.5} × 2ⁿ the last from the scene's longest side down before
/// there are more points than `field_probes`.
pub fn spacing_m(bounds_m: [Vec3; 2], settings: &FieldSettings) -> f32 {
    if settings.field_spacing_m > 0.0 {
        return settings.field_spacing_m;
    }
    let [low_m, high_m] = bounds_m;
    let longest_m = (high_m - low_m).max_element().max(1e-6);
    let mut spacing_m = snapped_size_m(f64::from(longest_m)) as f32;
    let is_much = |spacing_m: f32| points(lattice(bounds_m, spacing_m).1) > u64::from(settings.field_probes);
    loop {
        let finer_m = snapped_size_m(f64::from(spacing_m) * FINER) as f32;
        if is_much(finer_m) {
            return spacing_m;
        }
        spacing_m = finer_m;
    }
}

/// Least point of the lattice, and the number of points along each axis.
pub fn lattice([low_m, high_m]: [Vec3; 2], spacing_m: f32) -> (IVec3, IVec3) {
    let low = (low_m / spacing_m).floor().as_ivec3();
    // A scene that ends on points of the lattice needs none beyond.
    let high = (high_m / spacing_m).ceil().as_ivec3();
    (low, high.saturating_sub(low).saturating_add(IVec3::ONE))
}

/// Points of a lattice.
pub fn points(size: IVec3) -> u64 {
    size.to_array().iter().map(|&along| u64::from(along.unsigned_abs())).fold(1, u64::saturating_mul)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacing_is_the_finest_that_has_no_more_points_than_asked_for() {
        let bounds_m = [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 2.0, 1.0)];
        let of = |field_probes: u32| FieldSettings { field_probes, field_spacing_m: 0.0, ..settings() };
        assert_eq!(spacing_m(bounds_m, &of(125)), 0.5);
        assert_eq!(spacing_m(bounds_m, &of(8)), 2.0);
        assert_eq!(points(lattice(bounds_m, 0.5).1), 125);
        let flat = [Vec3::ZERO, Vec3::new(4.0, 0.0, 4.0)];
        assert!(points(lattice(flat, spacing_m(flat, &of(100))).1) <= 100);
        assert_eq!(spacing_m(bounds_m, &FieldSettings { field_spacing_m: 0.3, ..settings() }), 0.3);
    }

    fn settings() -> FieldSettings {
        lightkiln_proto::kinds::grid::Settings::from_json(&serde_json::Value::Null).unwrap().field
    }
}
