//! The worker's side of the kind: its one task, and its answer to an evaluation.

use glam::DVec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use lightkiln_worker::assemble::{KindPart, assembled};
use lightkiln_worker::evaluate::{Answer, ChunkBytes, Evaluated, EvaluationError, Place, Relit};
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::kinds::{BakeKind, BakeKinds, TaskRow};
use lightkiln_worker::rays::Hit;
use lightkiln_worker::reference::{Lighting, Reference};
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::{Cancelled, Context, Progress, TaskError, TaskOutput, params};
use serde::Deserialize;

use super::contract::{Body, NAME, ROLE, Settings, TASK, decode, encode};

/// The kind's row in the worker's table.
pub struct Ambient;

impl BakeKind for Ambient {
    fn name(&self) -> &'static str {
        NAME
    }

    fn tasks(&self) -> Vec<TaskRow> {
        vec![TaskRow { name: TASK.name, run: light }]
    }

    fn evaluated(
        &self,
        _: &BakeKinds,
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: ChunkBytes,
        _: &Progress,
    ) -> Result<Box<dyn Evaluated>, EvaluationError> {
        let digest = manifest.chunks(ROLE)[0].digest;
        let irradiance =
            decode(&bytes(digest)?).map_err(|source| EvaluationError::Chunk { digest, source })?;
        let geometry = geometry_of(scene).map_err(EvaluationError::Prepare)?;
        Ok(Box::new(EvaluatedAmbient { geometry, irradiance: DVec3::from(irradiance.map(f64::from)) }))
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Params {
    settings: Settings,
    scene: Digest,
}

/// The kind's one task: chunk, manifest and report.
fn light(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let Params { settings, scene } = params(task)?;
    let irradiance = settings.light.irradiance;
    let bytes = encode([irradiance; 3])
        .map_err(|error| TaskError::bad_input_from("the light cannot be stored", error))?;
    let chunk = ChunkRef { digest: Digest::of(&bytes), bytes: bytes.len() as u64 };
    let mut output = assembled(
        context,
        KindPart {
            kind: NAME,
            scene,
            settings: &settings,
            body: &Body { irradiance },
            clusters: Vec::new(),
            chunks: vec![(ROLE, vec![chunk])],
        },
        serde_json::json!({}),
    )?;
    output.artefacts.push(("chunk".into(), bytes));
    Ok(output)
}

fn geometry_of(bundle: Vec<u8>) -> Result<Geometry, TaskError> {
    let refused = |error| TaskError::bad_input_from("the scene cannot be imported", error);
    let limits = Limits::default();
    let bundle = Bundle::from_bytes(bundle, &limits).map_err(refused)?;
    Geometry::new(import(&bundle, &limits).map_err(refused)?.scene)
}

/// A decoded bake: it answers at every point.
struct EvaluatedAmbient {
    geometry: Geometry,
    irradiance: DVec3,
}

impl Evaluated for EvaluatedAmbient {
    fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        let normal = self.geometry.side_normal(hit);
        let site = Site { position_m: self.geometry.point_of(hit), normal, face_normal: normal };
        Answer::Place(Place { site, number: None })
    }

    fn chunk_of(&self, _: &Place) -> Option<usize> {
        Some(0)
    }

    fn relit<'a>(
        &'a self,
        _: &Reference,
        _: &Lighting,
        _: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        Ok(Box::new(Constant(self.irradiance)))
    }
}

/// The same light under every light.
struct Constant(DVec3);

impl Relit for Constant {
    fn irradiance(&self, _: &Place) -> Option<DVec3> {
        Some(self.0)
    }

    fn bounces(&self) -> (usize, bool) {
        (0, true)
    }
}
