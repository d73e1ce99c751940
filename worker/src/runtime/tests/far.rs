//! A farm at the end of a long line: a task's many artefacts do not wait for each other.

use lightkiln_proto::jobs::Artefact;

use super::fake_farm::FakeFarm;
use super::{Progress, Running, TaskError, TaskOutput};
use crate::task::ArtefactSource;
use lightkiln_http::Level;

/// Artefacts of a task.
const ARTEFACTS: usize = 8;

/// Asks for all inputs at once, and gives each back as an output.
fn copying(inputs: &[Artefact], source: &dyn ArtefactSource, _: &Progress) -> Result<TaskOutput, TaskError> {
    source.require_all(&inputs.iter().collect::<Vec<_>>())?;
    source.bring(&inputs.iter().map(|input| input.digest).collect::<Vec<_>>())?;
    let copy = |input: &Artefact| {
        let mut bytes = source.get(input.digest)?.to_vec();
        bytes.push(b'!');
        Ok((input.name.clone(), bytes))
    };
    let artefacts = inputs.iter().map(copy).collect::<Result<_, TaskError>>()?;
    Ok(TaskOutput { artefacts, ..TaskOutput::default() })
}

#[test]
fn call_that_takes_long_holds_up_no_other_of_its_task() {
    let inputs: Vec<Vec<u8>> = (0..ARTEFACTS).map(|number| format!("input {number}").into_bytes()).collect();
    let inputs: Vec<&[u8]> = inputs.iter().map(Vec::as_slice).collect();
    for method in ["HEAD /v1/chunks", "GET /v1/chunks", "PUT /v1/chunks"] {
        let (farm, folder) = (FakeFarm::start(), tempfile::tempdir().unwrap());
        farm.offer("t1", &inputs);
        farm.state().hang = Some(method);
        let cache_dir = folder.path().to_owned();
        let running = Running::start(&farm, copying, |config| config.cache_dir = Some(cache_dir));
        farm.wait_for(&format!("{method} of all others"), |state| {
            state.calls.iter().filter(|call| call.starts_with(method)).count() >= ARTEFACTS
        });
        farm.let_go();
        farm.wait_for("commit", |state| state.committed.len() == 1);
        running.end(Level::Drain);
        let outputs = &farm.state().committed["t1"].outputs;
        assert_eq!(outputs.len(), ARTEFACTS);
        assert!(outputs.iter().map(|output| output.bytes).eq([8; ARTEFACTS]), "{outputs:?}");
    }
}
