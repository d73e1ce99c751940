//! Settings of a relightable bake with a field in tetrahedra.

use crate::kind_settings;
use crate::kinds::field::FieldSettings;
use crate::kinds::prt::{self, PatchSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};

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
        /// Probes in free space.
        field: FieldSettings,
    }
}

impl Settings {
    /// Those of the relightable bake without its field.
    pub fn relightable(&self) -> prt::Settings {
        let Self { preset, texels, place, transport, patches, factors, .. } = self.clone();
        prt::Settings { preset, texels, place, transport, patches, factors }
    }
}
