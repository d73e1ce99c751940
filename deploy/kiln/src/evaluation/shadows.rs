//! The client's shadow maps as evaluation reads them, at the preview's default size.

use lightkiln_client::ClientError;
use lightkiln_client::bake::{IncomingDirect, LitScene, LoadedBake, Unshadowed};
use lightkiln_client::lights::Caster;
use lightkiln_client::passes::direct::reference::{Shadowed, shadowed};
use lightkiln_client::passes::shadow::ShadowPlan;
use lightkiln_client::passes::shadow::reference::{ShadowMaps, draw};
use lightkiln_client::preview::SHADOW_SIDE;
use lightkiln_proto::relight::Sky;
use lightkiln_worker::evaluate::{ClientLights, EvaluationError, MappedIncoming, MappedLight, MappedPixel};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::reference::Lighting;

/// A bake as the client has it.
pub struct ClientBake(pub LoadedBake);

impl ClientLights for ClientBake {
    fn under<'a>(
        &'a self,
        lighting: &Lighting,
    ) -> Result<Option<Box<dyn MappedLight + 'a>>, EvaluationError> {
        let bounds_m = self.0.scene.manifest.bounds_m;
        let failed = |error: ClientError| EvaluationError::Client { source: Box::new(error) };
        let plan =
            ShadowPlan::new(&Caster::of(&lighting.lights), bounds_m, SHADOW_SIDE, None).map_err(failed)?;
        let maps = draw(&self.0.scene, &plan);
        Ok(Some(Box::new(Mapped { bake: &self.0, plan, maps })))
    }
}

/// Shadow maps of one lighting.
struct Mapped<'a> {
    bake: &'a LoadedBake,
    plan: ShadowPlan,
    maps: ShadowMaps,
}

impl MappedLight for Mapped<'_> {
    fn incoming(&self) -> Option<MappedIncoming> {
        let unshadowed = Unshadowed { sky: Sky::default(), panorama: None, emitter_scale: &[] };
        let lit =
            LitScene { scene: &self.bake.scene, plan: &self.plan, maps: &self.maps, unshadowed, lod: None };
        let IncomingDirect { receivers, near } = self.bake.light.incoming(&lit)?;
        Some(MappedIncoming { receivers, near })
    }

    fn at(&self, site: &Site) -> MappedPixel {
        let Shadowed { irradiance, unshadowed, filter_m } =
            shadowed(&self.plan, &self.maps, site.position_m, site.normal, site.face_normal);
        // A point of a rectangle is there or hidden.
        let points =
            self.plan.lights.iter().map(|light| light.cells[0] * light.cells[1]).filter(|points| *points > 0);
        let coarse = points.min().map_or(0.0, |points| 1.0 / f64::from(points));
        MappedPixel { shown: irradiance.as_dvec3(), unshadowed: unshadowed.as_dvec3(), filter_m, coarse }
    }
}
