//! Task `scene.unwrap`: the texel size, and the charts of each mesh instance.

use std::collections::BTreeMap;
use std::sync::Arc;

use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::settings::TexelSettings;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::geometry::lattice::snapped_size_m;
use crate::geometry::{TriangleRef, corners_of};
use crate::scene::core::Core;
use crate::scene::model::{MeshInstance, Scene};
use crate::task::{Cancelled, Context, Progress, TaskError, TaskOutput, artefact, params};
use crate::unwrap::{Unwrap, UnwrapError, UnwrapSettings, unwrap_from_second_uv, unwrap_generated};

/// Magic of the charts' artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKch";
/// Name under which tasks see it.
pub const ARTEFACT: &str = "unwrap/unwrap";

/// Receivers per triangle beyond the fifth of the target that every scene gets.
const RECEIVERS_PER_TRIANGLE: f64 = 20.0;

/// Least and greatest size of a texel that is chosen, in metres: whatever unit a scene is in.
const TEXEL_M: [f64; 2] = [1e-9, 1e9];

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
    let areas = LitAreas::of(scene);
    let most = f64::from(settings.receivers_target);
    let receivers = most.min(most * 0.2 + RECEIVERS_PER_TRIANGLE * areas.triangles as f64);
    let texel_m = (areas.in_texels_of_core(scene.core) / receivers).sqrt();
    snapped_size_m(texel_m.clamp(TEXEL_M[0], TEXEL_M[1])) as f32
}

/// Lit area of the shells of a scene.
struct LitAreas {
    /// Area of all surfaces of each shell, double-sided ones twice, in m².
    of_shell_m2: Vec<f64>,
    /// Triangles of the core.
    triangles: usize,
}

impl LitAreas {
    fn of(scene: &Scene) -> Self {
        let shells = scene.core.map_or(1, |core| core.shells as usize + 1);
        let mut areas = Self { of_shell_m2: vec![0.0; shells], triangles: 0 };
        for (index, instance) in scene.instances.iter().enumerate() {
            let sides =
                if scene.materials[instance.material_index as usize].double_sided { 1.0 } else { 0.5 };
            for triangle in 0..instance.triangles.len() {
                let corners =
                    corners_of(scene, TriangleRef { instance: index as u32, triangle: triangle as u32 });
                let [a, b, c] = corners;
                let shell = scene.core.map_or(0, |core| core.shell_of_triangle(corners));
                areas.of_shell_m2[shell as usize] += sides * f64::from((b - a).cross(c - a).length());
                areas.triangles += usize::from(shell == 0);
            }
        }
        areas
    }

    /// The area that would have as many texels as the core's as all shells have of theirs. What bounds the texels of far shells
    /// is left out: it adds some 200 texels a shell, and if it counted, a core of few texels would give way to them.
    fn in_texels_of_core(&self, core: Option<Core>) -> f64 {
        let of_shell = |(area_m2, shell): (&f64, u32)| {
            area_m2 / 4.0_f64.powi(core.map_or(0, |core| core.falls_off(shell)) as i32)
        };
        self.of_shell_m2.iter().zip(0..).map(of_shell).sum()
    }
}

/// Unwraps every instance: by its second UV set when that is a valid unwrap, else a generated one.
fn unwrap_instances(
    scene: &Scene,
    settings: &TexelSettings,
    texel_m: f32,
    progress: &Progress,
) -> Result<Vec<Unwrap>, TaskError> {
    let unwrap = |instance: &MeshInstance| {
        progress.check()?;
        let unwrap = unwrap_instance(scene, instance, settings, texel_m, progress).map_err(|error| {
            if progress.is_cancelled() {
                return TaskError::from(Cancelled);
            }
            let said = format!("the lightmap of '{}' cannot be laid out", instance.path);
            TaskError::bad_input_from(said, error)
        })?;
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

/// The unwrap of an instance: one for each size of texels that its triangles have, by the shells that they lie in.
fn unwrap_instance(
    scene: &Scene,
    instance: &MeshInstance,
    settings: &TexelSettings,
    texel_m: f32,
    progress: &Progress,
) -> Result<Unwrap, UnwrapError> {
    let (positions, triangles) = (&instance.positions_m, &instance.triangles);
    let sizes = by_coarseness(scene.core, instance, texel_m);
    let settings_of = |coarseness: u32| UnwrapSettings {
        gutter_texels: settings.gutter_texels(),
        lod_align_texels: 1 << (settings.lod_levels - 1),
        ..UnwrapSettings::with_texel_m(texel_m * 2.0_f32.powi(coarseness as i32))
    };
    if let [(coarseness, _)] = sizes.as_slice() {
        let settings = settings_of(*coarseness);
        let adopted = (!instance.uv1.is_empty())
            .then(|| unwrap_from_second_uv(positions, &instance.uv1, triangles, &settings))
            .and_then(Result::ok);
        return adopted.map_or_else(
            || unwrap_generated(positions, &instance.normals, triangles, &settings, progress),
            Ok,
        );
    }
    let mut all = Unwrap::default();
    for (coarseness, members) in sizes {
        let part: Vec<[u32; 3]> = members.iter().map(|&member| triangles[member as usize]).collect();
        let settings = settings_of(coarseness);
        let unwrap = unwrap_generated(positions, &instance.normals, &part, &settings, progress)?;
        all.add_part(unwrap, &members);
    }
    Ok(all)
}

/// Triangles of an instance by how coarse their texels are, finest first; all of them at once in a scene of one scale.
fn by_coarseness(core: Option<Core>, instance: &MeshInstance, texel_m: f32) -> Vec<(u32, Vec<u32>)> {
    let all = 0..instance.triangles.len() as u32;
    let Some(core) = core else { return vec![(0, all.collect())] };
    let mut sizes: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for triangle in all {
        let corners =
            instance.triangles[triangle as usize].map(|vertex| instance.positions_m[vertex as usize]);
        let coarseness = core.coarseness(core.shell_of_triangle(corners), texel_m);
        sizes.entry(coarseness).or_default().push(triangle);
    }
    sizes.into_iter().collect()
}
