//! A bake whose light is fetched within a number of bytes.

use glam::Vec3;

use super::{Prepared, View};
use crate::bake::{ClientKinds, LightStream, LoadedBake};
use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::passes::shadow::reference::draw;
use crate::scene::LoadedScene;
use crate::stream::{Streamed, Viewpoint};

/// A bake whose light comes piece by piece.
pub struct StreamedBake {
    source: Source,
    /// The scene, and the light of what has come.
    pub bake: LoadedBake,
    stream: Box<dyn LightStream>,
    manifest_bytes: u64,
}

impl StreamedBake {
    /// Fetches the scene and what light comes first by.
    pub fn begin(source: &Source, kinds: &ClientKinds) -> Result<Self> {
        let (bytes, manifest) = source.manifest()?;
        let kind = kinds.of(&manifest)?;
        let scene = LoadedScene::fetch(source, manifest)?;
        let stream = kind.stream(source, &scene)?;
        let light = stream.light(&scene)?;
        let bake = LoadedBake { scene, light };
        Ok(Self { source: source.clone(), bake, stream, manifest_bytes: bytes.len() as u64 })
    }

    /// What has come, with the manifest.
    pub fn streamed(&self) -> Streamed {
        let Streamed { bytes, bytes_all, .. } = self.stream.streamed();
        let with_manifest = |bytes| bytes + self.manifest_bytes;
        Streamed {
            bytes: with_manifest(bytes),
            bytes_all: with_manifest(bytes_all),
            ..self.stream.streamed()
        }
    }

    /// Fetches the clusters that a view needs most until `bytes_max` bytes of light have come. Errs if what came first has more.
    pub fn refine(&mut self, view: &View, bytes_max: u64) -> Result<()> {
        let Streamed { bytes, .. } = self.streamed();
        if bytes_max < bytes {
            let what = format!("{bytes_max} bytes of light");
            let problem = format!("are too few: manifest, directory, patches and overview have {bytes}");
            return Err(ClientError::Argument { what, problem });
        }
        let prepared = Prepared::new(&self.bake, view)?;
        let maps = draw(&self.bake.scene, &prepared.plan);
        let eye_m = Vec3::from(view.camera.eye_m);
        let forward = (Vec3::from(view.camera.target_m) - eye_m).try_normalize();
        let viewpoint = forward.map(|forward| Viewpoint { eye_m, forward });
        let bytes_max = bytes_max - self.manifest_bytes;
        self.stream.refine(&self.source, &prepared.lit(&maps), viewpoint, bytes_max, view.limit)?;
        self.bake.light = self.stream.light(&self.bake.scene)?;
        Ok(())
    }
}
