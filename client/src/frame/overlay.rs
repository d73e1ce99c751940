//! Overlays: colours over surfaces instead of light.

use std::borrow::Cow;

use glam::Vec4;
use lightkiln_proto::relight::LodPlan;

use super::Frame;
use crate::bake::{LoadedBake, MeasuredErrors, Overlay};
use crate::error::{ClientError, Result};

impl Frame<'_> {
    /// Takes measured errors for [`Overlay::Errors`]. Errs for those of another scene.
    pub fn set_errors(&mut self, errors: MeasuredErrors) -> Result<()> {
        errors.check(self.bake.scene.manifest.bounds_m)?;
        self.errors = Some(errors);
        Ok(())
    }

    /// An overlay with its colours. Errs for one that the bake's kind has not.
    pub(super) fn painted(
        &self,
        bake: &LoadedBake,
        overlay: Option<Overlay>,
    ) -> Result<Option<(Overlay, Vec<Vec4>)>> {
        let Some(overlay) = overlay else { return Ok(None) };
        let colours = match (overlay, &self.errors) {
            (Overlay::Errors { light }, Some(errors)) => {
                let lightmap = bake.light.lightmap(&bake.scene);
                lightmap.and_then(|lightmap| errors.colours(light, lightmap.receivers))
            }
            _ => bake.light.overlay(overlay, self.lod_plan.as_ref()),
        };
        let absent = || ClientError::Argument {
            what: format!("overlay {overlay:?}"),
            problem: format!("is none of kind '{}'", bake.scene.manifest.kind),
        };
        Ok(Some((overlay, colours.ok_or_else(absent)?)))
    }

    /// Lays an overlay over surfaces, or takes it away. Errs for one that the bake's kind has not. The first one makes buffers.
    pub fn set_overlay(&mut self, overlay: Option<Overlay>) -> Result<()> {
        if overlay == self.overlay.as_ref().map(|(overlay, _)| *overlay) {
            return Ok(());
        }
        let overlay = self.painted(&self.bake, overlay)?;
        if !self.has_paint {
            self.light.make_paint(&self.gpu)?;
            self.gpu.check()?;
            self.has_paint = true;
        }
        self.overlay = overlay;
        self.stale.pages = true;
        Ok(())
    }
}

/// Colours of an overlay, by slot. Those of levels of detail follow the eye.
pub(super) fn colours_of<'a>(
    (overlay, colours): &'a (Overlay, Vec<Vec4>),
    bake: &LoadedBake,
    lod: Option<&LodPlan>,
) -> Cow<'a, [Vec4]> {
    match overlay {
        Overlay::Lod => Cow::Owned(bake.light.overlay(*overlay, lod).unwrap_or_default()),
        _ => Cow::Borrowed(colours),
    }
}
