//! Other colours of materials.

use super::Frame;
use super::bounces::Bounces;
use crate::error::Result;
use crate::scene::{Recolour, Tints};

impl Frame<'_> {
    /// Gives materials other colours than the bake's; those that are not named have the bake's own.
    pub fn set_materials(&mut self, colours: &[Recolour]) -> Result<()> {
        let scene = &self.bake.scene;
        let tints = Tints::of(scene, colours)?;
        if tints == self.tints {
            return Ok(());
        }
        if let Some(movers) = &self.movers {
            movers.set_materials(&self.gpu, colours)?;
        }
        if let Some(albedo) = self.bake.light.tinted_albedo(scene, &tints) {
            self.light.set_albedo(&self.gpu, &albedo);
        }
        self.tints = tints;
        self.shade.set_looks(&self.gpu, scene, &self.tints, &self.emitter_scale);
        // Near hits have albedo and light from lights in one sum.
        (self.stale.direct, self.stale.pages) = (true, true);
        self.bounces = Bounces::default();
        Ok(())
    }
}
