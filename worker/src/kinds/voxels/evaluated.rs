//! E_ind by walks through a bake's voxels as evaluation sees it, beside the same directions by exact rays.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use lightkiln_proto::relight::{NO_PATCH, PatchTable};
use lightkiln_proto::voxels::{Bundle, IRRADIANCE_WALKS, Start, VoxelTable, WalkLight, irradiance};
use rayon::prelude::*;

use crate::emitters::radiance_of_emitters;
use crate::evaluate::{Answer, ErrorClass, Evaluated, Measure, Place, Relit};
use crate::factors::{FactoredBake, Light};
use crate::geometry::{Geometry, Site};
use crate::lightmap::Surface;
use crate::rays::Hit;
use crate::rays::sampling::seed_of;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Progress};

/// Name of the class of error by the directions of walks alone.
pub const DIRECTIONS: &str = "directions";

/// A bake whose E_ind is that of walks.
pub struct WalkedBake {
    bake: FactoredBake<PatchTable>,
    voxels: VoxelTable,
    /// The finest patch of each slot.
    patch_of_slot: Vec<u32>,
    /// Radiance of each emitter, W·m⁻²·sr⁻¹.
    emitters: Vec<Vec3>,
}

impl WalkedBake {
    /// Of a bake and its voxels.
    pub fn new(bake: FactoredBake<PatchTable>, voxels: VoxelTable) -> Self {
        let patch_of_slot = bake.columns().finest_of_slots();
        let emitters =
            radiance_of_emitters(&bake.world().geometry.scene).into_iter().map(Vec3::from).collect();
        Self { bake, voxels, patch_of_slot, emitters }
    }
}

impl Evaluated for WalkedBake {
    fn geometry(&self) -> &Geometry {
        self.bake.geometry()
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        self.bake.answer_at(hit)
    }

    fn points_of(&self, place: &Place) -> Vec<Site> {
        self.bake.points_of(place)
    }

    fn chunk_of(&self, place: &Place) -> Option<usize> {
        self.bake.chunk_of(place)
    }

    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        let light = self.bake.lit(reference, lighting, progress)?;
        Ok(Box::new(WalkedLight { walked: self, light, emitter_scale: lighting.emitter_scale }))
    }
}

/// It under some lights.
struct WalkedLight<'a> {
    walked: &'a WalkedBake,
    light: Arc<Light>,
    emitter_scale: f32,
}

impl WalkedLight<'_> {
    fn of_walks(&self) -> WalkLight<'_> {
        let WalkedBake { bake, voxels, emitters, .. } = self.walked;
        let emitter = |emitter: u16| emitters.get(usize::from(emitter)).copied().unwrap_or_default();
        let scaled = |index: u16| emitter(index) * self.emitter_scale;
        WalkLight::new(voxels, bake.columns(), &self.light.settled.lambda, scaled)
    }

    /// The light of a place by the walks of its receiver.
    fn of_place(&self, place: &Place, of: impl Fn(&Site, &Bundle) -> Vec3) -> DVec3 {
        let identity = seed_of(&place.site.identity()) as u32;
        of(&place.site, &Bundle::new(IRRADIANCE_WALKS, identity)).as_dvec3()
    }

    /// Irradiance of rays along the directions of walks, each with the radiance of the finest patch that it meets.
    fn by_rays(&self, site: &Site, bundle: &Bundle) -> Vec3 {
        let world = self.walked.bake.world();
        let light = self.of_walks();
        let from_m = world.geometry.lifted(site.position_m, site.face_normal);
        let radiance = |direction: Vec3| {
            let Some(hit) = world.geometry.tracer.closest(from_m, direction, f32::INFINITY) else {
                return light.of_sky(direction);
            };
            let glow = if world.geometry.is_back(&hit) { Vec3::ZERO } else { self.glow(&hit) };
            let Surface::Receiver(receiver) = world.linked_surface_at(&hit, world.geometry.point_of(&hit))
            else {
                return glow;
            };
            let place = Place { site: *site, number: Some(receiver) };
            let patch_of = |slot: u32| self.walked.patch_of_slot.get(slot as usize).copied();
            let patch = self.walked.bake.slot(&place).and_then(patch_of).filter(|patch| *patch != NO_PATCH);
            glow + patch.map_or(Vec3::ZERO, |patch| light.of_patch(patch))
        };
        let along = |walk| bundle.cosine(walk, site.normal).above(site.face_normal).direction;
        let sum: Vec3 = (0..bundle.walks()).map(|walk| radiance(along(walk))).sum();
        std::f32::consts::PI / bundle.walks() as f32 * sum
    }

    /// Radiance that the surface of a hit emits, without its texture.
    fn glow(&self, hit: &Hit) -> Vec3 {
        Vec3::from(self.walked.bake.world().geometry.material(hit.triangle).emissive) * self.emitter_scale
    }
}

impl Relit for WalkedLight<'_> {
    fn irradiance(&self, place: &Place) -> Option<DVec3> {
        self.walked.bake.slot(place)?;
        let light = self.of_walks();
        Some(self.of_place(place, |site, bundle| {
            let start = Start::on(site.position_m, site.face_normal);
            irradiance(&self.walked.voxels, &start, site.normal, bundle, |seen| light.radiance(seen))
        }))
    }

    fn bounces(&self) -> (usize, bool) {
        (self.light.settled.bounces as usize, self.light.settled.converged)
    }

    fn classes(&self, sample: &[Place]) -> Vec<ErrorClass> {
        let by_rays = |place: &Place| self.of_place(place, |site, bundle| self.by_rays(site, bundle));
        let light = sample.par_iter().map(by_rays).collect();
        let about = "of so few directions, by rays without voxels";
        vec![ErrorClass { name: DIRECTIONS, about, measure: Measure::AtSample(light) }]
    }
}
