//! What a bake would be: its scene imported and laid out in a lightmap, no ray cast; costs by rates that were measured.

use std::collections::BTreeSet;

use lightkiln_proto::kinds::{Rates, SceneTask, Warning};
use lightkiln_proto::settings::SettingsError;
use lightkiln_worker::kinds::Runner;
use lightkiln_worker::lightmap::Charts;
use lightkiln_worker::scene;
use lightkiln_worker::scene::model::Scene;
use lightkiln_worker::task::{LocalRun, Progress, TaskError};
use lightkiln_worker::unwrap::Unwrap;
use serde::{Deserialize, Serialize};

use crate::failure::{Exit, Failure, Result};
use crate::kinds::KindTables;
use crate::settings::Wanted;

/// Bytes of decoded values kept between the two tasks.
const MEMORY_BYTES: usize = 2 << 30;
/// Clusters for each one that would be full: space cuts them where surfaces are, not by counts.
const CLUSTERS_PER_FULL_ONE: f64 = 1.5;
/// Receivers of a chart beside those of its area: on its rim, and of one that is smaller than a texel.
const CHART_RECEIVERS: f64 = 0.3;
/// Bytes of memory of a triangle with its vertices, charts and its part of the tree that rays are traced in.
const TRIANGLE_BYTES: f64 = 600.0;
/// Bytes of a bundle's meshes for each triangle.
const DRAWN_BYTES: f64 = 20.0;
/// Bytes of memory of a texture's pixel, its coarser levels included.
const PIXEL_BYTES: f64 = 9.4;
/// Bytes of memory of the program itself.
const PROGRAM_BYTES: f64 = 40e6;

/// What a bake would take and warn of: its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Kind of bake.
    pub kind: &'static str,
    /// Mesh primitives under nodes.
    pub instances: u64,
    /// Triangles with an area.
    pub triangles: u64,
    /// Materials.
    pub materials: u64,
    /// Textures that materials use.
    pub textures: u64,
    /// Their pixels.
    pub texture_pixels: u64,
    /// Their bytes, as they are in the file.
    pub texture_bytes: u64,
    /// Lights of the file.
    pub lights: u64,
    /// Cameras of the file.
    pub cameras: u64,
    /// Corners of the box around the scene, in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// The lightmap, for kinds that have one.
    pub lightmap: Option<LightmapForecast>,
    /// Costs, for kinds that have been measured.
    pub costs: Option<Costs>,
    /// What a bake would warn of.
    pub warnings: Vec<Warning>,
}

/// Size of a lightmap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LightmapForecast {
    /// Size of a texel in metres.
    pub texel_m: f32,
    /// Texels that lie on a surface, double-sided ones twice, and part of those on the rims of charts: about as many receivers.
    pub receivers: u64,
    /// Texels of all blocks, empty ones too.
    pub texels: u64,
}

/// Estimated costs of a whole bake.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Costs {
    /// Tasks.
    pub tasks: u64,
    /// Seconds of processor time, over all threads.
    pub cpu_secs: f64,
    /// Bytes of memory at the most.
    pub memory_bytes: u64,
    /// Bytes of the bundle.
    pub bundle_bytes: u64,
    /// Where the rates are from.
    pub measured: &'static str,
}

/// What `scene.import` says beside the scene.
#[derive(Deserialize)]
struct Notes {
    warnings: Vec<Warning>,
}

impl Forecast {
    /// Imports and unwraps a packed scene in this process.
    ///
    /// Errors as those tasks of a bake would.
    pub fn of(kinds: &KindTables, wanted: &Wanted, bundle: Vec<u8>) -> Result<Self> {
        let unusable = |error: SettingsError| Failure::of(Exit::BadInput, &error);
        let progress = Progress::default();
        let mut run = LocalRun::new(MEMORY_BYTES, &progress);
        let digest = run.shelf.put(bundle);
        let plan = wanted.kind.first_tasks(digest, &wanted.settings).map_err(unusable)?;
        let is_run =
            |kind: &str| [SceneTask::Import, SceneTask::Unwrap].iter().any(|task| task.name() == kind);
        run.run(&Runner::new(&kinds.worker), plan, is_run, |_| {}).map_err(|error| refused(&error))?;
        let inputs = run.scene_inputs(&["import/scene", "import/warnings", "unwrap/unwrap"]);
        let context = run.context(&inputs);
        let read = || -> std::result::Result<_, TaskError> {
            let (scene, _): (Scene, _) = context.decoded(scene::ARTEFACT_MAGIC, scene::ARTEFACT)?;
            Ok((scene, Charts::if_any(&context)?, context.bytes(scene::WARNINGS)?))
        };
        let (scene, charts, notes) = read().map_err(|error| refused(&error))?;
        let notes: Notes = serde_json::from_slice(&notes).map_err(|error| {
            Failure::new(Exit::Failed, "the import's warnings are not JSON").caused_by(&error)
        })?;
        let rates = wanted.kind.rates(&wanted.settings).map_err(unusable)?;
        Ok(Self::new(wanted.kind.name(), &scene, charts.as_deref(), rates, notes.warnings))
    }

    fn new(
        kind: &'static str,
        scene: &Scene,
        charts: Option<&Charts>,
        rates: Option<Rates>,
        warnings: Vec<Warning>,
    ) -> Self {
        let pixels =
            scene.images.iter().map(|image| u64::from(image.size_px[0]) * u64::from(image.size_px[1]));
        let triangles = scene.instances.iter().map(|instance| instance.triangles.len() as u64);
        let mut forecast = Self {
            kind,
            instances: scene.instances.len() as u64,
            triangles: triangles.sum(),
            materials: scene.materials.len() as u64,
            textures: scene.images.len() as u64,
            texture_pixels: pixels.sum(),
            texture_bytes: scene.images.iter().map(|image| image.bytes.len() as u64).sum(),
            lights: scene.lights.len() as u64,
            cameras: scene.cameras.len() as u64,
            bounds_m: bounds_m(scene),
            lightmap: charts.map(|charts| lightmap(scene, charts)),
            costs: None,
            warnings,
        };
        forecast.costs =
            forecast.lightmap.zip(rates).map(|(lightmap, rates)| forecast.costs(lightmap, rates));
        forecast
    }

    fn costs(&self, lightmap: LightmapForecast, rates: Rates) -> Costs {
        let receivers = lightmap.receivers as f64;
        let clusters = (receivers / rates.cluster_receivers * CLUSTERS_PER_FULL_ONE).ceil();
        let memory = PROGRAM_BYTES
            + self.triangles as f64 * TRIANGLE_BYTES
            + self.texture_pixels as f64 * PIXEL_BYTES
            + receivers * rates.memory_bytes;
        Costs {
            // The clusters', the kind's plan and its end, and those over the scene.
            tasks: clusters as u64 + 2 + SceneTask::ALL.len() as u64,
            cpu_secs: receivers * rates.cpu_us * 1e-6,
            memory_bytes: memory as u64,
            bundle_bytes: self.texture_bytes
                + (receivers * rates.bundle_bytes + self.triangles as f64 * DRAWN_BYTES) as u64,
            measured: rates.measured,
        }
    }
}

/// A scene that a bake would refuse, or a fault of this process.
fn refused(error: &TaskError) -> Failure {
    let exit = match error {
        TaskError::BadInput { .. } => Exit::BadInput,
        _ => Exit::Failed,
    };
    Failure::of(exit, error)
}

fn lightmap(scene: &Scene, charts: &Charts) -> LightmapForecast {
    let blocks = charts.unwraps.iter().flat_map(|unwrap| &unwrap.blocks);
    let texel_m2 = f64::from(charts.texel_m) * f64::from(charts.texel_m);
    let receivers = lit_area_m2(scene) / texel_m2 + CHART_RECEIVERS * lit_charts(scene, charts);
    LightmapForecast {
        texel_m: charts.texel_m,
        receivers: receivers.ceil() as u64,
        texels: blocks.map(|block| u64::from(block.width) * u64::from(block.height)).sum(),
    }
}

/// Charts of all surfaces, those of double-sided ones twice.
fn lit_charts(scene: &Scene, charts: &Charts) -> f64 {
    let of_instance = |(instance, unwrap): (&scene::model::MeshInstance, &Unwrap)| {
        let triangles = unwrap.blocks.iter().flat_map(|block| &block.triangles);
        let different: BTreeSet<u32> = triangles.map(|triangle| triangle.chart).collect();
        let is_double = scene.materials[instance.material_index as usize].double_sided;
        different.len() as f64 * if is_double { 2.0 } else { 1.0 }
    };
    scene.instances.iter().zip(&charts.unwraps).map(of_instance).sum()
}

/// Area of all surfaces, double-sided ones twice, in m².
fn lit_area_m2(scene: &Scene) -> f64 {
    let of_instance = |instance: &scene::model::MeshInstance| {
        let is_double = scene.materials[instance.material_index as usize].double_sided;
        let area_m2: f64 = instance
            .triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.map(|vertex| instance.positions_m[vertex as usize]);
                0.5 * f64::from((b - a).cross(c - a).length())
            })
            .sum();
        if is_double { 2.0 * area_m2 } else { area_m2 }
    };
    scene.instances.iter().map(of_instance).sum()
}

fn bounds_m(scene: &Scene) -> [[f32; 3]; 2] {
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for position in scene.instances.iter().flat_map(|instance| &instance.positions_m) {
        for (axis, at) in position.to_array().into_iter().enumerate() {
            bounds[0][axis] = bounds[0][axis].min(at);
            bounds[1][axis] = bounds[1][axis].max(at);
        }
    }
    bounds
}
