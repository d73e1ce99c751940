//! Light of surfaces from the lightmap, of all else from the field.

use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::field::{Between, FieldTable, NO_PROBE, PROBE_ROWS};
use lightkiln_proto::relight::{
    Columns, LOD_LEVELS, LevelCount, Limit, Lod, LodEye, LodPlan, LodTable, PatchTable, Settled,
};
use lightkiln_proto::voxels::VoxelTable;

use super::passes::{FieldPasses, IN_LATTICE, IN_TETRAHEDRA, medium};
use crate::bake::{
    self, Among, DebugPage, FreeSpace, IncomingDirect, Lattice, Light, LightPasses, LitScene, Overlay,
    SettledLight, SettledReceivers, Tetrahedra, Unshadowed, UnshadowedArrays,
};
use crate::error::Result;
use crate::lightmap::{LightmapLight, Lit};
use crate::passes::atlas::Lightmap;
use crate::passes::atlas::reference::{AtlasPages, read, spread};
use crate::passes::gpu::{Gpu, storage_read, uniform};
use crate::passes::shade::{IndirectIrradiance, Shading, Surface};
use crate::passes::shadow::ShadowPass;
use crate::scene::{LoadedScene, NO_BLOCK, Tints};
use crate::threads::Threads;

const _: () = assert!(PROBE_ROWS == bake::PROBE_COEFFICIENTS && NO_PROBE == bake::NO_PROBE);

/// Light about another direction than a surface's normal, of that about its normal, at most. More → bumps towards bright windows are as
/// bright as the field says; less → errors of a field beside walls show less.
const TURNED_MOST: f32 = 4.0;

/// The light of a bake with a field.
#[derive(Debug)]
pub struct FieldLight {
    /// Light of surfaces.
    pub lightmap: LightmapLight<PatchTable>,
    /// Light in free space.
    pub field: FieldTable,
}

/// Light after the last bounce, and the scene whose surfaces read it.
struct Shown<'a> {
    scene: &'a LoadedScene,
    pages: AtlasPages,
    field: &'a FieldTable,
    /// Coefficients at probes.
    rows: Vec<Vec4>,
}

impl Shown<'_> {
    /// Light about another direction than a surface's normal, of that about its normal, per channel (METHOD.md §2.15): a lightmap knows
    /// light about normals alone.
    fn turned(&self, surface: &Surface) -> Vec3 {
        let at = self.field.raised(surface.position, surface.facet);
        let [about_normal, about] = [surface.normal, surface.towards]
            .map(|direction| self.field.irradiance(&self.rows, at, direction));
        let share = (about / about_normal.max(Vec3::splat(1e-30))).min(Vec3::splat(TURNED_MOST));
        Vec3::select((about_normal + about).cmple(Vec3::ZERO), Vec3::ONE, share)
    }
}

impl IndirectIrradiance for Shown<'_> {
    fn indirect_irradiance(&self, surface: &Surface) -> Vec3 {
        let draw = &self.scene.draws.draws[surface.draw as usize];
        if [draw.front, draw.back] == [NO_BLOCK; 2] {
            return self.field.irradiance(&self.rows, surface.position, surface.towards);
        }
        let own = read(self.scene, &self.pages, surface);
        if surface.towards == surface.normal { own } else { own * self.turned(surface) }
    }

    fn mean_radiance(&self, point: Vec3) -> Vec3 {
        self.field.mean_radiance(&self.rows, point)
    }
}

impl FreeSpace for FieldTable {
    fn spacing_m(&self) -> f32 {
        match &self.between {
            Between::Lattice(_) => self.spacing_m,
            Between::Tetrahedra(tetrahedra) => tetrahedra.cell_m,
        }
    }

    fn lattice(&self) -> Option<Lattice<'_>> {
        let Between::Lattice(lattice) = &self.between else { return None };
        let (low, size) = (lattice.low, lattice.size);
        Some(Lattice { spacing_m: self.spacing_m, low, size, probe_at: &lattice.probe_at })
    }

    fn tetrahedra(&self) -> Option<Tetrahedra<'_>> {
        let Between::Tetrahedra(table) = &self.between else { return None };
        Some(Tetrahedra { places_m: &table.places_m, vertices: &table.vertices })
    }

    fn positions_m(&self) -> &[Vec4] {
        &self.position_m
    }

    fn distance_m(&self, probe: u32, direction: Vec3) -> f32 {
        self.distance_m(probe, direction)
    }
}

impl FieldLight {
    /// Coefficients at probes, of light in a lightmap that has settled.
    fn rows(&self, settled: &Settled, unshadowed: Unshadowed<'_>) -> Vec<Vec4> {
        let Unshadowed { sky, panorama, emitter_scale } = unshadowed;
        let columns = &self.lightmap.transport.columns;
        if settled.lambda.is_empty() {
            // Before the first bounce there is the sky alone.
            let sky = columns.skies_lambda(sky, panorama);
            let mut lambda = vec![Vec4::ZERO; columns.lambda_count() - sky.len()];
            lambda.extend(sky);
            return self.field.relit(&Threads, &lambda, emitter_scale);
        }
        self.field.relit(&Threads, &settled.lambda, emitter_scale)
    }
}

impl Light for FieldLight {
    fn shading(&self) -> Shading {
        let mut bindings = self.lightmap.shading().bindings;
        bindings.extend([uniform(false), storage_read(), storage_read()]);
        let snippet = match self.field.between {
            Between::Lattice(_) => IN_LATTICE,
            Between::Tetrahedra(_) => IN_TETRAHEDRA,
        };
        Shading { snippet, bindings }
    }

    fn medium(&self) -> Option<&'static str> {
        Some(medium(&self.field))
    }

    fn settle<'a>(&'a self, lit: &LitScene<'a>, among: &Among<'_>, limit: Limit) -> SettledLight<'a> {
        let Lit { light, .. } = self.lightmap.settled(lit, among, limit);
        let pages = spread(&lit.scene.lightmap, &self.lightmap.texels, &light.emit, &light.ind);
        let rows = self.rows(&light, lit.unshadowed);
        let (bounces, converged) = (light.bounces, light.converged);
        let walks = self.lightmap.walks(lit, light.lambda);
        let shown = Shown { scene: lit.scene, pages, field: &self.field, rows };
        SettledLight { indirect: Box::new(shown), walks, bounces, converged }
    }

    fn incoming(&self, lit: &LitScene<'_>) -> Option<IncomingDirect> {
        self.lightmap.incoming(lit)
    }

    fn at_receivers(&self, lit: &LitScene<'_>, among: &Among<'_>, limit: Limit) -> Option<SettledReceivers> {
        let settled = self.lightmap.settled(lit, among, limit);
        let probes = self.rows(&settled.light, lit.unshadowed);
        Some(settled.at_receivers(probes))
    }

    fn passes(
        &self,
        gpu: &Gpu,
        scene: &LoadedScene,
        shadow: &ShadowPass,
        _: [u32; 2],
    ) -> Result<Box<dyn LightPasses>> {
        Ok(Box::new(FieldPasses::new(gpu, scene, self, shadow)?))
    }

    /// Coefficients of emitters at probes stand behind E_emit of receivers.
    fn unshadowed(&self, light: Unshadowed<'_>) -> UnshadowedArrays {
        let mut arrays = self.lightmap.unshadowed(light);
        arrays
            .emit
            .extend(self.field.emitters.irradiance(PROBE_ROWS * self.field.len(), light.emitter_scale));
        arrays
    }

    fn tinted_albedo(&self, scene: &LoadedScene, tints: &Tints) -> Option<Vec<Vec4>> {
        self.lightmap.tinted_albedo(scene, tints)
    }

    fn set_albedo(&mut self, albedo: Vec<Vec4>) {
        self.lightmap.set_albedo(albedo);
    }

    fn debug_pictures(&self, scene: &LoadedScene) -> Vec<(&'static str, usize)> {
        self.lightmap.debug_pictures(scene)
    }

    fn debug_page(&self, name: &str, page: usize, lit: &LitScene<'_>, limit: Limit) -> Option<DebugPage> {
        self.lightmap.debug_page(name, page, lit, limit)
    }

    fn overlay(&self, overlay: Overlay, lod: Option<&LodPlan>) -> Option<Vec<Vec4>> {
        self.lightmap.overlay(overlay, lod)
    }

    fn lod_table(&self) -> Option<&LodTable> {
        self.lightmap.lod_table()
    }

    fn plan_lod(&self, lod: &Lod, eye: LodEye, before: Option<&LodPlan>) -> Option<LodPlan> {
        self.lightmap.plan_lod(lod, eye, before)
    }

    fn count_lod(&self, plan: &LodPlan) -> Option<[LevelCount; LOD_LEVELS]> {
        self.lightmap.count_lod(plan)
    }

    fn free_space(&self) -> Option<&dyn FreeSpace> {
        Some(&self.field)
    }

    fn voxels(&self) -> Option<(&VoxelTable, &PatchTable)> {
        self.lightmap.elements()
    }

    fn lightmap<'a>(&'a self, scene: &'a LoadedScene) -> Option<Lightmap<'a>> {
        self.lightmap.lightmap(scene)
    }
}
