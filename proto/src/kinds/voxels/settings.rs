//! Settings of voxels.

use serde_json::{Value, json};

use super::NAME;
use crate::kinds::prt::{self, PatchSettings};
use crate::settings::{FactorSettings, PlaceSettings, SettingValue as _, TexelSettings, TransportSettings};
use crate::{kind_settings, setting_words, settings_group};

/// Rays of a receiver of a bake of voxels alone: they tell which receivers no light can reach, and nothing of them is stored.
const RAYS: u32 = 64;
/// Setting that says whether a bake has voxels.
const PRESENCE: &str = "voxels";
/// Receivers of a cluster that has no factors.
const CLUSTER_RECEIVERS: u32 = 4096;

setting_words! {
    /// Whether a bake has voxels.
    pub enum Presence { Off = "off", On = "on" }
}

settings_group! {
    /// Voxels beside another bake, for reflections, ambient occlusion, and pictures before there is light.
    VoxelPresence {
        /// Whether the bake has voxels. `on` → reflections and ambient occlusion, some 4 bytes a receiver more.
        voxels: Presence = [Presence::Off, Presence::Off, Presence::Off], |_| true, "off or on";
        /// Size in metres, along the longest side, up to which things have their indirect light from walks through voxels; `"kiln_lit": "walks"`
        /// or `"texels"` in a node's extras comes first. More → fewer bytes and less time, light of small lamps is noisier there. Without
        /// voxels nothing has.
        walk_lit_m: f32 = [0.0, 0.0, 0.0], |v| (0.0..=1e4).contains(&v), "0..=10000 m";
    }
}

settings_group! {
    /// Voxels: what lies of surfaces in each.
    VoxelSettings {
        /// Side of the finest voxels in texels of the lightmap. Less → sharper reflections from near, bytes with its square.
        voxel_texels: u32 = [2, 2, 2], |v| matches!(v, 1 | 2 | 4 | 8), "1, 2, 4 or 8 texels";
    }
}

settings_group! {
    /// Receivers whose light is that of walks.
    WalkedSettings {
        /// Parts of the sky (a power of two). More → a sharper sky.
        sky_parts: u32 = [64, 64, 128], |v| v.is_power_of_two() && (16..=4096).contains(&v), "a power of two in 16..=4096";
        /// Shadow rays per receiver to emissive surfaces. More → smoother soft shadows, more time.
        emitter_rays: u32 = [32, 128, 256], |v| (4..=65_536).contains(&v), "4..=65536";
        /// Most receivers in a cluster. More → fewer, larger chunks.
        cluster_receivers: u32 = [CLUSTER_RECEIVERS, CLUSTER_RECEIVERS, CLUSTER_RECEIVERS], |v| (16..=8192).contains(&v), "16..=8192";
    }
}

kind_settings! {
    /// Settings of a bake of voxels alone.
    Settings of NAME => {
        /// Texels of the lightmap.
        texels: TexelSettings,
        /// Places of receivers.
        place: PlaceSettings,
        /// Receivers.
        walked: WalkedSettings,
        /// Voxels.
        voxels: VoxelSettings,
    }
}

impl VoxelPresence {
    /// There are voxels.
    pub fn is_on(&self) -> bool {
        self.voxels == Presence::On
    }
}

/// Settings of a kind with [`VoxelPresence`], with voxels where they leave that open; `None` where they have none.
pub fn with_voxels(settings: &Value) -> Option<Value> {
    let mut settings = if settings.is_null() { json!({}) } else { settings.clone() };
    let [off, on] = [Presence::Off, Presence::On].map(|presence| presence.write());
    let stated = settings.as_object_mut()?.entry(PRESENCE).or_insert(on);
    (*stated != off).then_some(settings)
}

/// Settings of the receivers of a relightable bake that have the light of walks.
pub fn walked_part(of: &prt::Settings) -> prt::Settings {
    let walked = WalkedSettings {
        sky_parts: of.patches.sky_parts,
        emitter_rays: of.transport.emitter_rays,
        cluster_receivers: CLUSTER_RECEIVERS,
    };
    let prt::Settings { preset, texels, place, voxels, .. } = of.clone();
    Settings { preset, texels, place, walked, voxels }.relightable()
}

impl Settings {
    /// Those of the relightable bake whose receivers and patches it has.
    pub fn relightable(&self) -> prt::Settings {
        let Self { preset, texels, place, walked, voxels } = self.clone();
        let WalkedSettings { sky_parts, emitter_rays, cluster_receivers } = walked;
        prt::Settings {
            preset,
            texels,
            place,
            transport: TransportSettings { transport_rays: RAYS, emitter_rays },
            // Receivers in narrow places have no hits of their own.
            patches: PatchSettings {
                patches_max: 16,
                sky_parts,
                near_texels: 0.01,
                near_hits: 0,
                rank_error: 0.5,
            },
            factors: FactorSettings {
                cluster_receivers,
                rank_max: 1,
                split_receivers_min: cluster_receivers,
            },
            has_voxels: VoxelPresence { voxels: Presence::On, walk_lit_m: 0.0 },
            voxels,
        }
    }
}
