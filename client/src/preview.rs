//! One picture of a bake: lights in, converged bounces, picture out.

mod components;
mod cpu;
mod debug;
mod edges;
mod gpu;
mod path;
mod probes;
mod provisional;
mod receivers;
mod within;

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use lightkiln_proto::relight::{Limit, Lod, LodPlan};
use lightkiln_proto::scene::{SceneCamera, SceneLight};

use crate::bake::{LitScene, LoadedBake, Unshadowed};
use crate::error::{ClientError, Result};
use crate::frame::{check_lod, eye_of, lod_eye, lod_table};
use crate::lights::{Caster, Panorama, Sky, camera_of, check_lights, check_scale, lights_of};
use crate::passes::gpu::Gpu;
use crate::passes::shadow::reference::ShadowMaps;
use crate::passes::shadow::{self, Eye, ShadowPlan, ShadowRoom};
use crate::picture::{Exposure, Picture, Tone};
use crate::raster::camera_clip_from_world;
use crate::scene::{LoadedScene, Stance, bounds_of, check_stances};

pub use crate::passes::fog::Fog;
pub use crate::passes::shade::SurfaceDetails;
pub use crate::passes::walk::Walks;
pub use debug::debug_picture;
pub use edges::probe_edges;
#[cfg(test)]
pub(crate) use gpu::frame_of;
pub use path::{FILE_MAX as PATH_FILE_MAX, ViewPath};
pub use probes::{ProbeColours, probe_spheres};
pub use provisional::provisional_share;
pub use receivers::{LitReceivers, light_receivers, light_receivers_among};
pub use within::StreamedBake;

#[cfg(test)]
mod tests;

/// Longest side of a picture in pixels.
pub const MAX_SIDE: u32 = 16_384;
/// Texels along a side of a shadow map unless a view says otherwise.
pub const SHADOW_SIDE: u32 = 2048;
/// Most samples per pixel.
pub const MAX_SAMPLES: u32 = 64;

/// Adapter or processor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// The graphics adapter if there is one that can and is no software, else the processor, which is faster than such.
    #[default]
    Auto,
    /// The graphics adapter or nothing.
    Gpu,
    /// The processor: the passes' references.
    Cpu,
}

/// A picture to draw: camera, size, lights, quality.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Camera.
    pub camera: SceneCamera,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Lights and skies.
    pub lights: Vec<SceneLight>,
    /// A panorama as a sky, on top of the others.
    pub panorama: Option<Arc<Panorama>>,
    /// One factor per emitter of the manifest; 1 where absent.
    pub emitter_scale: Vec<f32>,
    /// Stances of the scene's objects, in their order; those without one are at rest.
    pub objects: Vec<Stance>,
    /// A medium between surfaces.
    pub fog: Option<Fog>,
    /// Details of surfaces that transport does not know.
    pub details: SurfaceDetails,
    /// Tone mapping.
    pub tone: Tone,
    /// Exposure.
    pub exposure: Exposure,
    /// Samples per pixel. More → smoother edges, more time.
    pub samples: u32,
    /// Texels along a side of a shadow map, a power of two; many lights get fewer. More → sharper shadows, more memory.
    pub shadow_side: u32,
    /// End of the bounces before the picture is drawn.
    pub limit: Limit,
    /// Levels of detail; all of it without.
    pub lod: Option<Lod>,
    /// Parts that are made by walks through voxels, of a bake that has some.
    pub walks: Walks,
    /// Most bytes of the adapter's memory that drawing takes; as many as there are without.
    pub adapter_bytes_max: Option<u64>,
}

impl View {
    /// A view of a bake. Without `camera` it is that of the bake; without `lights` they are the bake's; notes say which were
    /// chosen because the file has none.
    pub fn of_bake(
        bake: &LoadedBake,
        camera: Option<SceneCamera>,
        lights: Option<Vec<SceneLight>>,
    ) -> Result<(Self, Vec<String>)> {
        let manifest = &bake.scene.manifest;
        let mut notes = bake.scene.warnings.clone();
        let camera = match camera {
            Some(camera) => camera,
            None => {
                let (camera, note) = camera_of(manifest)?;
                notes.extend(note);
                camera
            }
        };
        let lights = lights.unwrap_or_else(|| {
            let (lights, note) = lights_of(manifest);
            notes.extend(note);
            lights
        });
        let emitter_scale = vec![1.0; manifest.emitters.len()];
        Ok((Self { emitter_scale, ..Self::new(camera, lights) }, notes))
    }

    /// A view with everything else at its default.
    pub fn new(camera: SceneCamera, lights: Vec<SceneLight>) -> Self {
        Self {
            camera,
            width: 1280,
            height: 720,
            lights,
            panorama: None,
            emitter_scale: Vec::new(),
            objects: Vec::new(),
            fog: None,
            details: SurfaceDetails::default(),
            tone: Tone::default(),
            exposure: Exposure::default(),
            samples: 4,
            shadow_side: SHADOW_SIDE,
            limit: Limit::default(),
            lod: None,
            walks: Walks::default(),
            adapter_bytes_max: None,
        }
    }

    /// Width and height.
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    fn eye(&self) -> Option<Eye> {
        eye_of(&self.camera)
    }

    /// Shadow maps of the lights in a scene of those bounds.
    fn plan(&self, bounds_m: [[f32; 3]; 2]) -> Result<ShadowPlan> {
        ShadowPlan::new(&Caster::of(&self.lights), bounds_m, self.shadow_side, self.eye())
    }

    fn check(&self, scene: &LoadedScene) -> Result<()> {
        let wrong =
            |what: String, problem: &str| Err(ClientError::Argument { what, problem: problem.to_owned() });
        if self.size().iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return wrong(format!("size {}x{}", self.width, self.height), "sides are 1..=16384 pixels");
        }
        if !(1..=MAX_SAMPLES).contains(&self.samples) || self.limit.bounces_max == 0 {
            let what = format!("{} samples, {} bounces", self.samples, self.limit.bounces_max);
            return wrong(what, "samples are 1..=64, bounces at least 1");
        }
        if !self.shadow_side.is_power_of_two()
            || !(shadow::MIN_SIDE..=shadow::MAX_SIDE).contains(&self.shadow_side)
        {
            return wrong(
                format!("shadow side {}", self.shadow_side),
                "is a power of two in 64..=4096 texels",
            );
        }
        self.lod.as_ref().map_or(Ok(()), check_lod)?;
        self.fog.as_ref().map_or(Ok(()), Fog::check)?;
        if let Some(problem) = self.walks.problem() {
            return wrong("walks".to_owned(), problem);
        }
        check_scale(&self.emitter_scale)?;
        check_stances(scene, &self.objects)?;
        camera_clip_from_world(&self.camera, self.size(), scene.manifest.bounds_m)?;
        check_lights(&self.lights)
    }
}

/// A view of a bake with its lights planned, for either backend.
pub(crate) struct Prepared<'a> {
    pub bake: &'a LoadedBake,
    /// The bake's, with its objects where they stand.
    pub scene: Cow<'a, LoadedScene>,
    /// Of the scene with its objects, in metres.
    pub bounds_m: [[f32; 3]; 2],
    pub view: &'a View,
    pub plan: ShadowPlan,
    pub sky: Sky,
    pub lod: Option<LodPlan>,
}

impl<'a> Prepared<'a> {
    pub fn new(bake: &'a LoadedBake, view: &'a View) -> Result<Self> {
        view.check(&bake.scene)?;
        let posed = bake.scene.posed(&view.objects)?;
        let bounds_m = bake.scene.bounds_with([bounds_of(&posed)]);
        let scene = if posed.is_empty() {
            Cow::Borrowed(&*bake.scene)
        } else {
            Cow::Owned(bake.scene.with_posed(posed))
        };
        let plan = view.plan(bounds_m)?;
        let lod = match view.lod {
            None => None,
            Some(lod) => {
                lod_table(bake)?;
                let eye = lod_eye(bake, &view.camera, view.size());
                eye.and_then(|eye| bake.light.plan_lod(&lod, eye, None))
            }
        };
        Ok(Self { bake, scene, bounds_m, view, plan, sky: Sky::of(&view.lights), lod })
    }

    /// The scene under its lights, for the processor.
    pub fn lit(&'a self, maps: &'a ShadowMaps) -> LitScene<'a> {
        let lod = self.lod.as_ref();
        LitScene { scene: &self.scene, plan: &self.plan, maps, unshadowed: self.unshadowed(), lod }
    }

    pub fn unshadowed(&self) -> Unshadowed<'_> {
        let panorama = self.view.panorama.as_deref();
        Unshadowed { sky: self.sky, panorama, emitter_scale: &self.view.emitter_scale }
    }
}

/// Draws a picture.
pub fn render(bake: &LoadedBake, view: &View, backend: Backend) -> Result<Picture> {
    let mut drawn = None;
    let take = |_, picture| {
        drawn = Some(picture);
        Ok(())
    };
    draw(bake, (1, &|_| view.clone()), backend, &mut Reel::new(take))?;
    drawn.ok_or_else(|| ClientError::Adapter { problem: "nothing was drawn".to_owned() })
}

/// Draws pictures along a path, each given to `take` with its index; what keys leave out is that of `base`. On the adapter what changes
/// between them makes no buffer, and bounces go on from the picture before. The exposure of the first that is not black is that of
/// all. Errs before the first if any cannot be drawn.
pub fn render_path(
    bake: &LoadedBake,
    path: &ViewPath,
    base: &View,
    backend: Backend,
    take: impl FnMut(usize, Picture) -> Result<()>,
) -> Result<()> {
    let view = |index: usize| path.view(index as u32 + 1, base);
    draw(bake, (path.pictures() as usize, &view), backend, &mut Reel::new(take)).map_err(
        |error| match error {
            ClientError::Argument { what, problem } => {
                ClientError::Argument { what: format!("along the path, {what}"), problem }
            }
            error => error,
        },
    )
}

/// Views by index, all of one size, made when they are wanted.
type Views<'a> = (usize, &'a dyn Fn(usize) -> View);

fn draw(bake: &LoadedBake, views: Views<'_>, backend: Backend, reel: &mut Reel<'_>) -> Result<()> {
    let room = room_of(bake, views)?;
    let bytes_max = (views.1)(0).adapter_bytes_max;
    let reason = match backend {
        Backend::Cpu => "as asked".to_owned(),
        Backend::Gpu => return gpu::render(&Gpu::open_within(bytes_max)?, bake, (views, room), reel),
        Backend::Auto => match Gpu::open_within(bytes_max) {
            Ok(gpu) if gpu.software => format!("{} is software", gpu.name),
            Ok(gpu) => match gpu::render(&gpu, bake, (views, room), reel) {
                Err(ClientError::Adapter { problem } | ClientError::AdapterFull { problem }) => problem,
                drawn => return drawn,
            },
            Err(ClientError::Adapter { problem }) => problem,
            Err(error) => return Err(error),
        },
    };
    let drawn_by = format!("the processor, slower than a graphics adapter ({reason})");
    for index in reel.done..views.0 {
        let view = views.1(index);
        let prepared = Prepared::new(bake, &view)?;
        let picture = cpu::render(&prepared, reel.exposure_of(&view))?;
        reel.push(Picture { drawn_by: drawn_by.clone(), ..picture })?;
    }
    Ok(())
}

/// Room for the shadow maps of every view. Errs where one of them cannot be drawn, and says which.
fn room_of(bake: &LoadedBake, (count, view): Views<'_>) -> Result<ShadowRoom> {
    let mut all: Option<ShadowRoom> = None;
    for index in 0..count {
        let view = view(index);
        let planned = view.check(&bake.scene).and_then(|()| view.plan(bake.scene.manifest.bounds_m));
        let own = planned.map_err(|error| match error {
            ClientError::Argument { what, problem } if count > 1 => {
                ClientError::Argument { what: format!("picture {}: {what}", index + 1), problem }
            }
            error => error,
        })?;
        let own = own.room();
        all = Some(all.map_or(own, |all| all.and(own)));
    }
    all.ok_or_else(|| ClientError::Argument {
        what: "a path".to_owned(),
        problem: "has no pictures".to_owned(),
    })
}

/// Pictures that are drawn one after the other.
struct Reel<'a> {
    take: Box<dyn FnMut(usize, Picture) -> Result<()> + 'a>,
    /// That of the first picture that is not black.
    exposure: Option<Exposure>,
    done: usize,
}

impl<'a> Reel<'a> {
    fn new(take: impl FnMut(usize, Picture) -> Result<()> + 'a) -> Self {
        Self { take: Box::new(take), exposure: None, done: 0 }
    }

    fn exposure_of(&self, view: &View) -> Exposure {
        self.exposure.unwrap_or(view.exposure)
    }

    fn push(&mut self, picture: Picture) -> Result<()> {
        let is_black = || picture.linear.iter().all(|radiance| *radiance == [0.0; 3]);
        if self.exposure.is_none() && !is_black() {
            self.exposure = Some(Exposure::Fixed(picture.exposure));
        }
        self.done += 1;
        (self.take)(self.done - 1, picture)
    }
}

/// Draws a picture and writes it as PNG.
pub fn render_png(bake: &LoadedBake, view: &View, backend: Backend, path: &Path) -> Result<Picture> {
    let picture = render(bake, view, backend)?;
    picture.write_png(path)?;
    Ok(picture)
}

/// Offsets of samples in the pixel: a rotated grid for 4, else the R2 sequence [Roberts2018].
pub(crate) fn jitters(samples: u32) -> Vec<[f32; 2]> {
    match samples {
        1 => vec![[0.0, 0.0]],
        4 => vec![[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]],
        _ => (0..samples)
            .map(|index| {
                let at = |step: f64| (0.5 + step * f64::from(index + 1)).fract() as f32 - 0.5;
                [at(0.754_877_666_246_692_8), at(0.569_840_290_998_053_3)]
            })
            .collect(),
    }
}
