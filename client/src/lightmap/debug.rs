//! Pictures for finding faults: a page's irradiance, and its clusters coloured.

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::{Columns, Limit};

use super::LightmapLight;
use crate::bake::{Among, DebugPage, LitScene};
use crate::passes::atlas::reference::spread;
use crate::scene::LoadedScene;

/// Name of the picture of total irradiance (direct, emitters', indirect) in W·m⁻².
pub const ATLAS: &str = "atlas";
/// Name of the picture with a colour for each cluster.
pub const CLUSTERS: &str = "clusters";

impl<C: Columns> LightmapLight<C> {
    pub(super) fn irradiance_page(&self, page: usize, lit: &LitScene<'_>, limit: Limit) -> Option<DebugPage> {
        let settled = self.settled(lit, &Among::default(), limit);
        let light = &settled.light;
        let straight: Vec<Vec4> =
            settled.dir.iter().zip(&light.emit).map(|(dir, emit)| *dir + *emit).collect();
        let drawn = self.page(lit.scene, page, &straight, &light.ind)?;
        Some(DebugPage { bounces: light.bounces, converged: light.converged, ..drawn })
    }

    pub(super) fn cluster_page(&self, page: usize, scene: &LoadedScene) -> Option<DebugPage> {
        let colours = self.by_cluster(|index| hue(index as u32));
        let black = vec![Vec4::ZERO; colours.len()];
        self.page(scene, page, &colours, &black)
    }

    /// A colour by slot for each cluster.
    pub(super) fn by_cluster(&self, colour: impl Fn(usize) -> Vec3) -> Vec<Vec4> {
        let mut colours = vec![Vec4::ZERO; self.transport.receivers.len()];
        for (index, cluster) in self.transport.clusters.clusters.iter().enumerate() {
            colours[cluster.rows()].fill(colour(index).extend(0.0));
        }
        colours
    }

    fn page(&self, scene: &LoadedScene, page: usize, first: &[Vec4], second: &[Vec4]) -> Option<DebugPage> {
        let mut atlas = spread(&scene.lightmap, &self.texels, first, second);
        let size = *atlas.sizes.get(page)?;
        let texels = std::mem::take(&mut atlas.pages[page]);
        Some(DebugPage { size, texels, bounces: 0, converged: true })
    }
}

/// Colours far apart for neighbouring numbers: golden-angle hues.
pub(super) fn hue(index: u32) -> Vec3 {
    let turn = (f64::from(index) * 0.618_033_988_749_895).fract() as f32;
    let channel = |offset: f32| 0.55 + 0.45 * (std::f32::consts::TAU * (turn + offset)).cos();
    Vec3::new(channel(0.0), channel(1.0 / 3.0), channel(2.0 / 3.0))
}
