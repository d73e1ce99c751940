//! Settings of a field, and of surfaces that have its light.

use crate::settings_group;

settings_group! {
    /// Probes in free space.
    FieldSettings {
        /// Distance between probes in metres; 0 chooses it from `field_probes`. Smaller → sharper light in free space, more probes, time
        /// and bytes with its cube.
        field_spacing_m: f32 = [0.0, 0.0, 0.0], |v| v == 0.0 || (1e-3..=1e4).contains(&v), "0 (automatic) or 0.001..=10000 m";
        /// Probes to aim at when `field_spacing_m` is 0. More → as a smaller `field_spacing_m`.
        field_probes: u32 = [500, 2000, 8000], |v| (8..=1_000_000).contains(&v), "8..=1000000";
        /// Rays per probe (a power of two). More → less noise, more time.
        probe_rays: u32 = [256, 1024, 2048], |v| v.is_power_of_two() && (64..=65_536).contains(&v), "a power of two in 64..=65536";
        /// Relative error of truncation of probes' rows, as `rank_error` is of receivers'. Smaller → higher ranks, more bytes.
        field_rank_error: f32 = [0.02, 0.01, 0.005], |v| (1e-5..=0.5).contains(&v), "0.00001..=0.5";
    }
}

settings_group! {
    /// Surfaces whose indirect light is the field's.
    LitSettings {
        /// Things of this size in metres or less, by the longest side of their bounds, have no rays of their own: their light is that of the
        /// probes around them, as with nodes that say `"kiln_lit": "probes"` in their extras. 0: those alone. More → less time, fewer bytes,
        /// no contact shadows of indirect light on small things.
        probe_lit_m: f32 = [0.0, 0.0, 0.0], |v| (0.0..=1e4).contains(&v), "0..=10000 m";
    }
}
