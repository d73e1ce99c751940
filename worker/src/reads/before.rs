//! What tasks alike that were done before have left.

use lightkiln_proto::jobs::Artefact;

use super::record::{RECORD_ARTEFACT, Record};
use super::stage::Stage;
use crate::task::{Context, FetchError, TaskError, TaskOutput};

/// The value of that name among outputs; `None` if it is gone or of other code.
pub fn of_before<T>(
    context: &Context,
    outputs: &[Artefact],
    name: &str,
    decoded: impl Fn(&[u8]) -> Result<T, TaskError>,
) -> Result<Option<T>, TaskError> {
    let Some(artefact) = outputs.iter().find(|output| output.name == name) else { return Ok(None) };
    match context.source.get(artefact.digest) {
        Ok(bytes) => Ok(decoded(&bytes).ok()),
        Err(FetchError::Cancelled(cancelled)) => Err(cancelled.into()),
        Err(_) => Ok(None),
    }
}

/// Names and bytes.
type Outputs = Vec<(String, Vec<u8>)>;

/// All outputs; `None` if one is gone, unless it is the one that a task can do without.
pub fn outputs_of_before(
    context: &Context,
    outputs: &[Artefact],
    dispensable: &str,
) -> Result<Option<Outputs>, TaskError> {
    let mut all = Vec::with_capacity(outputs.len());
    for output in outputs {
        match context.source.get(output.digest) {
            Ok(bytes) => all.push((output.name.clone(), bytes.as_ref().clone())),
            Err(FetchError::Cancelled(cancelled)) => return Err(cancelled.into()),
            Err(_) if output.name == dispensable => (),
            Err(_) => return Ok(None),
        }
    }
    Ok(Some(all))
}

/// Remains of tasks alike.
pub enum Before {
    /// The result of one: all that it read is as it was.
    Kept(TaskOutput),
    /// Nothing that could be taken, and why.
    Changed(String),
}

/// The result of a task alike, if all that it read is as it was, with the note `kept`.
pub fn before(context: &Context, stage: &Stage, kept: &str) -> Result<Before, TaskError> {
    let mut why = match context.alike {
        [] => "none like them were before".to_owned(),
        _ => "those like them before left no record, as they met too much, or it is gone".to_owned(),
    };
    for outputs in context.alike {
        let Some(record) = of_before(context, outputs, RECORD_ARTEFACT, Record::decoded)? else { continue };
        let changes = record.changes(stage);
        if changes.any {
            why = format!("{} has changed", changes.first.as_deref().unwrap_or("something"));
            continue;
        }
        let Some(artefacts) = outputs_of_before(context, outputs, "")? else {
            "nothing that they met has changed, but what was before is gone".clone_into(&mut why);
            continue;
        };
        let note = kept.to_owned();
        return Ok(Before::Kept(TaskOutput { artefacts, note, ..TaskOutput::default() }));
    }
    Ok(Before::Changed(why))
}
