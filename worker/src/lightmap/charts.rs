//! Task `scene.unwrap`: the texel size, and the charts of each mesh instance.

use std::sync::Arc;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::settings::TexelSettings;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::lattice::snapped_size_m;
use crate::geometry::{TriangleRef, corners_of};
use crate::scene::model::{MeshInstance, Scene};
use crate::task::{Context, Progress, TaskError, TaskOutput, artefact, params};
use crate::unwrap::{Unwrap, UnwrapSettings, unwrap_from_second_uv, unwrap_generated};

/// Magic of the charts' artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKch";
/// Name under which tasks see it.
pub const ARTEFACT: &str = "unwrap/unwrap";

/// Receivers per triangle beyond the fifth of the target that every scene gets.
const RECEIVERS_PER_TRIANGLE: f64 = 20.0;

/// Most texels of all blocks of one side together.
const TEXELS_MAX: u64 = 256 << 20;

/// Charts of a scene: the artefact of `scene.unwrap`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Charts {
    /// Texel size in metres.
    pub texel_m: f32,
    /// Unwrap of each mesh instance.
    pub unwraps: Vec<Unwrap>,
}

impl Charts {
    /// The charts among a task's inputs.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(ARTEFACT_MAGIC, ARTEFACT)
    }

    /// The charts, if a task has them among its inputs: a bake may have no lightmap.
    pub fn if_any(context: &Context) -> Result<Option<Arc<Self>>, TaskError> {
        context.has(ARTEFACT).then(|| Self::of(context)).transpose()
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    texels: TexelSettings,
}

/// Runs the task: input `import/scene`; output `unwrap`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let Params { texels: settings } = params(task)?;
    let (scene, _): (Scene, _) = context.decoded(crate::scene::ARTEFACT_MAGIC, crate::scene::ARTEFACT)?;
    context.progress.begin(0.0, 1.0, scene.instances.len() as u64);
    let texel_m = texel_size_m(&scene, &settings);
    let unwraps = unwrap_instances(&scene, &settings, texel_m, context.progress)?;
    let charts = artefact::encode(ARTEFACT_MAGIC, &Charts { texel_m, unwraps })?;
    Ok(TaskOutput { artefacts: vec![("unwrap".into(), charts)], ..TaskOutput::default() })
}

/// Texel size in metres: as set, or such that the scene's lit area holds about `receivers_target` texels, fewer for
/// scenes of few triangles: a box needs no texels finer than its light.
fn texel_size_m(scene: &Scene, settings: &TexelSettings) -> f32 {
    if settings.texel_m > 0.0 {
        return settings.texel_m;
    }
    let triangles: usize = scene.instances.iter().map(|instance| instance.triangles.len()).sum();
    let most = f64::from(settings.receivers_target);
    let receivers = most.min(most * 0.2 + RECEIVERS_PER_TRIANGLE * triangles as f64);
    let texel_m = (lit_area_m2(scene) / receivers).sqrt().clamp(1e-4, 100.0);
    snapped_size_m(texel_m) as f32
}

/// Area of all surfaces, double-sided ones twice, in m².
fn lit_area_m2(scene: &Scene) -> f64 {
    let mut area_m2 = 0.0;
    for (index, instance) in scene.instances.iter().enumerate() {
        let sides = if scene.materials[instance.material_index as usize].double_sided { 1.0 } else { 0.5 };
        for triangle in 0..instance.triangles.len() {
            let [a, b, c] =
                corners_of(scene, TriangleRef { instance: index as u32, triangle: triangle as u32 });
            area_m2 += sides * f64::from((b - a).cross(c - a).length());
        }
    }
    area_m2
}

/// Unwraps every instance: by its second UV set when that is a valid unwrap, else a generated one.
fn unwrap_instances(
    scene: &Scene,
    settings: &TexelSettings,
    texel_m: f32,
    progress: &Progress,
) -> Result<Vec<Unwrap>, TaskError> {
    let unwrap_settings = UnwrapSettings {
        gutter_texels: settings.gutter_texels(),
        lod_align_texels: 1 << (settings.lod_levels - 1),
        ..UnwrapSettings::with_texel_m(texel_m)
    };
    let unwrap = |instance: &MeshInstance| {
        progress.check()?;
        let (positions, triangles) = (&instance.positions_m, &instance.triangles);
        let adopted = (!instance.uv1.is_empty())
            .then(|| unwrap_from_second_uv(positions, &instance.uv1, triangles, &unwrap_settings))
            .and_then(Result::ok);
        let unwrap = match adopted {
            Some(unwrap) => unwrap,
            None => unwrap_generated(positions, &instance.normals, triangles, &unwrap_settings).map_err(
                |error| {
                    TaskError::bad_input_from(
                        format!("the lightmap of '{}' cannot be laid out", instance.path),
                        error,
                    )
                },
            )?,
        };
        progress.advance(1);
        Ok(unwrap)
    };
    let unwraps: Vec<Unwrap> = scene.instances.par_iter().map(unwrap).collect::<Result<_, TaskError>>()?;
    let texels: u64 = unwraps
        .iter()
        .flat_map(|unwrap| &unwrap.blocks)
        .map(|b| u64::from(b.width) * u64::from(b.height))
        .sum();
    if texels > TEXELS_MAX {
        return Err(TaskError::bad_input(format!(
            "the lightmap would have {texels} texels of {texel_m} m, more than {TEXELS_MAX}: raise texel_m"
        )));
    }
    Ok(unwraps)
}
