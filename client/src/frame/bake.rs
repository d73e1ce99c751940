//! Other light of the same scene, where the adapter may have no room for both.

use glam::Vec4;

use super::movers::{Around, Movers};
use super::{Frame, Held, lod_table};
use crate::bake::{LightPasses, LoadedBake, Overlay};
use crate::error::{ClientError, Result};
use crate::passes::change::ChangePass;

/// Passes of a bake's light.
struct Passes {
    light: Box<dyn LightPasses>,
    change: Option<ChangePass>,
    overlay: Option<(Overlay, Vec<Vec4>)>,
    /// Of objects with bakes of their own.
    around: Option<Around>,
}

/// No light, while the passes of one bake are gone and those of another not there yet.
struct Dark;

impl LightPasses for Dark {
    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>> {
        Vec::new()
    }
}

impl<'a> Frame<'a> {
    /// Takes a bake with the same scene and other light: meshes, textures, shadow maps and everything that was set stay, and light
    /// starts anew. Where the adapter has no room for the light of both, that of the one before goes first. Errs, with the bake from before,
    /// where that cannot be; its light starts anew, too, where it had to come again.
    pub fn set_bake(&mut self, bake: impl Into<Held<'a, LoadedBake>>) -> Result<()> {
        let bake = bake.into();
        let passes = match self.passes_of(&bake) {
            Err(ClientError::AdapterFull { .. }) => {
                (self.light, self.change) = (Box::new(Dark), None);
                self.drop_walks();
                if let Some(movers) = &mut self.movers {
                    movers.around = None;
                }
                self.gpu.let_go()?;
                match self.passes_of(&bake) {
                    Err(error) => {
                        self.gpu.let_go()?;
                        let former = self.bake.clone();
                        let passes = self.passes_of(&former)?;
                        self.take(former, passes)?;
                        return Err(error);
                    }
                    passes => passes?,
                }
            }
            passes => passes?,
        };
        self.take(bake, passes)
    }

    fn passes_of(&self, bake: &LoadedBake) -> Result<Passes> {
        let mut light = bake.light.passes(&self.gpu, &bake.scene, &self.shadow, self.room.size)?;
        let overlay = self.overlay.as_ref().map(|(overlay, _)| *overlay);
        let overlay = self.painted(bake, overlay)?;
        if overlay.is_some() {
            light.make_paint(&self.gpu)?;
        }
        if self.lod.is_some() {
            light.make_lod(&self.gpu, lod_table(bake)?)?;
        }
        let change = light.feedback().map(|feedback| ChangePass::new(&self.gpu, feedback)).transpose()?;
        let of = |movers: &Movers| movers.around_of(&self.gpu, bake, &self.shadow, &mut *light);
        let around = self.movers.as_ref().map(of).transpose()?;
        self.gpu.check()?;
        Ok(Passes { light, change, overlay, around })
    }

    fn take(&mut self, bake: Held<'a, LoadedBake>, passes: Passes) -> Result<()> {
        let Passes { light, change, overlay, around } = passes;
        self.shade.bind(&self.gpu, &light.bindings())?;
        self.has_paint = overlay.is_some();
        (self.has_lod, self.lod_plan) = (self.lod.is_some(), None);
        self.overlay = overlay;
        (self.light, self.change, self.bake) = (light, change, bake);
        if let Some(movers) = &mut self.movers {
            movers.around = around;
        }
        self.drop_fog_pass();
        self.drop_walks();
        self.plan_lod();
        if let Some(albedo) = self.bake.light.tinted_albedo(&self.bake.scene, &self.tints) {
            self.light.set_albedo(&self.gpu, &albedo);
        }
        (self.stale.lights, self.stale.cascades) = (true, true);
        self.write_unshadowed();
        self.place_movers()
    }
}
