//! A frame that stays: what changes lights, emitters, materials, objects or the camera writes to buffers and makes none, and nothing waits for the adapter.
//!
//! ```text
//! set_lights ───▶ shadow maps ─▶ direct ─▶ bounce, bounce, … ─▶ publish ─▶ draw
//! set_sky ───────────────────────────────▶    (a picture of its own makes a texture)
//! set_emitters ──────────────────────────▶    (once a frame, until they change nothing)
//! set_materials ────────────────▶ direct ─▶
//! set_objects ──▶ shadow maps ─▶ direct ─▶
//! set_camera ───▶ cascades of suns ──────────────────────────────────────▶ draw
//! set_lod ──────▶ detail of clusters ────▶
//! set_fog, set_details ──────────────────────────────────────────────────▶ draw
//! set_overlay ──▶ colours instead of light ──────────────────────────────▶ draw
//! ```
//! Bounces go on from the light that there is: after a small change a few are enough. Whoever shows frames paces them, as a window
//! does: an adapter that is slower than the caller falls behind.

mod bake;
mod bounces;
mod colours;
mod fog;
mod held;
mod lod;
mod movers;
mod objects;
mod overlay;
mod receivers;
mod room;
#[cfg(test)]
mod tests;
mod walks;

use std::sync::Arc;

use glam::{Vec3, Vec4};
use lightkiln_proto::relight::{Limit, Lod, LodPlan};
use lightkiln_proto::scene::{SceneCamera, SceneLight};

use crate::bake::{
    LightPasses, LoadedBake, MeasuredErrors, Overlay, ReceiverBuffers, ReceiverLight, Unshadowed,
};
use crate::error::Result;
use crate::lights::{Caster, Panorama, Sky, check_lights, check_scale};
use crate::passes::change::ChangePass;
use crate::passes::fog::{Fog, FogNumbers, FogPass};
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::shade::{ShadePass, ShadeView, SurfaceDetails};
use crate::passes::shadow::{Eye, ShadowPass, ShadowPlan, ShadowRoom};
use crate::passes::stopwatch::Stopwatch;
use crate::passes::walk::Walks;
use crate::picture::PassTime;
use crate::scene::{Stance, Tints, bounds_of};

use bounces::Bounces;
pub use held::Held;
pub(crate) use lod::{check_lod, lod_eye, lod_table};
use movers::Movers;

/// Room of a frame's buffers: what changes within it makes none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRoom {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Lights and their shadow maps.
    pub shadows: ShadowRoom,
}

/// All passes of a bake, with their buffers.
pub struct Frame<'a> {
    gpu: Held<'a, Gpu>,
    bake: Held<'a, LoadedBake>,
    room: FrameRoom,
    meshes: Meshes,
    pub(crate) shadow: ShadowPass,
    light: Box<dyn LightPasses>,
    /// None for a kind without feedback.
    change: Option<ChangePass>,
    shade: ShadePass,
    watch: Stopwatch,
    /// With its colours by slot.
    overlay: Option<(Overlay, Vec<Vec4>)>,
    errors: Option<MeasuredErrors>,
    has_paint: bool,
    details: SurfaceDetails,
    fog: Option<Fog>,
    fog_pass: Option<FogPass>,
    /// The view that the froxels are filled for, under light as it is.
    fog_filled: Option<FogNumbers>,
    walks: Walks,
    walking: Option<walks::Walking>,
    /// With bakes of their own.
    movers: Option<Movers>,
    lod: Option<Lod>,
    has_lod: bool,
    lod_plan: Option<LodPlan>,
    /// Number of the next bounce.
    turn: u32,
    casters: Vec<Caster>,
    sky: Sky,
    panorama: Option<Arc<Panorama>>,
    emitter_scale: Vec<f32>,
    tints: Tints,
    camera: SceneCamera,
    /// One for each object.
    stances: Vec<Stance>,
    /// Bounds of each object, in metres.
    object_bounds_m: Vec<[Vec3; 2]>,
    /// Of the scene with its objects, in metres.
    bounds_m: [[f32; 3]; 2],
    pub(crate) plan: ShadowPlan,
    stale: Stale,
    bounces: Bounces,
}

/// Work that changes have left to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stale {
    /// All shadow maps, and E_dir.
    lights: bool,
    /// E_dir alone.
    direct: bool,
    /// Cascades alone.
    cascades: bool,
    /// Sights of objects with bakes of their own.
    sights: bool,
    /// E_ind, which is to be black before the next bounce.
    light: bool,
    /// Irradiance of the last bounce as shading reads it.
    pages: bool,
}

impl<'a> Frame<'a> {
    /// Uploads a bake and makes all buffers and pipelines: without lights, seen by `camera`.
    pub fn new(
        gpu: impl Into<Held<'a, Gpu>>,
        bake: impl Into<Held<'a, LoadedBake>>,
        room: FrameRoom,
        camera: SceneCamera,
    ) -> Result<Self> {
        Self::of(gpu.into(), bake.into(), room, camera)
    }

    fn of(
        held_gpu: Held<'a, Gpu>,
        held_bake: Held<'a, LoadedBake>,
        room: FrameRoom,
        camera: SceneCamera,
    ) -> Result<Self> {
        let (gpu, bake) = (&*held_gpu, &*held_bake);
        let scene = &bake.scene;
        room.shadows.check()?;
        let meshes = Meshes::new(gpu, scene)?;
        let sights = bake.movers.len() as u32;
        let shadow = ShadowPass::with_sights(gpu, scene, &meshes, &room.shadows, sights)?;
        let mut light = bake.light.passes(gpu, scene, &shadow, room.size)?;
        let movers = Movers::new(gpu, bake, &shadow, &mut *light, room.size)?;
        let shading = (&bake.light.shading(), &light.bindings()[..]);
        let objects = movers.as_ref().and_then(Movers::shading);
        let shade = ShadePass::new(gpu, scene, &meshes, &shadow, shading, objects.as_ref(), room.size)?;
        drop(objects);
        let change = light.feedback().map(|feedback| ChangePass::new(gpu, feedback)).transpose()?;
        let watch = Stopwatch::new(gpu);
        gpu.check()?;
        let stances = vec![Stance::default(); scene.objects()];
        let at_rest = |(index, stance)| Ok(bounds_of(&scene.posed_object(index, stance)?));
        let object_bounds_m = stances.iter().enumerate().map(at_rest).collect::<Result<Vec<_>>>()?;
        let bounds_m = scene.bounds_with(object_bounds_m.iter().copied());
        let plan = ShadowPlan::within(&room.shadows, &[], bounds_m, None)?;
        let mut frame = Self {
            gpu: held_gpu,
            bake: held_bake,
            room,
            meshes,
            shadow,
            light,
            change,
            shade,
            watch,
            overlay: None,
            errors: None,
            has_paint: false,
            details: SurfaceDetails::default(),
            fog: None,
            fog_pass: None,
            fog_filled: None,
            walks: Walks::default(),
            walking: None,
            movers,
            lod: None,
            has_lod: false,
            lod_plan: None,
            turn: 0,
            casters: Vec::new(),
            sky: Sky::default(),
            panorama: None,
            emitter_scale: Vec::new(),
            tints: Tints::default(),
            camera,
            stances,
            object_bounds_m,
            bounds_m,
            plan,
            stale: Stale {
                lights: true,
                direct: true,
                cascades: true,
                sights: true,
                light: true,
                pages: true,
            },
            bounces: Bounces::default(),
        };
        frame.set_camera(frame.camera.clone())?;
        frame.place_movers()?;
        frame.write_unshadowed();
        Ok(frame)
    }

    /// Sets lights and skies. Errs, and changes nothing, where they are more than the room holds.
    pub fn set_lights(&mut self, lights: &[SceneLight]) -> Result<()> {
        check_lights(lights)?;
        let (casters, sky) = (Caster::of(lights), Sky::of(lights));
        if casters == self.casters {
            if sky != self.sky {
                self.sky = sky;
                self.write_unshadowed();
            }
            return Ok(());
        }
        self.plan = self.planned(&casters, &self.camera)?;
        (self.casters, self.sky) = (casters, sky);
        self.shadow.set(&self.gpu, &self.plan);
        (self.stale.lights, self.stale.cascades) = (true, true);
        self.write_unshadowed();
        Ok(())
    }

    /// Sets a panorama as the sky, on top of skies among the lights. Another picture makes a texture; its turn and strength make
    /// nothing. Errs, and changes nothing, where the adapter has no room for it.
    pub fn set_sky(&mut self, panorama: Option<&Arc<Panorama>>) -> Result<()> {
        if panorama != self.panorama.as_ref() {
            self.shade.set_panorama(&self.gpu, panorama.map(|panorama| &**panorama))?;
            self.panorama = panorama.cloned();
            self.write_unshadowed();
        }
        Ok(())
    }

    /// Sets the emitters' strengths, one factor each; 1 where absent.
    pub fn set_emitters(&mut self, scale: &[f32]) -> Result<()> {
        check_scale(scale)?;
        if scale != self.emitter_scale {
            self.emitter_scale = scale.to_vec();
            self.write_unshadowed();
            self.place_movers()?;
        }
        Ok(())
    }

    /// Sets the camera.
    pub fn set_camera(&mut self, camera: SceneCamera) -> Result<()> {
        self.view(&camera, [0.0; 2])?;
        let plan = self.planned(&self.casters, &camera)?;
        self.camera = camera;
        if plan != self.plan {
            self.plan = plan;
            self.shadow.set(&self.gpu, &self.plan);
            self.stale.cascades = true;
        }
        self.plan_lod();
        Ok(())
    }

    /// Shows details of surfaces that transport does not know, or leaves them out.
    pub fn set_details(&mut self, details: SurfaceDetails) {
        self.details = details;
    }

    /// One bounce more, and before it what changes ask for. Waits for nothing; ends with the number of bounces since the last change.
    pub fn advance(&mut self) -> Result<u32> {
        self.draw_shadows();
        let Some(change) = &mut self.change else { return Ok(0) };
        let clears = std::mem::take(&mut self.stale.light);
        self.light.set_turn(&self.gpu, self.turn);
        self.turn = self.turn.wrapping_add(1);
        self.watch.submit(&self.gpu, |encoder| {
            if let Some((e_ind, _)) = self.light.feedback().filter(|_| clears) {
                encoder.clear_buffer(e_ind, 0, None);
            }
            if let Some(movers) = &self.movers {
                if clears {
                    movers.clear(encoder, &*self.light);
                }
                movers.bounce(encoder, &self.shadow);
            }
            self.light.bounce(encoder);
        });
        if let Some(movers) = &mut self.movers {
            movers.ask(&self.gpu, &mut self.watch, self.bounces.count == 0);
        }
        let call = change.ask(&self.gpu, &mut self.watch);
        self.bounces.add(call);
        self.stale.pages = true;
        self.hear(false)?;
        Ok(self.bounces.count)
    }

    /// Bounces since lights changed.
    pub fn bounces(&self) -> u32 {
        self.bounces.count
    }

    /// The camera that was set last.
    pub fn camera(&self) -> &SceneCamera {
        &self.camera
    }

    /// Bounces until they change less than the limit, each waited for: their number, and whether they converged.
    pub fn settle(&mut self, limit: Limit) -> Result<(u32, bool)> {
        self.draw_shadows();
        let is_settled = |frame: &Self| {
            frame.change.is_none() || frame.change().is_some_and(|change| change < limit.change_max)
        };
        while !is_settled(self) && self.bounces.count < limit.bounces_max {
            self.advance()?;
            self.hear(true)?;
        }
        Ok((self.bounces.count, is_settled(self)))
    }

    /// Draws one sample per pixel, `jitter` pixels (right, down) from the pixels' middles, with the light of the last bounce.
    pub fn draw(&mut self, jitter: [f32; 2]) -> Result<()> {
        self.draw_shadows();
        let view = self.view(&self.camera, jitter)?.showing_irradiance(self.overlay.is_some());
        let publishes = std::mem::take(&mut self.stale.pages);
        let overlay = self.overlay.as_ref().filter(|_| publishes);
        let colours = overlay.map(|of| overlay::colours_of(of, &self.bake, self.lod_plan.as_ref()));
        let (gpu, light) = (&*self.gpu, &self.light);
        self.watch.submit(gpu, |encoder| {
            if let Some(movers) = self.movers.as_ref().filter(|_| publishes) {
                movers.publish(encoder);
            }
            match colours {
                Some(colours) => light.paint(gpu, encoder, &colours),
                None if publishes => light.publish(encoder),
                None => {}
            }
            light.prepare_view(gpu, encoder, &view);
        });
        let view = self.walk(view, jitter)?;
        self.shade.draw((&self.gpu, &mut self.watch), &self.meshes, &self.shadow, &view);
        self.draw_walks_of_eye();
        self.draw_fog(publishes)?;
        let gpu = &*self.gpu;
        gpu.poll(false)?;
        self.watch.hear(gpu)
    }

    /// The sample drawn last, on the adapter: rgb radiance, alpha 1 on surfaces. [`Frame::resize`] makes another one.
    pub fn radiance(&self) -> &wgpu::TextureView {
        self.shade.radiance()
    }

    /// Time that the adapter took for each pass, by its own clock; `None` where it has none.
    pub fn pass_times(&self) -> Option<&[PassTime]> {
        self.watch.is_there().then(|| self.watch.times())
    }

    /// Takes the times of all passes so far, after a wait for them.
    pub fn hear_times(&mut self) -> Result<()> {
        self.gpu.poll(true)?;
        self.watch.hear(&self.gpu)
    }

    /// The sample drawn last, after a wait: rgb radiance in W·m⁻²·sr⁻¹, alpha 1 on surfaces.
    pub fn read(&self) -> Result<Vec<Vec4>> {
        self.shade.read(&self.gpu)
    }

    /// Light at receivers and probes as of the last bounce, after a wait; `None` for a kind without receivers.
    pub fn read_receivers(&mut self) -> Result<Option<ReceiverLight>> {
        if std::mem::take(&mut self.stale.pages) {
            self.watch.submit(&self.gpu, |encoder| {
                self.movers.iter().for_each(|movers| movers.publish(encoder));
                self.light.publish(encoder);
            });
        }
        receivers::read(&self.gpu, &*self.light)
    }

    /// Light at receivers of objects with bakes of their own, as of the last [`Frame::read_receivers`], after a wait.
    pub fn read_objects(&self) -> Result<Vec<ReceiverLight>> {
        self.movers.as_ref().map_or(Ok(Vec::new()), |movers| movers.read(&self.gpu))
    }

    /// The buffers that hold light at receivers on the adapter; `None` for a kind without receivers. Bounces that follow write to them.
    pub fn receiver_buffers(&self) -> Option<ReceiverBuffers<'_>> {
        self.light.at_receivers()
    }

    fn planned(&self, casters: &[Caster], camera: &SceneCamera) -> Result<ShadowPlan> {
        ShadowPlan::within(&self.room.shadows, casters, self.bounds_m, eye_of(camera))
    }

    fn view(&self, camera: &SceneCamera, jitter: [f32; 2]) -> Result<ShadeView> {
        let view = ShadeView::new(camera, self.room.size, self.bounds_m, self.sky, jitter)?;
        Ok(view.with_details(self.details))
    }

    /// Writes light that no shadow map has: all bounces are of other light from here on.
    fn write_unshadowed(&mut self) {
        let panorama = self.panorama.as_deref();
        let light = Unshadowed { sky: self.sky, panorama, emitter_scale: &self.emitter_scale };
        let arrays = self.bake.light.unshadowed(light);
        self.light.set_unshadowed(&self.gpu, &arrays);
        self.shade.set_looks(&self.gpu, &self.bake.scene, &self.tints, &self.emitter_scale);
        self.write_glows();
        // Light that nothing sends any more would fade for ever.
        let is_dark = self.casters.is_empty() && self.sky == Sky::default() && panorama.is_none();
        self.stale.light |= is_dark && arrays.emit.iter().all(|emit| *emit == Vec4::ZERO);
        self.stale.pages = true;
        self.bounces = Bounces::default();
    }

    /// Takes the answers that are there, or waits for all that are under way.
    fn hear(&mut self, waits: bool) -> Result<()> {
        let Some(change) = &mut self.change else { return Ok(()) };
        let answers = change.answers(&self.gpu, waits)?;
        if let Some(movers) = &mut self.movers {
            self.stale.light |= movers.hear(&self.gpu, waits)?;
        }
        self.watch.hear(&self.gpu)?;
        let cycle = self.cycle();
        for answer in answers {
            // Light that is no number stays none.
            self.stale.light |= !answer.change.is_finite();
            self.bounces.hear(answer, cycle);
        }
        Ok(())
    }

    /// Draws the shadow maps that changes ask for, and E_dir.
    fn draw_shadows(&mut self) {
        let Stale { lights, direct, cascades, sights, .. } = self.stale;
        let first = if lights { 0 } else { self.plan.first_cascade };
        if !cascades && !direct && !sights {
            return;
        }
        self.fog_filled = None;
        self.watch.submit(&self.gpu, |encoder| {
            if cascades {
                self.shadow.record(encoder, &self.meshes, first..self.plan.faces.len());
            }
            if let Some(movers) = self.movers.as_ref().filter(|_| sights) {
                let own = 0..self.bake.scene.own_draws();
                self.shadow.record_sights(encoder, (&self.meshes, own), &movers.drawn());
            }
            if lights || direct {
                self.light.relit(encoder, &self.shadow);
                self.movers.iter().for_each(|movers| movers.relit(encoder, &self.shadow));
            }
        });
        self.stale = Stale { lights: false, direct: false, cascades: false, sights: false, ..self.stale };
    }
}

/// Where suns' cascades are; none for a parallel camera, which sees all alike.
pub(crate) fn eye_of(camera: &SceneCamera) -> Option<Eye> {
    let [position_m, target_m] = [camera.eye_m, camera.target_m].map(Vec3::from);
    let forward = (target_m - position_m).try_normalize()?;
    camera.orthographic_half_height_m.is_none().then_some(Eye { position_m, forward })
}
