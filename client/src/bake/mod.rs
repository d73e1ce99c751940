//! A bake in memory: its scene, and its light as one of many kinds plays it.
//!
//! A kind of bake is a [`ClientKind`] in a table that callers pass in. It loads a [`Light`] from chunks of its own, which
//! gives the work before shading on the processor ([`Light::settle`]) and on the adapter ([`LightPasses`]), and the
//! shading function in both forms.

mod kind;
mod light;

use crate::error::Result;
use crate::fetch::Source;
use crate::scene::LoadedScene;

pub use kind::{ClientKind, ClientKinds};
pub use light::{
    DebugPage, IncomingDirect, Light, LightPasses, LightStream, LitScene, SettledLight, Unshadowed,
    UnshadowedArrays,
};

/// A whole bake, ready to be lit.
#[derive(Debug)]
pub struct LoadedBake {
    /// Meshes, textures and manifest.
    pub scene: LoadedScene,
    /// Its light.
    pub light: Box<dyn Light>,
}

impl LoadedBake {
    /// Fetches, verifies and decodes every chunk of a bake, whose kind must be among `kinds` and must approve the manifest.
    ///
    /// ```no_run
    /// use lightkiln_client::{bake::LoadedBake, fetch::Source, kinds};
    ///
    /// let bake = LoadedBake::load(&Source::bundle("room.bake")?, &kinds::all())?;
    /// println!("{} meshes", bake.scene.draws.draws.len());
    /// # Ok::<(), lightkiln_client::ClientError>(())
    /// ```
    pub fn load(source: &Source, kinds: &ClientKinds) -> Result<Self> {
        let (_, manifest) = source.manifest()?;
        let kind = kinds.of(&manifest)?;
        let scene = LoadedScene::fetch(source, manifest)?;
        let light = kind.load(source, &scene)?;
        Ok(Self { scene, light })
    }
}
