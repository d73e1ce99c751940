//! State and pictures of a window, without the window: input and edits in, pictures out, one bounce each, and no wait in between.

use std::error::Error as _;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use lightkiln_proto::relight::{LOD_LEVELS, LevelCount};
use lightkiln_proto::scene::SceneCamera;

use super::edits::Edits;
use super::fly::Fly;
use super::handles::{self, Ball, Drag, Handle};
use super::input::{Button, Input, Key};
use super::lens::Lens;
use crate::bake::{LoadedBake, MeasuredErrors, Overlay};
use crate::error::{ClientError, Result};
use crate::frame::{Frame, FrameRoom};
use crate::lights::Caster;
use crate::passes::gpu::Gpu;
use crate::passes::meter::MeterPass;
use crate::passes::shadow::ShadowRoom;
use crate::passes::show::{ShowPass, ShowSum};
use crate::passes::walk::Walks;
use crate::picture::{Exposure, PassTime, Tone};
use crate::preview::{View, jitters};
use crate::scene::Recolour;

/// Relative change of the automatic exposure that is followed: less is not seen.
const EXPOSURE_STEP: f32 = 2e-3;

/// State of the light, for people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// Bounces since the last change.
    pub bounces: u32,
    /// Relative change by the last one that was heard of.
    pub change: Option<f32>,
    /// No more are made.
    pub is_settled: bool,
}

/// A bake, its frame, and what the user does to them.
pub struct Viewer {
    gpu: Arc<Gpu>,
    bake: Arc<LoadedBake>,
    frame: Frame<'static>,
    show: ShowPass,
    sum: ShowSum,
    meter: MeterPass,
    view: View,
    size: [u32; 2],
    /// State that the panel changes.
    pub edits: Edits,
    applied: Edits,
    /// Camera.
    pub fly: Fly,
    /// The chosen light.
    pub chosen: Option<usize>,
    /// The panel is open.
    pub is_panel_open: bool,
    /// The user asked for a picture.
    pub wants_picture: bool,
    /// The last thing that was refused or done, for people.
    pub notice: Option<String>,
    /// Names of the lights that errors were measured under.
    pub error_lights: Vec<String>,
    drag: Option<Drag>,
    pointer: Vec2,
    looks_around: bool,
    samples: u32,
    exposure: f32,
    /// Calls of the light meter, and answers.
    metered: [u64; 2],
    is_metered: bool,
}

impl Viewer {
    /// A viewer of a bake at a view, for screens of that format. Waits once, for the first exposure.
    pub fn new(
        (gpu, screen): (Arc<Gpu>, wgpu::TextureFormat),
        bake: Arc<LoadedBake>,
        view: View,
        recolours: &[Recolour],
    ) -> Result<Self> {
        let edits = Edits::of(&view, &bake.scene, recolours);
        let size = [view.width, view.height];
        let shadows = ShadowRoom::for_lights(&Caster::of(&view.lights), view.shadow_side)?;
        let room = FrameRoom { size, shadows };
        let mut frame = Frame::new(Arc::clone(&gpu), Arc::clone(&bake), room, view.camera.clone())?;
        frame.set_lights(&edits.lights)?;
        frame.set_sky(edits.panorama.as_ref())?;
        frame.set_emitters(&edits.emitters)?;
        frame.set_fog(edits.fog)?;
        frame.set_details(edits.details);
        // Windows accumulate: a quarter of the pixels walk in each sample.
        frame.set_walks(Walks { step: 2, ..view.walks })?;
        frame.set_materials(&edits.recolours())?;
        frame.set_objects(&edits.stances())?;
        frame.set_lod(edits.lod)?;
        let show = ShowPass::new(&gpu, screen);
        let sum = show.sum(&gpu, frame.radiance(), size)?;
        let meter = MeterPass::new(&gpu, frame.radiance(), size)?;
        let diagonal_m = diagonal_of(&bake);
        let fly = Fly::new(view.camera.clone(), diagonal_m);
        let mut viewer = Self {
            gpu,
            bake,
            frame,
            show,
            sum,
            meter,
            view,
            size,
            applied: edits.clone(),
            edits,
            fly,
            chosen: None,
            is_panel_open: true,
            wants_picture: false,
            notice: None,
            error_lights: Vec::new(),
            drag: None,
            pointer: Vec2::ZERO,
            looks_around: false,
            samples: 0,
            exposure: 1.0,
            metered: [0; 2],
            is_metered: false,
        };
        viewer.frame.advance()?;
        viewer.sample()?;
        viewer.gpu.poll(true)?;
        viewer.hear_meter()?;
        Ok(viewer)
    }

    /// The bake.
    pub fn bake(&self) -> &LoadedBake {
        &self.bake
    }

    /// Camera as it is.
    pub fn camera(&self) -> &SceneCamera {
        self.fly.camera()
    }

    /// Width and height of pictures in pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Longest way through the scene's bounds, in metres.
    pub fn diagonal_m(&self) -> f32 {
        diagonal_of(&self.bake)
    }

    /// The view that is shown, as headless pictures take it.
    pub fn view(&self) -> View {
        let objects = self.applied.stances();
        let Edits { lights, panorama, emitters, fog, details, exposure, tone, lod, .. } =
            self.applied.clone();
        let camera = self.frame.camera().clone();
        let [width, height] = self.size;
        let emitter_scale = emitters;
        View {
            camera,
            width,
            height,
            lights,
            panorama,
            emitter_scale,
            objects,
            fog,
            details,
            exposure,
            tone,
            lod,
            ..self.view.clone()
        }
    }

    /// Between the scene and the picture; none for a camera that sees nothing.
    pub fn lens(&self) -> Option<Lens> {
        Lens::new(self.camera(), self.size, self.bake.scene.manifest.bounds_m).ok()
    }

    /// Handles of lights in the picture; aims are those of the chosen light.
    pub fn handles(&self) -> Vec<Handle> {
        let Some(lens) = self.lens() else { return Vec::new() };
        handles::shown(handles::handles(&self.edits.lights, &lens, self.ball()), self.chosen)
    }

    /// Corners in the picture of the chosen light, if it is a rectangle.
    pub fn outline(&self) -> Option<[Vec2; 4]> {
        let light = self.edits.lights.get(self.chosen?)?;
        handles::outline(light, &self.lens()?)
    }

    /// The ball that suns lie on.
    pub fn ball(&self) -> Ball {
        Ball::before(self.camera(), self.diagonal_m())
    }

    /// A place before the eye, for a new light.
    pub fn place_ahead_m(&self) -> [f32; 3] {
        let [eye, target] = [self.camera().eye_m, self.camera().target_m].map(Vec3::from);
        (eye + (target - eye).normalize_or(Vec3::NEG_Z) * 0.15 * self.diagonal_m()).into()
    }

    /// Factor on radiance of the picture.
    pub fn exposure(&self) -> f32 {
        self.exposure
    }

    /// State of the light.
    pub fn settling(&self) -> Settling {
        let (bounces, change) = (self.frame.bounces(), self.frame.change());
        let limit = self.view.limit;
        let is_settled =
            bounces >= limit.bounces_max || change.is_some_and(|change| change < limit.change_max);
        Settling { bounces, change, is_settled }
    }

    /// Work by level of detail; none where there is all detail.
    pub fn lod_counts(&self) -> Option<[LevelCount; LOD_LEVELS]> {
        self.frame.lod_counts()
    }

    /// Times of the adapter's passes; none where it has no clock.
    pub fn pass_times(&self) -> Option<&[PassTime]> {
        self.frame.pass_times()
    }

    /// Takes what the user did.
    pub fn input(&mut self, input: Input) {
        match input {
            Input::Key(Key::Panel, true) => self.is_panel_open = !self.is_panel_open,
            Input::Key(Key::Picture, true) => self.wants_picture = true,
            Input::Key(Key::Delete, true) => self.remove_chosen(),
            Input::Key(key, is_down) => self.fly.key(key, is_down),
            Input::Wheel(notches) => self.fly.wheel(notches),
            Input::Pointer(pixel) => self.point(pixel),
            Input::Button(Button::Right, is_down) => self.looks_around = is_down,
            Input::Button(Button::Left, true) => self.take(),
            Input::Button(Button::Left, false) => self.drag = None,
            Input::Release => {
                self.fly.release();
                (self.drag, self.looks_around) = (None, false);
            }
        }
    }

    /// Removes the chosen light.
    pub fn remove_chosen(&mut self) {
        self.drag = None;
        if let Some(light) = self.chosen.take().filter(|light| *light < self.edits.lights.len()) {
            self.edits.lights.remove(light);
        }
    }

    fn take(&mut self) {
        let (handles, ball) = (self.handles(), self.ball());
        let taken = handles::at(&handles, self.pointer).zip(self.lens());
        self.drag = taken.map(|(handle, lens)| Drag::take(handle, self.pointer, &lens, ball));
        if let Some(drag) = &self.drag {
            self.chosen = Some(drag.handle.light);
        }
    }

    fn point(&mut self, pixel: Vec2) {
        let moved = pixel - self.pointer;
        self.pointer = pixel;
        if self.looks_around {
            self.fly.look(moved);
        }
        let (lens, ball, along) = (self.lens(), self.ball(), self.fly.holds(Key::Shift));
        if let Some((drag, lens)) = self.drag.as_mut().zip(lens) {
            match self.edits.lights.get_mut(drag.handle.light) {
                Some(light) => drag.to(pixel, along, (&lens, ball), light),
                None => self.drag = None,
            }
        }
    }

    /// Something goes on: the next picture differs, or an answer is to come.
    pub fn is_busy(&self) -> bool {
        let [asked, heard] = self.metered;
        self.fly.is_flying()
            || self.edits.objects.iter().any(|object| object.plays)
            || self.edits != self.applied
            || self.fly.camera() != self.frame.camera()
            || !self.settling().is_settled
            || self.samples < self.view.samples
            || asked > heard
    }

    /// Goes on by so many seconds: changes, a bounce unless light has settled, a sample unless the picture has them all.
    pub fn step(&mut self, seconds: f32) -> Result<()> {
        self.fly.step(seconds);
        self.edits.play(seconds);
        self.apply()?;
        if !self.settling().is_settled {
            self.frame.advance()?;
            self.samples = 0;
        }
        self.hear_meter()?;
        if self.samples < self.view.samples {
            self.sample()?;
        }
        Ok(())
    }

    /// Hands changes to the frame. Those that it refuses are taken back, and said.
    fn apply(&mut self) -> Result<()> {
        if self.frame.camera() != self.fly.camera()
            && self.frame.set_camera(self.fly.camera().clone()).is_ok()
        {
            self.samples = 0;
        }
        if self.edits == self.applied {
            return Ok(());
        }
        self.samples = 0;
        if self.edits.lights != self.applied.lights {
            let lights = &self.edits.lights;
            let room = self.frame.make_room(lights, self.view.shadow_side);
            let set = room.and_then(|()| self.frame.set_lights(lights));
            if self.refused(set)? {
                self.edits.lights.clone_from(&self.applied.lights);
            }
        }
        if self.edits.panorama != self.applied.panorama {
            let set = self.frame.set_sky(self.edits.panorama.as_ref());
            if self.refused(set)? {
                self.edits.panorama.clone_from(&self.applied.panorama);
            }
        }
        if self.edits.emitters != self.applied.emitters {
            let set = self.frame.set_emitters(&self.edits.emitters);
            if self.refused(set)? {
                self.edits.emitters.clone_from(&self.applied.emitters);
            }
        }
        if self.edits.fog != self.applied.fog {
            let set = self.frame.set_fog(self.edits.fog);
            if self.refused(set)? {
                self.edits.fog = self.applied.fog;
            }
        }
        self.frame.set_details(self.edits.details);
        if self.edits.colours != self.applied.colours {
            let set = self.frame.set_materials(&self.edits.recolours());
            if self.refused(set)? {
                self.edits.colours.clone_from(&self.applied.colours);
            }
        }
        if self.edits.objects != self.applied.objects {
            let set = self.frame.set_objects(&self.edits.stances());
            if self.refused(set)? {
                self.edits.objects.clone_from(&self.applied.objects);
                self.edits.objects.iter_mut().for_each(|object| object.plays = false);
            }
        }
        if self.edits.lod != self.applied.lod {
            let set = self.frame.set_lod(self.edits.lod);
            if self.refused(set)? {
                self.edits.lod = self.applied.lod;
            }
        }
        if self.edits.overlay != self.applied.overlay {
            let set = self.frame.set_overlay(self.edits.overlay);
            if self.refused(set)? {
                self.edits.overlay = self.applied.overlay;
            }
        }
        self.applied = self.edits.clone();
        Ok(())
    }

    /// Whether an edit was refused, which is said; other errors are errors.
    fn refused(&mut self, set: Result<()>) -> Result<bool> {
        match set {
            Ok(()) => Ok(false),
            Err(
                error @ (ClientError::Argument { .. }
                | ClientError::Object { .. }
                | ClientError::AdapterFull { .. }),
            ) => {
                let cause = error.source().map(|cause| format!(": {cause}")).unwrap_or_default();
                self.notice = Some(format!("{error}{cause}"));
                Ok(true)
            }
            Err(error) => Err(error),
        }
    }

    /// Draws a sample more, and adds it.
    fn sample(&mut self) -> Result<()> {
        let jitter = jitters(self.view.samples).get(self.samples as usize).copied().unwrap_or_default();
        self.frame.draw(jitter)?;
        self.is_metered &= self.samples > 0;
        // Where the adapter is behind, a later sample of the picture is as good.
        if !self.is_metered && self.meter.ask(&self.gpu, self.metered[0] + 1) {
            self.is_metered = true;
            self.metered[0] += 1;
        }
        let curve = match self.edits.overlay {
            None => (self.factor(), self.edits.tone),
            // Colours as they are.
            Some(_) => (1.0, Tone::Linear),
        };
        self.show.add(&self.gpu, &self.sum, self.samples == 0, curve);
        self.samples += 1;
        Ok(())
    }

    fn factor(&self) -> f32 {
        match self.edits.exposure {
            Exposure::Fixed(factor) => factor,
            Exposure::Auto { .. } => self.exposure,
        }
    }

    /// Follows the light meter.
    fn hear_meter(&mut self) -> Result<()> {
        for (mark, radiance) in self.meter.answers(&self.gpu)? {
            self.metered[1] = self.metered[1].max(mark);
            if self.edits.overlay.is_some() {
                continue;
            }
            let factor = self.edits.exposure.factor(&radiance);
            if (factor / self.exposure - 1.0).abs() > EXPOSURE_STEP {
                self.exposure = factor;
                self.samples = 0;
            }
        }
        Ok(())
    }

    /// Pictures of another size from here on; none of them has a side of 0.
    pub fn resize(&mut self, size: [u32; 2]) -> Result<()> {
        if size == self.size || size.contains(&0) {
            return Ok(());
        }
        self.frame.resize(size)?;
        self.sum = self.show.sum(&self.gpu, self.frame.radiance(), size)?;
        self.meter = MeterPass::new(&self.gpu, self.frame.radiance(), size)?;
        self.metered[1] = self.metered[0];
        (self.size, self.samples) = (size, 0);
        Ok(())
    }

    /// Takes measured errors, and shows those under the first light.
    pub fn show_errors(&mut self, errors: MeasuredErrors) -> Result<()> {
        self.error_lights = errors.lights().map(str::to_owned).collect();
        self.frame.set_errors(errors)?;
        self.edits.overlay = Some(Overlay::Errors { light: 0 });
        Ok(())
    }

    /// Takes a bake whose scene is the same and whose light is better. Errs, and keeps the one before, where the adapter has no room.
    pub fn set_bake(&mut self, bake: Arc<LoadedBake>) -> Result<()> {
        if Arc::ptr_eq(&bake, &self.bake) {
            return Ok(());
        }
        self.samples = 0;
        self.frame.set_bake(Arc::clone(&bake))?;
        self.bake = bake;
        Ok(())
    }

    /// Records the picture for the screen.
    pub fn present(&self, encoder: &mut wgpu::CommandEncoder, screen: &wgpu::TextureView) {
        self.show.present(encoder, &self.sum, screen);
    }

    /// The picture as sRGB bytes, row after row, after a wait.
    pub fn picture(&self) -> Result<Vec<[u8; 4]>> {
        self.show.keep(&self.gpu, &self.sum)
    }

    /// The command that draws the same picture, and notes on what its words cannot say.
    pub fn command(&self, bake_words: &str) -> (String, Vec<String>) {
        self.edits.command(bake_words, self.camera(), self.size)
    }
}

fn diagonal_of(bake: &LoadedBake) -> f32 {
    bake.scene.diagonal_m().max(f32::MIN_POSITIVE)
}
