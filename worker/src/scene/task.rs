//! Task `scene.import`: scene bundle → imported scene, images that pictures alone read, and warnings.

use lightkiln_proto::jobs::TaskSpec;

use super::oddities::oddities;
use super::shells::cut_about_core;
use super::{ARTEFACT_MAGIC, Bundle, DETAILS_MAGIC, Limits, NO_TRIANGLES, import};
use crate::task::{Context, TaskError, TaskOutput, artefact};

/// Runs the task: input `bundle`; outputs `scene`, `details` and `warnings` (JSON).
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let refused = |error| TaskError::bad_input_from("the scene cannot be imported", error);
    let limits = Limits::default();
    let bytes = context.bytes("bundle")?;
    let bundle = Bundle::from_bytes(bytes.as_ref().clone(), &limits).map_err(refused)?;
    context.progress.check()?;
    let mut imported = import(&bundle, &limits).map_err(refused)?;
    cut_about_core(&mut imported.scene, || context.progress.check())?;
    if let Some(empty) = imported.warnings.iter().find(|warning| warning.code == NO_TRIANGLES) {
        return Err(TaskError::bad_input(empty.message.clone()));
    }
    let mut warnings = imported.warnings;
    warnings.extend(oddities(&imported.scene));
    let warnings = serde_json::json!({ "warnings": warnings, "counts": imported.counts });
    let scene = artefact::encode(ARTEFACT_MAGIC, &imported.scene)?;
    let details = artefact::encode(DETAILS_MAGIC, &imported.details)?;
    Ok(TaskOutput {
        artefacts: vec![
            ("scene".into(), scene),
            ("details".into(), details),
            ("warnings".into(), warnings.to_string().into_bytes()),
        ],
        ..TaskOutput::default()
    })
}
