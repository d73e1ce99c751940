//! Room for other sizes and more lights.

use lightkiln_proto::scene::SceneLight;

use super::movers::Movers;
use super::{Frame, FrameRoom};
use crate::error::Result;
use crate::lights::Caster;
use crate::passes::shadow::{ShadowPass, ShadowPlan, ShadowRoom};

impl Frame<'_> {
    /// Makes room for views of another size. Errs, and changes nothing, where the adapter has not so much.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<()> {
        let room = FrameRoom { size, ..self.room };
        if room != self.room {
            self.shade.resize(&self.gpu, size)?;
            self.room = room;
            self.drop_fog_pass();
            if let Some(walking) = &mut self.walking {
                walking.forget_room();
            }
            self.plan_lod();
        }
        Ok(())
    }

    /// Makes room for these lights with shadow maps of at most `side` texels, if they are more than there is room for. Errs, and
    /// changes nothing, where there can be none.
    pub fn make_room(&mut self, lights: &[SceneLight], side: u32) -> Result<()> {
        let casters = Caster::of(lights);
        let bounds_m = self.bake.scene.manifest.bounds_m;
        if ShadowPlan::within(&self.room.shadows, &casters, bounds_m, None).is_ok() {
            return Ok(());
        }
        // Current lights stay until others are set.
        let shadows =
            ShadowRoom::for_lights(&casters, side)?.and(ShadowRoom::for_lights(&self.casters, side)?);
        let sights = self.movers.as_ref().map_or(0, Movers::len) as u32;
        let shadow = ShadowPass::with_sights(&self.gpu, &self.bake.scene, &self.meshes, &shadows, sights)?;
        self.gpu.check()?;
        let former = std::mem::replace(&mut self.room.shadows, shadows);
        match self.planned(&self.casters, &self.camera) {
            Ok(plan) => (self.shadow, self.plan) = (shadow, plan),
            Err(error) => {
                self.room.shadows = former;
                return Err(error);
            }
        }
        self.shadow.set(&self.gpu, &self.plan);
        (self.stale.lights, self.stale.cascades) = (true, true);
        self.place_movers()
    }
}
