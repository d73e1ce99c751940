//! A bake in memory: its scene, and its light as one of many kinds plays it.
//!
//! A kind of bake is a [`ClientKind`] in a table that callers pass in. It loads a [`Light`] from chunks of its own, which
//! gives the work before shading on the processor ([`Light::settle`]) and on the adapter ([`LightPasses`]), and the
//! shading function in both forms.

mod among;
mod edit;
mod errors;
mod free_space;
mod kind;
mod light;
mod places;
mod walks;

use std::sync::Arc;

use crate::error::Result;
use crate::fetch::Source;
use crate::scene::{LoadedScene, Object, Recolour, Tints};

pub use among::{Among, Beside, Mover, check_colours, share_colours};
pub use edit::{Edited, QuickBake};
pub use errors::{COLUMNS, FULL_COLOUR, MeasuredErrors};
pub use free_space::{FreeSpace, Lattice, NO_PROBE, PROBE_COEFFICIENTS, Tetrahedra};
pub use kind::{ClientKind, ClientKinds};
pub use light::{
    DebugPage, IncomingDirect, Light, LightPasses, LightStream, LitScene, Overlay, ReceiverBuffers,
    ReceiverLight, SettledLight, SettledReceivers, Unshadowed, UnshadowedArrays,
};
pub use walks::{SettledWalks, emitter_radiance};

/// A whole bake, ready to be lit.
#[derive(Debug)]
pub struct LoadedBake {
    /// Meshes, textures and manifest.
    pub scene: Arc<LoadedScene>,
    /// Its light.
    pub light: Box<dyn Light>,
    /// Objects beside it that have bakes of their own.
    pub movers: Vec<Mover>,
}

impl LoadedBake {
    /// Of a scene and its light, with nothing beside it.
    pub fn new(scene: impl Into<Arc<LoadedScene>>, light: Box<dyn Light>) -> Self {
        Self { scene: scene.into(), light, movers: Vec::new() }
    }

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
        Ok(Self::new(scene, light))
    }

    /// Gives materials other colours, from which all light follows; the bake's own are gone. Errs for materials of objects whose bakes others
    /// share: [`share_colours`] is for these.
    pub fn recolour(&mut self, colours: &[Recolour]) -> Result<()> {
        let tints = Tints::of(&self.scene, colours)?;
        for mover in &mut self.movers {
            among::recolour(&mut mover.bake, colours)?;
        }
        self.tint_light(&tints);
        let colours: Vec<[f32; 4]> = (0..self.scene.manifest.materials.len())
            .map(|material| tints.base_colour(&self.scene, material as u32))
            .collect();
        // Whoever shares the scene keeps the old colours.
        let materials = &mut Arc::make_mut(&mut self.scene).manifest.materials;
        for (material, colour) in materials.iter_mut().zip(colours) {
            material.base_colour = colour;
        }
        Ok(())
    }

    /// Puts an object beside the bake, at rest at the origin.
    pub fn add_object(&mut self, object: Object) -> Result<()> {
        Arc::make_mut(&mut self.scene).add_object(object)
    }

    /// Gives the light the albedo of other colours.
    pub(crate) fn tint_light(&mut self, tints: &Tints) {
        if let Some(albedo) = self.light.tinted_albedo(&self.scene, tints) {
            self.light.set_albedo(albedo);
        }
    }
}
