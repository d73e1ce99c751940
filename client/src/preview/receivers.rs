//! Light at receivers without a picture: bounces until they settle, on either backend.

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::scene::{SceneCamera, SceneLight};

use super::{Backend, Prepared, View};
use crate::bake::{LoadedBake, ReceiverLight, SettledReceivers};
use crate::error::{ClientError, Result};
use crate::frame::{Frame, FrameRoom};
use crate::lights::Panorama;
use crate::movers::Standings;
use crate::passes::gpu::Gpu;
use crate::passes::shadow::reference::draw;
use crate::scene::Stance;

/// Light at receivers, and who settled it.
#[derive(Clone, Debug, PartialEq)]
pub struct LitReceivers {
    /// The light.
    pub settled: SettledReceivers,
    /// Light at receivers of objects with bakes of their own, in their order.
    pub objects: Vec<ReceiverLight>,
    /// Adapter or processor, with the reason.
    pub lit_by: String,
}

/// Lights a bake's receivers as [`light_receivers_among`] does, all objects at rest.
pub fn light_receivers(
    bake: &LoadedBake,
    lights: Vec<SceneLight>,
    panorama: Option<Arc<Panorama>>,
    emitter_scale: Vec<f32>,
    backend: Backend,
) -> Result<LitReceivers> {
    light_receivers_among(bake, lights, panorama, emitter_scale, &[], backend)
}

/// Lights a bake's receivers by `lights`, a panorama and its emitters, one factor each, 1 where absent, with objects where stances
/// have them. Errs for a kind without receivers.
pub fn light_receivers_among(
    bake: &LoadedBake,
    lights: Vec<SceneLight>,
    panorama: Option<Arc<Panorama>>,
    emitter_scale: Vec<f32>,
    objects: &[Stance],
    backend: Backend,
) -> Result<LitReceivers> {
    let objects = objects.to_vec();
    let view = View {
        panorama,
        emitter_scale,
        objects,
        width: 16,
        height: 16,
        ..View::new(camera_over(bake), lights)
    };
    let prepared = Prepared::new(bake, &view)?;
    let reason = match backend {
        Backend::Cpu => "as asked".to_owned(),
        Backend::Gpu => return on_adapter(&Gpu::open()?, &prepared),
        Backend::Auto => match Gpu::open() {
            Ok(gpu) if gpu.software => format!("{} is software", gpu.name),
            Ok(gpu) => match on_adapter(&gpu, &prepared) {
                Err(ClientError::Adapter { problem } | ClientError::AdapterFull { problem }) => problem,
                lit => return lit,
            },
            Err(ClientError::Adapter { problem }) => problem,
            Err(error) => return Err(error),
        },
    };
    let maps = draw(&prepared.scene, &prepared.plan);
    let standings = Standings::new(bake, &view.objects, &view.emitter_scale)?;
    let found = standings.at_receivers(&prepared.lit(&maps), view.limit);
    let (settled, objects) = found.ok_or_else(|| without_receivers(bake))?;
    let lit_by = format!("the processor, slower than a graphics adapter ({reason})");
    Ok(LitReceivers { settled, objects, lit_by })
}

fn on_adapter(gpu: &Gpu, prepared: &Prepared<'_>) -> Result<LitReceivers> {
    let Prepared { bake, view, plan, .. } = prepared;
    let room = FrameRoom { size: view.size(), shadows: plan.room() };
    let mut frame = Frame::new(gpu, *bake, room, view.camera.clone())?;
    frame.set_lights(&view.lights)?;
    frame.set_sky(view.panorama.as_ref())?;
    frame.set_emitters(&view.emitter_scale)?;
    frame.set_objects(&view.objects)?;
    let (bounces, converged) = frame.settle(view.limit)?;
    let light = frame.read_receivers()?.ok_or_else(|| without_receivers(bake))?;
    let settled = SettledReceivers { light, bounces, converged };
    Ok(LitReceivers { settled, objects: frame.read_objects()?, lit_by: gpu.name.clone() })
}

fn without_receivers(bake: &LoadedBake) -> ClientError {
    let text = format!("kind {}", bake.scene.manifest.kind);
    let problem =
        "has no receivers in a lightmap; bake the scene with a kind that has; 'kiln settings' lists kinds"
            .to_owned();
    ClientError::Source { text, problem }
}

/// A parallel camera that sees all: light at receivers does not hang on it, and suns have no cascades for it.
fn camera_over(bake: &LoadedBake) -> SceneCamera {
    let [low, high] = bake.scene.manifest.bounds_m.map(Vec3::from);
    let middle = 0.5 * (low + high);
    let reach = (high - low).length().max(1e-3 * middle.length()).max(1.0);
    SceneCamera {
        name: String::new(),
        eye_m: (middle + Vec3::Z * reach).into(),
        target_m: middle.into(),
        up: [0.0, 1.0, 0.0],
        fov_y_rad: 1.0,
        orthographic_half_height_m: Some(reach),
    }
}
