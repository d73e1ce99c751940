//! Settings of a relightable bake with a field on a lattice.

use crate::kinds::field::{FieldSettings, LitSettings};
use crate::kinds::prt::{self, PatchSettings};
use crate::kinds::voxels::{VoxelPresence, VoxelSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

settings_group! {
    /// Probes of a lattice.
    LatticeSettings {
        /// Whether probes are fitted to light between them (1) or have that of their own places (0). 1 → less error between probes, thrice
        /// the time.
        field_fit: u32 = [1, 1, 1], |v| v <= 1, "0 or 1";
        /// Whether probes are moved out of geometry, and more stand where none of those of a cell sees (1), or stand at points of the lattice
        /// as they are (0), as elsewhere: to compare. 1 → less light through walls, less that is unlit.
        field_moves: u32 = [1, 1, 1], |v| v <= 1, "0 or 1";
    }
}

kind_settings! {
    /// Settings of a relightable bake with a field on a lattice.
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
        /// Where they stand.
        lattice: LatticeSettings,
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
