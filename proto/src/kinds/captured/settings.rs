//! Settings of a field under the lights of the scene's file.

use crate::kinds::cloud::CloudSettings;
use crate::kinds::field::FieldSettings;
use crate::kinds::grid::LatticeSettings;
use crate::{kind_settings, settings_group};

settings_group! {
    /// Probes that capture light.
    CaptureSettings {
        /// Whether probes stand on a lattice (0) or in tetrahedra (1).
        field_structure: u32 = [0, 0, 0], |v| v <= 1, "0 (lattice) or 1 (tetrahedra)";
        /// Whether probes are fitted to light between them (1) or have that of their own places (0). 1 → less error between the probes of a
        /// lattice, thrice the time.
        field_fit: u32 = [0, 0, 0], |v| v <= 1, "0 or 1";
        /// Whether probes of a lattice are moved out of geometry, and more stand where none of those of a cell sees (1), or stand at points of
        /// the lattice as they are (0).
        field_moves: u32 = [1, 1, 1], |v| v <= 1, "0 or 1";
        /// Where probes in tetrahedra stand: evenly (0), or where S2 has them by the lights of the scene file: spawned and merged by contrast
        /// (2), or moved to where light comes from (3); or densest where transport between them would err most (1).
        field_placement: u32 = [0, 0, 0], |v| v <= 3, "0 (even), 1 (error), 2 (spawn and merge) or 3 (gradient)";
        /// Whether probes in tetrahedra are added on both sides of surfaces that part two of them (1), instead of where none is seen (0).
        field_leak_edges: u32 = [0, 0, 0], |v| v <= 1, "0 or 1";
        /// Most probes that placements 2 and 3 and leak edges make. More → contrasts spawn more probes, time and bytes with them.
        field_probes_max: u32 = [20_000, 20_000, 20_000], |v| (8..=20_000).contains(&v), "8..=20000";
        /// Paths that go on from each surface that a probe's rays meet. More → less noise, more time.
        field_paths: u32 = [1, 2, 4], |v| (1..=1024).contains(&v), "1..=1024";
        /// Shadow rays from a probe to emissive surfaces. More → less noise of lamps, more time.
        field_emitter_rays: u32 = [64, 128, 256], |v| (1..=65_536).contains(&v), "1..=65536";
    }
}

kind_settings! {
    /// Settings of a field under the lights of the scene's file.
    Settings of super::NAME => {
        /// Probes in free space.
        field: FieldSettings,
        /// Their structure, places and light.
        capture: CaptureSettings,
    }
}

/// Space between probes.
#[derive(Clone, Debug, PartialEq)]
pub enum Structure {
    /// A lattice.
    Lattice(LatticeSettings),
    /// Tetrahedra.
    Tetrahedra(CloudSettings),
}

impl CaptureSettings {
    /// Where probes stand, and what is between them.
    pub fn structure(&self) -> Structure {
        let &Self { field_fit, field_moves, field_placement, field_leak_edges, field_probes_max, .. } = self;
        if self.field_structure == 0 {
            return Structure::Lattice(LatticeSettings { field_fit, field_moves });
        }
        Structure::Tetrahedra(CloudSettings {
            field_fit,
            field_placement,
            field_leak_edges,
            field_probes_max,
        })
    }
}
