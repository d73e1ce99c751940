//! Settings of voxels.

use crate::{setting_words, settings_group};

setting_words! {
    /// Whether a bake has voxels.
    pub enum Presence { Off = "off", On = "on" }
}

settings_group! {
    /// Voxels: what lies of surfaces in each, for reflections, ambient occlusion, and pictures before there is light.
    VoxelSettings {
        /// Whether the bake has voxels. `on` → reflections and ambient occlusion, some 4 bytes a receiver more.
        voxels: Presence = [Presence::Off, Presence::Off, Presence::Off], |_| true, "off or on";
        /// Side of the finest voxels in texels of the lightmap. Less → sharper reflections from near, bytes with its square.
        voxel_texels: u32 = [2, 2, 2], |v| matches!(v, 1 | 2 | 4 | 8), "1, 2, 4 or 8 texels";
    }
}

impl VoxelSettings {
    /// There are voxels.
    pub fn is_on(&self) -> bool {
        self.voxels == Presence::On
    }
}
