//! What tasks alike that were done before have left.

use lightkiln_proto::jobs::Artefact;

use crate::task::{Context, FetchError, TaskError};

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
