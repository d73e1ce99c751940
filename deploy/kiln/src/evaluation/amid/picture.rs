//! Pictures of an object amid a bake, beside those by paths.

use glam::{DVec3, Vec3};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::picture::{Tone, developed};
use lightkiln_client::preview::{Backend, SurfaceDetails, View, render};
use lightkiln_proto::scene::SceneCamera;
use lightkiln_worker::evaluate::TestLight;
use lightkiln_worker::reference::{PictureSize, Reference, luminance};
use lightkiln_worker::task::Progress;

use super::{Amid, Posed, failure};
use crate::evaluation::heat::{Bitmap, colour};
use crate::failure::Result;

/// Paths along a pixel's side: their square go through it.
const PATHS_A_SIDE: u32 = 14;
/// Brightness of a picture's mean before the tone curve.
const MEAN_SHOWN: f32 = 0.35;
/// Distance of a camera from an object's middle in radii, at most, and ways around in which it is sought.
const AWAY_RADII: f32 = 4.5;
const WAYS: u32 = 24;
/// Slope at which it looks down.
const SLOPE: f32 = 0.45;
/// Its vertical field of view in degrees.
const FOV_DEG: f32 = 50.0;
/// Share of the free way at which it stands.
const BEFORE_WALL: f32 = 0.9;

/// Five pictures beside each other: with the object, where indirect light ignores it, by paths; and the first two less the third.
pub type Strip = Bitmap;

/// A camera that sees an object from as far as there is room.
pub fn camera_towards(posed: &Posed<'_>) -> SceneCamera {
    let (middle_m, radius_m) = (posed.middle_m, posed.radius_m);
    let alone = &posed.amid.alone;
    let bounds_m = alone.near_bounds_m();
    let free = |way: Vec3| {
        // From outside, backs of walls would be seen.
        let inside_m =
            if is_within(middle_m, bounds_m) { way_out_m(middle_m, way, bounds_m) } else { f32::INFINITY };
        let away_m = (AWAY_RADII * radius_m).min(BEFORE_WALL * inside_m);
        alone.tracer.closest(middle_m, way, away_m).map_or(away_m, |hit| BEFORE_WALL * hit.t)
    };
    let ways = (0..WAYS).map(|way| {
        let turn = std::f32::consts::TAU * way as f32 / WAYS as f32;
        Vec3::new(turn.cos(), SLOPE, turn.sin()).normalize()
    });
    let farthest =
        ways.map(|way| (free(way), way)).reduce(|far, next| if next.0 > far.0 { next } else { far });
    let (away_m, way) = farthest.unwrap_or((AWAY_RADII * radius_m, Vec3::Z));
    SceneCamera {
        name: "chosen".to_owned(),
        eye_m: (middle_m + way * away_m).into(),
        target_m: middle_m.into(),
        up: Vec3::Y.into(),
        fov_y_rad: FOV_DEG.to_radians(),
        orthographic_half_height_m: None,
    }
}

fn is_within(at_m: Vec3, [low, high]: [Vec3; 2]) -> bool {
    at_m.cmpge(low).all() && at_m.cmple(high).all()
}

/// Way from a place within bounds to where they end.
fn way_out_m(at_m: Vec3, way: Vec3, [low, high]: [Vec3; 2]) -> f32 {
    let ends_m = [low, high].map(|corner| (corner - at_m) / way);
    let of_axis = ends_m[0].max(ends_m[1]).to_array();
    of_axis.into_iter().filter(|end_m| end_m.is_finite()).fold(f32::INFINITY, f32::min)
}

impl Posed<'_> {
    /// Draws pictures under a light, blue where too dark, red where too bright.
    pub fn strip(
        &self,
        light: &TestLight,
        camera: &SceneCamera,
        (width, height): (u32, u32),
        progress: &Progress,
    ) -> Result<Strip> {
        let Amid { with_object, ignored, .. } = self.amid;
        let size = PictureSize { width, height, grid: PATHS_A_SIDE };
        let reference = Reference::new(&self.together, &light.lighting).map_err(|error| failure(&error))?;
        let traced = reference.picture(camera, &size, progress).map_err(|error| failure(&error))?.radiance;
        let drawn =
            [self.drawn(with_object, light, camera, &size)?, self.drawn(ignored, light, camera, &size)?];
        let value = |rgb: &[f32; 3]| luminance(DVec3::from(rgb.map(f64::from)));
        let mean = traced.iter().map(value).sum::<f64>() / traced.len().max(1) as f64;
        let mean = mean.max(f64::MIN_POSITIVE);
        let heat = |picture: &Vec<[f32; 3]>| -> Vec<[u8; 4]> {
            let off = picture.iter().zip(&traced).map(|(own, truth)| (value(own) - value(truth)) / mean);
            off.map(colour).collect()
        };
        let exposure = MEAN_SHOWN / mean as f32;
        let heats = [heat(&drawn[0]), heat(&drawn[1])];
        let shown = drawn.iter().chain([&traced]);
        let panels = shown.map(|picture| developed(picture, exposure, Tone::default())).chain(heats);
        Ok(beside(&panels.collect::<Vec<_>>(), &size))
    }

    fn drawn(
        &self,
        bake: &LoadedBake,
        light: &TestLight,
        camera: &SceneCamera,
        size: &PictureSize,
    ) -> Result<Vec<[f32; 3]>> {
        let view = View {
            width: size.width,
            height: size.height,
            panorama: light.lighting.panorama.clone(),
            emitter_scale: vec![light.lighting.emitter_scale; bake.scene.manifest.emitters.len()],
            objects: vec![self.stance],
            details: SurfaceDetails { normal_maps: false, specular: false },
            ..View::new(camera.clone(), light.lighting.lights.clone())
        };
        Ok(render(bake, &view, Backend::Cpu)?.linear)
    }
}

/// Pictures of one size beside each other.
fn beside(panels: &[Vec<[u8; 4]>], size: &PictureSize) -> Bitmap {
    let width = size.width as usize;
    let row = |y: usize| panels.iter().flat_map(move |panel| &panel[y * width..(y + 1) * width]).copied();
    let pixels = (0..size.height as usize).flat_map(row).collect();
    Bitmap { width: size.width * panels.len() as u32, height: size.height, pixels }
}
