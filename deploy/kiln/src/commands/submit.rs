//! `kiln submit`: asks a farm for a bake and prints its id.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use lightkiln_client::fetch::Source;
use lightkiln_proto::api::{Bake, BakeState, Needs, NewBake};
use serde_json::{Value, json};

use crate::arguments::{PatienceArgument, ServerArgument};
use crate::console::{answer, printable, put_json, say};
use crate::evaluation::{Evaluation, EvaluationArguments, check, measure, words};
use crate::failure::{EXIT_CODES, Failure, Result};
use crate::following::{Ended, wait_for_end};
use crate::interrupt::Interrupt;
use crate::junit;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::settings::SettingsArguments;
use crate::submission::{LimitArguments, PackedScene, SceneArguments};
use crate::summary::stage_name;

/// Arguments of `kiln submit`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    server: ServerArgument,
    #[command(flatten)]
    patience: PatienceArgument,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Bigger runs first
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    priority: i32,
    /// Commit that the bake belongs to: the same commit, scene and settings give the same bake, however often and from
    /// wherever they are submitted; a new one only where that failed or was cancelled
    #[arg(long, value_name = "COMMIT", env = "KILN_COMMIT", value_parser = clap::builder::NonEmptyStringValueParser::new())]
    commit: Option<String>,
    /// Memory in MiB that a worker must have to take its tasks
    #[arg(long, value_name = "MIB", default_value_t = 0)]
    needs_memory_mib: u32,
    /// Threads that a worker must have to take its tasks
    #[arg(long, value_name = "N", default_value_t = 0)]
    needs_threads: u32,
    /// A label that a worker must have to take its tasks; may be repeated
    #[arg(long = "needs-label", value_name = "LABEL")]
    needs_labels: Vec<String>,
    /// Seconds that one attempt at a task may take before it counts as failed [default: a day]
    #[arg(long, value_name = "SECS")]
    attempt_limit_secs: Option<u32>,
    #[command(flatten)]
    limits: LimitArguments,
    /// Waits until the bake ends; Ctrl-C ends the wait, not the bake
    #[arg(long)]
    wait: bool,
    /// Measures the finished bake against a path tracer on this machine, as 'kiln evaluate' does; the figures go into
    /// --json and --junit
    #[arg(long, requires = "wait", help_heading = "Evaluation")]
    evaluate: bool,
    #[command(flatten)]
    wanted: EvaluationArguments,
    #[command(flatten)]
    lighting: LightArguments,
    /// Prints one JSON object instead of the id: bake, name, scene, state, failure, tasks_run, tasks_reused, stages,
    /// elapsed_secs, with --evaluate also evaluation; with --wait once the bake has ended, also when it failed
    #[arg(long)]
    json: bool,
    /// Writes how the bake ended as a JUnit report, a test case for each stage; also when it never began
    #[arg(long, value_name = "FILE", requires = "wait")]
    junit: Option<PathBuf>,
}

/// The command's outcome: the bake's end, and its evaluation if one was wanted of a bake that is done.
struct Outcome {
    ended: Ended,
    evaluation: Option<Result<Evaluation>>,
}

/// Prints the bake's id on standard output, or with `--json` an object.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let started = Instant::now();
    check_wanted(&arguments, kinds)?;
    arguments.junit.as_deref().map_or(Ok(()), junit::check)?;
    let outcome = submit(&arguments, kinds);
    let judged = outcome.as_ref().ok().and_then(|outcome| outcome.evaluation.as_ref()).map(|evaluation| {
        let evaluation = evaluation.as_ref().map_err(Failure::clone)?;
        check(&arguments.wanted.fail_if, evaluation)
    });
    let elapsed = started.elapsed();
    let scene = arguments.scene.path.display().to_string();
    if let Some(path) = &arguments.junit {
        let ended = outcome.as_ref().map(|outcome| &outcome.ended);
        junit::write(path, &junit::report(&scene, ended, judged.as_ref(), elapsed))?;
    }
    let Outcome { ended, evaluation } = outcome?;
    let evaluation = evaluation.and_then(Result::ok);
    match arguments.json {
        true => put_json(&object(&ended.bake, &scene, evaluation.as_ref(), elapsed)),
        false if !arguments.wait => answer!("{}", ended.bake.id),
        false => (),
    }
    ended.judge()?;
    judged.unwrap_or(Ok(()))
}

/// Errs on an evaluation that cannot be, before anything is sent.
fn check_wanted(arguments: &Arguments, kinds: &KindTables) -> Result<()> {
    arguments.wanted.own_lights()?;
    arguments.wanted.check_figures(&kinds.worker)?;
    if !arguments.evaluate && !arguments.wanted.fail_if.is_empty() {
        return Err(Failure::bad_input("--fail-if has nothing to look at").try_this("--evaluate beside it"));
    }
    Ok(())
}

/// The bake as it stands when the command is to end.
fn submit(arguments: &Arguments, kinds: &KindTables) -> Result<Outcome> {
    let wanted = arguments.settings.resolve(&kinds.contract)?;
    arguments.wanted.check_place(&kinds.worker, wanted.kind.name())?;
    let scene = PackedScene::read(&arguments.scene)?;
    let needs = Needs {
        memory_mib: arguments.needs_memory_mib,
        threads: arguments.needs_threads,
        labels: arguments.needs_labels.clone(),
    };
    let interrupt = Interrupt::listen()?;
    let client = arguments.patience.with(arguments.server.connect_until(&interrupt)?);
    let set = |bake: &mut NewBake| {
        wanted.set(bake);
        bake.priority = arguments.priority;
        bake.needs = needs;
        bake.attempt_limit_secs = arguments.attempt_limit_secs;
        arguments.limits.set(bake);
    };
    let bake = match &arguments.commit {
        Some(commit) => scene.submit_once(&client, commit, set)?,
        None => scene.submit(&client, set)?,
    };
    if !arguments.wait {
        return Ok(Outcome { ended: Ended::not_yet(bake), evaluation: None });
    }
    // Now: whoever waits may want to watch it from elsewhere.
    match arguments.json {
        true => say!("bake {}", bake.id),
        false => answer!("{}", bake.id),
    }
    let ended = wait_for_end(&client, &bake.id, &interrupt, || Ok(None))?;
    let is_wanted = arguments.evaluate && ended.bake.state == BakeState::Done;
    let evaluation = is_wanted.then(|| {
        let source = Source::server(client, &ended.bake.id);
        let measured = measure(kinds, &source, scene, (&arguments.wanted, &arguments.lighting), &interrupt)?;
        eprint!("{}", printable(&words(&measured.evaluation)));
        Ok(measured.evaluation)
    });
    Ok(Outcome { ended, evaluation })
}

/// The one JSON object of `--json`: its keys are a contract.
fn object(bake: &Bake, scene: &str, evaluation: Option<&Evaluation>, elapsed: Duration) -> Value {
    let stages = bake.stages.iter();
    let stages = stages.map(|stage| (stage_name(&stage.kind), json!(stage.elapsed_ms as f64 / 1e3)));
    let mut object = json!({
        "bake": bake.id,
        "name": bake.name,
        "scene": scene,
        "state": bake.state,
        "failure": bake.failure,
        "tasks_run": bake.tasks_run,
        "tasks_reused": bake.tasks_reused,
        "stages": stages.collect::<serde_json::Map<_, _>>(),
        "elapsed_secs": elapsed.as_secs_f64(),
    });
    if let Some(evaluation) = evaluation {
        object["evaluation"] = json!(evaluation);
    }
    object
}
