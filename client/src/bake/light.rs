//! Light of a bake of any kind: the work before shading, and the inputs of shading.

use std::fmt::Debug;

use glam::{Affine3A, Vec4};
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::{
    LOD_LEVELS, LevelCount, Limit, Lod, LodEye, LodPlan, LodTable, Panorama, PatchTable, Sky, SkyRows,
};
use lightkiln_proto::transfer::TransferTable;
use lightkiln_proto::voxels::VoxelTable;

use super::{Among, FreeSpace, SettledWalks};
use crate::error::Result;
use crate::fetch::Source;
use crate::passes::around::AroundPass;
use crate::passes::atlas::Lightmap;
use crate::passes::gpu::Gpu;
use crate::passes::shade::{IndirectIrradiance, ShadeView, Shading};
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{ShadowPass, ShadowPlan};
use crate::passes::stopwatch::Recorder;
use crate::passes::transfer::MovedBuffers;
use crate::scene::{LoadedScene, Tints};
use crate::stream::{Baked, Budget, Streamed, Viewpoint};

/// A scene under lights, with the shadow maps of the processor.
#[derive(Clone, Copy, Debug)]
pub struct LitScene<'a> {
    /// The scene.
    pub scene: &'a LoadedScene,
    /// Lights that cast shadows.
    pub plan: &'a ShadowPlan,
    /// Their shadow maps.
    pub maps: &'a ShadowMaps,
    /// Their light that no shadow map has.
    pub unshadowed: Unshadowed<'a>,
    /// Level of detail of each cluster, of the same bake; all detail without one.
    pub lod: Option<&'a LodPlan>,
}

/// Light that no shadow map has.
#[derive(Clone, Copy, Debug)]
pub struct Unshadowed<'a> {
    /// The sky.
    pub sky: Sky,
    /// A panorama on top of it.
    pub panorama: Option<&'a Panorama>,
    /// One factor per emitter of the manifest; 1 where absent.
    pub emitter_scale: &'a [f32],
}

/// Direct light that bounces start from, on the processor, W·m⁻².
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IncomingDirect {
    /// E_dir of receivers by slot.
    pub receivers: Vec<Vec4>,
    /// E_dir by near hit.
    pub near: Vec<Vec4>,
}

/// Light at receivers by slot, W·m⁻².
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReceiverLight {
    /// E_dir.
    pub direct: Vec<Vec4>,
    /// E_emit.
    pub emit: Vec<Vec4>,
    /// E_ind, with the sky's own light.
    pub indirect: Vec<Vec4>,
    /// Coefficients at probes of [`Light::free_space`], [`super::PROBE_COEFFICIENTS`] each, of all light but direct light of lamps; empty
    /// without probes.
    pub probes: Vec<Vec4>,
}

impl ReceiverLight {
    /// E_ind with E_emit by slot, W·m⁻²: all but what lamps send at once.
    pub fn without_direct(&self) -> impl Iterator<Item = Vec4> + '_ {
        self.indirect.iter().zip(&self.emit).map(|(indirect, emit)| *indirect + *emit)
    }

    /// Adds to E_ind by slot what objects give and take, W·m⁻²; the sum with E_emit is never below 0.
    pub(crate) fn add_moved(&mut self, moved: &[Vec4]) {
        let own = self.indirect.iter_mut().zip(&self.emit).zip(moved);
        own.for_each(|((indirect, emit), moved)| *indirect = (*indirect + *moved).max(-*emit));
    }
}

/// Light at receivers after the last bounce.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SettledReceivers {
    /// The light.
    pub light: ReceiverLight,
    /// Bounces.
    pub bounces: u32,
    /// Whether they had converged before the last one allowed.
    pub converged: bool,
}

/// The buffers of [`ReceiverLight`] on the adapter, each but the last of so many [`Vec4`].
#[derive(Clone, Copy, Debug)]
pub struct ReceiverBuffers<'a> {
    /// E_dir.
    pub direct: &'a wgpu::Buffer,
    /// E_emit.
    pub emit: &'a wgpu::Buffer,
    /// E_ind, with the sky's own light.
    pub indirect: &'a wgpu::Buffer,
    /// Receivers.
    pub count: usize,
    /// Coefficients at probes as of the last [`LightPasses::publish`], and how many there are, of a kind with a field.
    pub probes: Option<(&'a wgpu::Buffer, usize)>,
}

/// Light that no shadow map has, as the adapter takes it; empty for a kind that takes none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnshadowedArrays {
    /// E_emit by slot, W·m⁻².
    pub emit: Vec<Vec4>,
    /// The end of λ: the sky's.
    pub sky: Vec<Vec4>,
}

/// Indirect light after the last bounce, on the processor.
pub struct SettledLight<'a> {
    /// The shading function.
    pub indirect: Box<dyn IndirectIrradiance + 'a>,
    /// Its voxels, of a bake that has some.
    pub walks: Option<SettledWalks<'a>>,
    /// Bounces; 0 for a kind without feedback.
    pub bounces: u32,
    /// Whether they had converged before the last one allowed.
    pub converged: bool,
}

/// One page of a picture for finding faults.
#[derive(Clone, Debug, PartialEq)]
pub struct DebugPage {
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Row after row.
    pub texels: Vec<Vec4>,
    /// Bounces before it was drawn.
    pub bounces: u32,
    /// Whether they had converged.
    pub converged: bool,
}

/// Colours over surfaces that show how a bake is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overlay {
    /// One for each cluster.
    Clusters,
    /// One for each of the finest patches.
    Patches,
    /// Green where a bake's own clusters are, the first so many of those that are there, red where the overview stands for them.
    Residency {
        /// Clusters that have come.
        clusters: usize,
    },
    /// Levels of detail, the finest first: red, green, blue, yellow.
    Lod,
    /// Blue where light is too dark, red where it is too bright, by measured errors that a frame was given.
    Errors {
        /// Number of the light that they were measured under.
        light: usize,
    },
}

/// The light of a loaded bake.
pub trait Light: Debug + Send + Sync {
    /// The shading function in WGSL.
    fn shading(&self) -> Shading;

    /// WGSL of `fn mean_radiance(point: vec3f) -> vec3f`, which a medium scatters, with the bindings of shading in group 1 from 1; `None`
    /// for a kind without probes in free space.
    fn medium(&self) -> Option<&'static str> {
        None
    }

    /// Work before shading on the processor: bounces until they converge. Kinds without voxels have nothing beside them and leave `among` aside.
    fn settle<'a>(&'a self, lit: &LitScene<'a>, among: &Among<'_>, limit: Limit) -> SettledLight<'a>;

    /// The direct light that its bounces start from; `None` for a kind that takes none.
    fn incoming(&self, lit: &LitScene<'_>) -> Option<IncomingDirect> {
        let _ = lit;
        None
    }

    /// Light at receivers after the last bounce, on the processor; `None` for a kind without receivers.
    fn at_receivers(&self, lit: &LitScene<'_>, among: &Among<'_>, limit: Limit) -> Option<SettledReceivers> {
        let _ = (lit, among, limit);
        None
    }

    /// Irradiance at receivers by parts of the sky alone, before any bounce; made when it is first asked for. `None` for a kind without receivers.
    fn sky_rows(&self) -> Option<&SkyRows> {
        None
    }

    /// Work before shading on the adapter, with the buffers that it needs, for views of `size`: width and height in pixels.
    fn passes(
        &self,
        gpu: &Gpu,
        scene: &LoadedScene,
        shadow: &ShadowPass,
        size: [u32; 2],
    ) -> Result<Box<dyn LightPasses>>;

    /// The arrays of [`LightPasses::set_unshadowed`].
    fn unshadowed(&self, light: Unshadowed<'_>) -> UnshadowedArrays {
        let _ = light;
        UnshadowedArrays::default()
    }

    /// Albedo of receivers by slot, of materials with these tints; `None` for a kind whose light does not hang on it.
    fn tinted_albedo(&self, scene: &LoadedScene, tints: &Tints) -> Option<Vec<Vec4>> {
        let _ = (scene, tints);
        None
    }

    /// Takes the result of [`Light::tinted_albedo`] for the bake's own.
    fn set_albedo(&mut self, albedo: Vec<Vec4>) {
        let _ = albedo;
    }

    /// Pictures for finding faults that the kind draws: name and number of pages.
    fn debug_pictures(&self, scene: &LoadedScene) -> Vec<(&'static str, usize)> {
        let _ = scene;
        Vec::new()
    }

    /// A page of one of [`Light::debug_pictures`]; `None` for other names and pages.
    fn debug_page(&self, name: &str, page: usize, lit: &LitScene<'_>, limit: Limit) -> Option<DebugPage> {
        let _ = (name, page, lit, limit);
        None
    }

    /// Colours by slot that [`LightPasses::paint`] lays over surfaces, in the detail of `lod`; `None` for an overlay that the kind
    /// has not.
    fn overlay(&self, overlay: Overlay, lod: Option<&LodPlan>) -> Option<Vec<Vec4>> {
        let _ = (overlay, lod);
        None
    }

    /// Facts of the bake that levels of detail need; `None` for a kind without them.
    fn lod_table(&self) -> Option<&LodTable> {
        None
    }

    /// The detail of each cluster for an eye, see [`LodTable::plan`]; `None` for a kind without levels of detail.
    fn plan_lod(&self, lod: &Lod, eye: LodEye, before: Option<&LodPlan>) -> Option<LodPlan> {
        let _ = (lod, eye, before);
        None
    }

    /// Work of a plan by level; `None` for a kind without levels of detail.
    fn count_lod(&self, plan: &LodPlan) -> Option<[LevelCount; LOD_LEVELS]> {
        let _ = plan;
        None
    }

    /// Whether it is that of lights chosen now; otherwise it stays as it was baked, whatever lights shine directly.
    fn follows_lights(&self) -> bool {
        true
    }

    /// The probes whose light [`ReceiverLight::probes`] is, where the kind has them.
    fn free_space(&self) -> Option<&dyn FreeSpace> {
        None
    }

    /// Voxels, of a bake that has some, and the patches that they name.
    fn voxels(&self) -> Option<(&VoxelTable, &PatchTable)> {
        None
    }

    /// The volume of a bake that is an object's.
    fn volume(&self) -> Option<&TransferTable> {
        None
    }

    /// The lightmap, where the kind has one.
    fn lightmap<'a>(&'a self, scene: &'a LoadedScene) -> Option<Lightmap<'a>> {
        let _ = scene;
        None
    }
}

/// Light that comes piece by piece. With all of its pieces it is that of [`super::ClientKind::load`], bit for bit.
pub trait LightStream: Debug + Send {
    /// Bytes and clusters that have come.
    fn streamed(&self) -> Streamed;

    /// The light of the pieces that have come, of clusters that a manifest lists.
    fn light(&self, scene: &LoadedScene, manifest: &Manifest) -> Result<Box<dyn Light>>;

    /// Goes on with the manifest of a bake under way that lists more clusters behind those that it did.
    fn grown(&mut self, manifest: &Manifest, baked: Baked);

    /// Goes on with the manifest of the bake, which is done, after the one `before` while it was under way: the pieces that have
    /// come are in its order.
    fn ended(&mut self, source: &Source, before: &Manifest, manifest: &Manifest) -> Result<()>;

    /// Another view is fetched for from here on: pieces that came for the one before may go again.
    fn change_view(&mut self);

    /// Fetches pieces as far as the budget goes, those first that the lit scene needs most from the viewpoint; where memory is short,
    /// lets as many of those go that it needs least as the new ones need room, but none that came for this view. Pieces that came
    /// before an error stay. `light` is that of the pieces that have come, as it is drawn; the manifest lists all.
    fn refine(
        &mut self,
        of: (&Source, &Manifest),
        light: &dyn Light,
        lit: &LitScene<'_>,
        viewpoint: Option<Viewpoint>,
        budget: Budget,
        limit: Limit,
    ) -> Result<()>;
}

/// Work before shading on the adapter, in the order of the hooks: `set_unshadowed` and `relit` when lights change, `bounce` often,
/// `publish` before a picture, `prepare_view` for each view. A kind records passes and copies in its own order; none makes a
/// buffer, a bind group or a pipeline.
pub trait LightPasses {
    /// Writes light that no shadow map has: the result of [`Light::unshadowed`].
    fn set_unshadowed(&self, gpu: &Gpu, light: &UnshadowedArrays) {
        let _ = (gpu, light);
    }

    /// Writes albedo of receivers: the result of [`Light::tinted_albedo`]. [`LightPasses::relit`] is to follow, as light of near hits has
    /// albedo in it.
    fn set_albedo(&self, gpu: &Gpu, albedo: &[Vec4]) {
        let _ = (gpu, albedo);
    }

    /// Records the work that a change of lights asks for, with new shadow maps.
    fn relit(&self, encoder: &mut Recorder<'_>, shadow: &ShadowPass) {
        let _ = (encoder, shadow);
    }

    /// Records one bounce.
    fn bounce(&self, encoder: &mut Recorder<'_>) {
        let _ = encoder;
    }

    /// Writes where the bake of an object stands.
    fn set_place(&self, gpu: &Gpu, world_from_own: &Affine3A) {
        let _ = (gpu, world_from_own);
    }

    /// Makes room for what objects beside the bake give and take at its receivers, once; from then on bounces have it.
    fn make_moved(&mut self, gpu: &Gpu) -> Result<()> {
        let _ = gpu;
        Ok(())
    }

    /// That room; `None` for a kind without receivers.
    fn moved(&self) -> Option<MovedBuffers<'_>> {
        None
    }

    /// Makes room for light of what is around the bake of an object, once; from then on bounces have it.
    fn make_around(&mut self, gpu: &Gpu, around: &AroundPass, rows: &SkyRows) -> Result<()> {
        let _ = (gpu, around, rows);
        Ok(())
    }

    /// Records that light, of what viewpoints see now.
    fn light_around(&self, encoder: &mut Recorder<'_>) {
        let _ = encoder;
    }

    /// Makes what [`LightPasses::set_lod`] needs, once.
    fn make_lod(&mut self, gpu: &Gpu, table: &LodTable) -> Result<()> {
        let _ = (gpu, table);
        Ok(())
    }

    /// Writes the detail of each cluster from the next bounce on; all of each without a plan.
    fn set_lod(&mut self, gpu: &Gpu, plan: Option<&LodPlan>) {
        let _ = (gpu, plan);
    }

    /// Writes the number of the next bounce, by which clusters take turns.
    fn set_turn(&self, gpu: &Gpu, bounce: u32) {
        let _ = (gpu, bounce);
    }

    /// Records the step from the bounces' result to the bindings of shading.
    fn publish(&self, encoder: &mut Recorder<'_>) {
        let _ = encoder;
    }

    /// Records the work that a view asks for before it is shaded; buffers written through `gpu` hold their values when the
    /// work runs. Twin: [`IndirectIrradiance::prepare_view`].
    fn prepare_view(&self, gpu: &Gpu, encoder: &mut Recorder<'_>, view: &ShadeView) {
        let _ = (gpu, encoder, view);
    }

    /// Makes what [`LightPasses::paint`] needs, once.
    fn make_paint(&mut self, gpu: &Gpu) -> Result<()> {
        let _ = gpu;
        Ok(())
    }

    /// Records colours by slot instead of irradiance into the bindings of shading; [`LightPasses::publish`] puts the light back.
    fn paint(&self, gpu: &Gpu, encoder: &mut Recorder<'_>, colours: &[Vec4]) {
        let _ = (gpu, encoder, colours);
    }

    /// E_ind that bounces feed back, as so many [`Vec4`], whose change tells when they have converged; `None` for a kind
    /// without feedback.
    fn feedback(&self) -> Option<(&wgpu::Buffer, usize)> {
        None
    }

    /// The buffers that hold light at receivers; `None` for a kind without receivers.
    fn at_receivers(&self) -> Option<ReceiverBuffers<'_>> {
        None
    }

    /// λ as of the last bounce; `None` for a kind without surface patches.
    fn lambda(&self) -> Option<&wgpu::Buffer> {
        None
    }

    /// Resources of [`Shading::bindings`].
    fn bindings(&self) -> Vec<wgpu::BindingResource<'_>>;
}
