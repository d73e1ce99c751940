//! `kiln show`: one bake as it stands.

use clap::Args;
use lightkiln_proto::api::{Bake, BakeLimits, BakeState};

use crate::arguments::ServerArgument;
use crate::console::{printable, put, put_json};
use crate::failure::Result;
use crate::summary::stage_name;
use crate::times::utc_secs;

/// Arguments of `kiln show`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    #[command(flatten)]
    server: ServerArgument,
    /// Prints it as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the bake for people or as JSON.
pub fn run(arguments: Arguments) -> Result<()> {
    let client = arguments.server.connect()?;
    let bake = client.bake(&arguments.id)?;
    if arguments.json {
        put_json(&bake);
    } else {
        put(&printable(&words(&bake)));
    }
    Ok(())
}

fn words(bake: &Bake) -> String {
    let mut words = format!(
        "bake      {}\nname      {}\nstate     {}\nsubmitted {}\nended     {}\nscene     {}\nsettings  {}\n\
         tasks     {} run, {} done before\n",
        bake.id,
        bake.name,
        bake.state.name(),
        utc_secs(bake.created_ms),
        bake.finished_ms.map_or_else(|| "-".to_owned(), utc_secs),
        bake.scene,
        bake.settings,
        bake.tasks_run,
        bake.tasks_reused
    );
    for stage in &bake.stages {
        let name = stage_name(&stage.kind);
        let secs = stage.elapsed_ms as f64 / 1e3;
        words += &format!(
            "  {name:10} {:>6}/{:<6} {} under way, {secs:.1} s\n",
            stage.done, stage.total, stage.leased
        );
    }
    if let Some(owner) = &bake.owner {
        words += &format!("owner     {owner}\n");
    }
    if !bake.limits.is_none() {
        words += &limits_in_words(&bake.limits);
    }
    if bake.verify_share > 0.0 {
        words += &format!("verifies  {} of the results on another machine\n", bake.verify_share);
    }
    if bake.attempts_failed + bake.attempts_lost > 0 {
        let (failed, lost) = (bake.attempts_failed, bake.attempts_lost);
        words += &format!("attempts  {failed} failed, {lost} lost with their workers\n");
    }
    if bake.alarms > 0 {
        let alarms = bake.alarms;
        words += &format!(
            "ALARM     {alarms} results differ from one attempt to another: a machine, or the code of a task, is not to be trusted; \
             kiln logs tells\n"
        );
    }
    if let Some(failure) = &bake.failure {
        words += &format!("failure   {failure}\n");
    }
    if bake.results_lost > 0 {
        let lost = bake.results_lost;
        words +=
            &format!("lost      {lost} results, after its end; a new bake of the scene makes them again\n");
    }
    if bake.state == BakeState::Done && bake.results_lost == 0 {
        words += &format!("next      kiln fetch {} --out DIR\n", bake.id);
    }
    words
}

fn limits_in_words(limits: &BakeLimits) -> String {
    let BakeLimits { max_workers, attempts, lost_workers } = limits;
    let limits = [
        (max_workers, "workers at once"),
        (attempts, "attempts at a task"),
        (lost_workers, "lost workers a task"),
    ];
    let told = limits.into_iter().filter_map(|(most, what)| Some(format!("{} {what}", (*most)?)));
    format!("limits    {} at most\n", told.collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_that_were_set_are_told() {
        let limits = BakeLimits { max_workers: Some(4), lost_workers: Some(9), ..BakeLimits::default() };
        assert_eq!(limits_in_words(&limits), "limits    4 workers at once, 9 lost workers a task at most\n");
    }
}
