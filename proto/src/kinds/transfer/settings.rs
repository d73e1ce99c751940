//! Settings of a moving object's bake.

use crate::kinds::prt::{self, PatchSettings};
use crate::kinds::voxels::{Presence, VoxelPresence, VoxelSettings};
use crate::settings::{FactorSettings, PlaceSettings, TexelSettings, TransportSettings};
use crate::transfer::NODES_MIN;
use crate::{kind_settings, settings_group};

settings_group! {
    /// The volume around the object.
    TransferSettings {
        /// Nodes of each level along an axis. More → sharper shadows near the object, bytes and time with the cube.
        transfer_nodes: u32 = [16, 16, 24], |v| (NODES_MIN..=32).contains(&v), "4..=32";
        /// Parts that the finest levels tell the object's surface apart in, coarser ones fewer. More → colours of its sides stay apart, bytes
        /// and run time in proportion.
        transfer_parts: u32 = [8, 8, 24], |v| (1..=60).contains(&v), "1..=60";
        /// Rays of a node, all towards the object. More → less noise, time in proportion.
        transfer_rays: u32 = [512, 1024, 4096], |v| (64..=65_536).contains(&v), "64..=65536";
    }
}

kind_settings! {
    /// Settings of a moving object's bake.
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
        /// Voxels.
        voxels: VoxelSettings,
        /// The volume.
        transfer: TransferSettings,
    }
}

impl Settings {
    /// Those of the relightable bake of the object's own surfaces.
    pub fn relightable(&self) -> prt::Settings {
        let Self { preset, texels, place, transport, patches, factors, voxels, .. } = self.clone();
        let has_voxels = VoxelPresence { voxels: Presence::On, walk_lit_m: 0.0 };
        prt::Settings { preset, texels, place, transport, patches, factors, has_voxels, voxels }
    }
}

impl TransferSettings {
    /// Most parts of a level.
    pub fn parts_of(&self, level: u32) -> u32 {
        match level {
            0 | 1 => self.transfer_parts,
            2 => self.transfer_parts.div_ceil(2).min(8),
            _ => self.transfer_parts.div_ceil(12),
        }
    }
}
