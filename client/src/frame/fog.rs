//! A medium between surfaces.

use super::Frame;
use crate::error::Result;
use crate::passes::fog::{Fog, FogNumbers, FogPass};

impl Frame<'_> {
    /// Sets a medium or takes it away. The first makes buffers for it, as does the first picture of another size or with another bake; others make
    /// nothing. Errs, and changes nothing, where a number of it is out of its range or the adapter cannot draw it.
    pub fn set_fog(&mut self, fog: Option<Fog>) -> Result<()> {
        if let Some(fog) = &fog {
            fog.check()?;
            if self.fog_pass.is_none() {
                self.fog_pass = Some(self.fog_pass_of(fog)?);
                self.fog_filled = None;
            }
        }
        self.fog = fog;
        Ok(())
    }

    /// Lets go of the medium's passes, which are of another size or another bake's light; the next picture makes them anew.
    pub(super) fn drop_fog_pass(&mut self) {
        (self.fog_pass, self.fog_filled) = (None, None);
    }

    fn fog_pass_of(&self, fog: &Fog) -> Result<FogPass> {
        let numbers = self.fog_numbers(fog)?;
        let (shading, resources) = (self.bake.light.shading(), self.light.bindings());
        let radiance = self.bake.light.medium().map(|snippet| (snippet, &shading, &resources[..]));
        let pass = FogPass::new(&self.gpu, &self.shadow, radiance, self.shade.depth(), &numbers)?;
        self.gpu.check()?;
        Ok(pass)
    }

    fn fog_numbers(&self, fog: &Fog) -> Result<FogNumbers> {
        let view = self.view(&self.camera, [0.0; 2])?;
        Ok(FogNumbers::new(fog, &self.camera, &view, self.room.size, self.bounds_m))
    }

    /// Draws the medium before the sample that was drawn last; none over colours that stand for light, or over what walks from the eye meet. Where there is no room for it, it is taken
    /// away, and the error says so once.
    pub(super) fn draw_fog(&mut self, is_new_light: bool) -> Result<()> {
        let is_shown = self.overlay.is_none() && !self.walks_now().is_some_and(|walks| walks.eye);
        let Some(fog) = self.fog.filter(|_| is_shown) else { return Ok(()) };
        if self.fog_pass.is_none() {
            let made = self.fog_pass_of(&fog).inspect_err(|_| self.fog = None);
            self.fog_pass = Some(made?);
        }
        let numbers = self.fog_numbers(&fog)?;
        let Some(pass) = &self.fog_pass else { return Ok(()) };
        let fills = is_new_light || self.fog_filled != Some(numbers);
        if fills {
            pass.set(&self.gpu, &numbers);
        }
        let (shadow, picture) = (&self.shadow, self.shade.radiance());
        self.watch.submit(&self.gpu, |encoder| {
            if fills {
                pass.fill(encoder, shadow);
            }
            pass.draw_over(encoder, picture);
        });
        self.fog_filled = Some(numbers);
        Ok(())
    }
}
