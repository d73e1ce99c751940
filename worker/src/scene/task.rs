//! Task `scene.import`: scene bundle → imported scene and its warnings.

use lightkiln_proto::jobs::TaskSpec;

use super::model::{Material, Scene, Warning};
use super::shells::cut_about_core;
use super::surface::MAX_ALBEDO;
use super::{ARTEFACT_MAGIC, Bundle, Limits, import};
use crate::task::{Context, TaskError, TaskOutput, artefact};

/// A warning that names the materials without texture whose albedo is clamped; under a texture, only texels that are
/// whiter than the clamp are touched.
fn clamped_albedos(scene: &Scene) -> Option<Warning> {
    let too_white = |material: &&Material| {
        let [r, g, b, _] = material.base_colour;
        material.base_colour_texture.is_none() && r.max(g).max(b) > MAX_ALBEDO
    };
    let names: Vec<&str> =
        scene.materials.iter().filter(too_white).map(|material| material.name.as_str()).collect();
    let listed = names.iter().take(8).copied().collect::<Vec<_>>().join("', '");
    (!names.is_empty()).then(|| Warning {
        code: "albedo-clamped".into(),
        message: format!(
            "{} material(s) reflect more than {MAX_ALBEDO} of the light and are clamped to it, as bounces would never \
             end: '{listed}'",
            names.len()
        ),
    })
}

/// Runs the task: input `bundle`; outputs `scene` and `warnings` (JSON).
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let refused = |error| TaskError::bad_input_from("the scene cannot be imported", error);
    let limits = Limits::default();
    let bytes = context.bytes("bundle")?;
    let bundle = Bundle::from_bytes(bytes.as_ref().clone(), &limits).map_err(refused)?;
    context.progress.check()?;
    let mut imported = import(&bundle, &limits).map_err(refused)?;
    cut_about_core(&mut imported.scene, || context.progress.check())?;
    if imported.scene.instances.iter().all(|instance| instance.triangles.is_empty()) {
        return Err(TaskError::bad_input(
            "the scene has no triangles with an area: there is nothing to bake",
        ));
    }
    let mut warnings = imported.warnings;
    warnings.extend(clamped_albedos(&imported.scene));
    let warnings = serde_json::json!({ "warnings": warnings, "counts": imported.counts });
    let scene = artefact::encode(ARTEFACT_MAGIC, &imported.scene)?;
    Ok(TaskOutput {
        artefacts: vec![("scene".into(), scene), ("warnings".into(), warnings.to_string().into_bytes())],
        ..TaskOutput::default()
    })
}
