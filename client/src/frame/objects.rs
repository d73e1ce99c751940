//! Objects of a frame: those that moved are written anew, and shadow maps with them.

use super::{Bounces, Frame, Stale, eye_of};
use crate::error::Result;
use crate::passes::shadow::ShadowPlan;
use crate::scene::{PosedDraw, Stance, bounds_of, check_stances};

impl Frame<'_> {
    /// Moves objects; those without a stance are at rest. Their shadows fall on all that lights reach, and so on the light that bounces.
    /// Vertices of objects that moved are made and written anew.
    pub fn set_objects(&mut self, stances: &[Stance]) -> Result<()> {
        let scene = &self.bake.scene;
        check_stances(scene, stances)?;
        let mut wanted = stances.to_vec();
        wanted.resize(scene.objects(), Stance::default());
        let mut moved: Vec<PosedDraw> = Vec::new();
        let mut object_bounds_m = self.object_bounds_m.clone();
        for (index, stance) in
            wanted.iter().enumerate().filter(|(index, stance)| self.stances[*index] != **stance)
        {
            let posed = scene.posed_object(index, stance)?;
            object_bounds_m[index] = bounds_of(&posed);
            moved.extend(posed);
        }
        if moved.is_empty() {
            return Ok(());
        }
        let bounds_m = scene.bounds_with(object_bounds_m.iter().copied());
        let plan = ShadowPlan::within(&self.room.shadows, &self.casters, bounds_m, eye_of(&self.camera))?;
        for (index, mesh) in &moved {
            self.shade.move_mesh(&self.gpu, &self.meshes, *index, mesh);
        }
        (self.stances, self.object_bounds_m, self.bounds_m, self.plan) =
            (wanted, object_bounds_m, bounds_m, plan);
        self.shadow.set(&self.gpu, &self.plan);
        self.stale = Stale { lights: true, cascades: true, pages: true, ..self.stale };
        self.bounces = Bounces::default();
        self.place_movers()
    }
}
