//! Level of detail of a frame: planned again as the eye moves.

use lightkiln_proto::relight::{LOD_LEVELS, LevelCount, Lod, LodEye, LodTable};
use lightkiln_proto::scene::SceneCamera;

use super::{Bounces, Frame, eye_of};
use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};

impl Frame<'_> {
    /// Sets levels of detail, or all of it. Errs, and changes nothing, for settings out of range and for a bake whose kind has no levels.
    /// The first ones make buffers. A parallel camera sees all alike: under it there is all detail.
    pub fn set_lod(&mut self, lod: Option<Lod>) -> Result<()> {
        if lod == self.lod {
            return Ok(());
        }
        if let Some(lod) = lod {
            check_lod(&lod)?;
            if !self.has_lod {
                self.light.make_lod(&self.gpu, lod_table(&self.bake)?)?;
                self.gpu.check()?;
                self.has_lod = true;
            }
        }
        self.lod = lod;
        self.plan_lod();
        Ok(())
    }

    /// Work by level, the finest first; none where there is all detail.
    pub fn lod_counts(&self) -> Option<[LevelCount; LOD_LEVELS]> {
        self.bake.light.count_lod(self.lod_plan.as_ref()?)
    }

    /// The last change by a bounce that was heard of, since lights changed; 0 for a kind without feedback. In some detail, that by
    /// bounces in which each cluster takes part once at least; and by those between, where an adapter that is behind left answers out.
    pub fn change(&self) -> Option<f32> {
        if self.change.is_none() {
            return Some(0.0);
        }
        let of_movers = self.movers.as_ref().map_or(Some(0.0), |movers| movers.change());
        Some(self.bounces.change(self.cycle())?.max(of_movers?))
    }

    /// Plans the detail of each cluster for the eye: light changes wherever the eye has moved.
    pub(super) fn plan_lod(&mut self) {
        let eye = self.lod.and_then(|lod| Some((lod, lod_eye(&self.bake, &self.camera, self.room.size)?)));
        let before = self.lod_plan.as_ref();
        let plan = eye.and_then(|(lod, eye)| self.bake.light.plan_lod(&lod, eye, before));
        if plan == self.lod_plan {
            return;
        }
        self.light.set_lod(&self.gpu, plan.as_ref());
        self.lod_plan = plan;
        self.stale.pages = true;
        self.bounces = Bounces::default();
    }

    /// Bounces in which each cluster takes part once at least.
    pub(super) fn cycle(&self) -> u64 {
        self.lod_plan.as_ref().map_or(1, |plan| u64::from(plan.cycle()))
    }
}

/// Refuses settings out of range.
pub(crate) fn check_lod(lod: &Lod) -> Result<()> {
    let what = "level of detail".to_owned();
    lod.check().map_err(|error| ClientError::Argument { what, problem: error.to_string() })
}

/// Facts of a bake that levels of detail need. Errs for a kind without them.
pub(crate) fn lod_table(bake: &LoadedBake) -> Result<&LodTable> {
    bake.light.lod_table().ok_or_else(|| ClientError::Argument {
        what: "level of detail".to_owned(),
        problem: format!("is none of kind '{}': draw it with all detail", bake.scene.manifest.kind),
    })
}

/// The eye of a camera; none for a parallel one.
pub(crate) fn lod_eye(bake: &LoadedBake, camera: &SceneCamera, size: [u32; 2]) -> Option<LodEye> {
    let eye = eye_of(camera)?;
    let [width, height] = size.map(|side| side.max(1) as f32);
    let to_corner = (0.5 * camera.fov_y_rad).tan() * (width / height).hypot(1.0);
    Some(LodEye {
        position_m: eye.position_m,
        forward: eye.forward,
        view_cos: 1.0 / to_corner.hypot(1.0),
        diagonal_m: bake.scene.diagonal_m(),
    })
}
