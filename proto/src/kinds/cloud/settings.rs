//! Settings of a relightable bake with a field in tetrahedra.

use crate::kinds::field::FieldSettings;
use crate::kinds::prt::{self, PatchSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::{kind_settings, settings_group};

settings_group! {
    /// Probes in tetrahedra.
    CloudSettings {
        /// Whether probes are fitted to light between them (1) or have that of their own places (0). 1 → lower ranks, about the same error,
        /// thrice the time.
        field_fit: u32 = [0, 0, 0], |v| v <= 1, "0 or 1";
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
        /// Probes in free space.
        field: FieldSettings,
        /// Their fit.
        cloud: CloudSettings,
    }
}

impl Settings {
    /// Those of the relightable bake without its field.
    pub fn relightable(&self) -> prt::Settings {
        let Self { preset, texels, place, transport, patches, factors, .. } = self.clone();
        prt::Settings { preset, texels, place, transport, patches, factors }
    }
}
