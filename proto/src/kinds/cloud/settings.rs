//! Settings of a relightable bake with a field in tetrahedra.

use crate::kinds::field::{FieldSettings, LitSettings};
use crate::kinds::prt::{self, PatchSettings};
use crate::kinds::voxels::{VoxelPresence, VoxelSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

settings_group! {
    /// Probes in tetrahedra.
    CloudSettings {
        /// Whether probes are fitted to light between them (1) or have that of their own places (0). 1 → lower ranks, about the same error,
        /// thrice the time.
        field_fit: u32 = [0, 0, 0], |v| v <= 1, "0 or 1";
        /// Where probes stand: evenly (0); densest where transport between them would err most (1), as many as evenly; or where S2 has them by
        /// the lights of the scene file: spawned and merged by contrast (2), or moved to where light comes from (3). 1 to 3 →
        /// more time for the plan.
        field_placement: u32 = [0, 0, 0], |v| v <= 3, "0 (even), 1 (error), 2 (spawn and merge) or 3 (gradient)";
        /// Whether probes are added on both sides of surfaces that part two of them (1), as S2 has it, instead of where none is seen (0). 1 →
        /// more probes beside walls.
        field_leak_edges: u32 = [0, 0, 0], |v| v <= 1, "0 or 1";
        /// Most probes that placements 2 and 3 and leak edges make. More → contrasts spawn more probes, time and bytes with them.
        field_probes_max: u32 = [20_000, 20_000, 20_000], |v| (8..=20_000).contains(&v), "8..=20000";
    }
}

kind_settings! {
    /// Settings of a relightable bake with a field in tetrahedra.
    Settings of super::NAME => {
        /// Texels of the lightmap.
        texels: TexelSettings,
        /// Places of receivers.
        place: PlaceSettings,
        /// Rays.
        transport: TransportSettings,
        /// Patches, sky, near hits and the error of factors.
        patches: PatchSettings,
        /// Clusters and factors.
        factors: FactorSettings,
        /// Whether it has voxels.
        has_voxels: VoxelPresence,
        /// Voxels.
        voxels: VoxelSettings,
        /// Probes in free space.
        field: FieldSettings,
        /// Surfaces that have their light.
        lit: LitSettings,
        /// Their fit and their places.
        cloud: CloudSettings,
    }
}

/// Ways to place probes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placement {
    /// As far apart everywhere.
    Even,
    /// By the error of transport between them.
    Error,
    /// Spawned and merged by contrast of light.
    SpawnMerge,
    /// Moved to where light comes from.
    Gradient,
}

impl CloudSettings {
    /// Where probes stand.
    pub fn placement(&self) -> Placement {
        match self.field_placement {
            1 => Placement::Error,
            2 => Placement::SpawnMerge,
            3 => Placement::Gradient,
            _ => Placement::Even,
        }
    }
}

impl Settings {
    /// Those of the relightable bake without its field.
    pub fn relightable(&self) -> prt::Settings {
        let Self { preset, texels, place, transport, patches, factors, has_voxels, voxels, .. } =
            self.clone();
        prt::Settings { preset, texels, place, transport, patches, factors, has_voxels, voxels }
    }
}
