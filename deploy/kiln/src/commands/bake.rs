//! `kiln bake`: scene in, bundle out; with server and worker inside this process, or on a farm.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use lightkiln_client::fetch::{ApiClient, PATIENCE, Source};
use lightkiln_http::USUAL;
use lightkiln_proto::api::NewBake;

use crate::arguments::{PatienceArgument, TrustArgument};
use crate::bundle::{refuse_foreign_folder, write_bundle};
use crate::console::{printable, put_json, say};
use crate::embedded::{EmbeddedFarm, all_processors, default_state};
use crate::evaluation::{EvaluationArguments, NotedScene, check, measure, words};
use crate::explanation::explanation;
use crate::failure::{EXIT_CODES, Exit, Failure, Result};
use crate::following::follow;
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::movers::{MoverArguments, Parted};
use crate::objects::ObjectArgument;
use crate::outputs::{check_folder, check_png};
use crate::picture::PictureArguments;
use crate::reel::Reel;
use crate::settings::{SettingsArguments, Wanted};
use crate::submission::{LimitArguments, PackedScene, SceneArguments};
use crate::summary::{MoverSummary, Summary, complete_report};

/// Arguments of `kiln bake`.
#[derive(Args, Debug)]
#[command(after_help = EXIT_CODES)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Folder to write the bundle to [default: the scene's name with .kiln]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
    #[command(flatten)]
    movers: MoverArguments,
    /// Draws a picture of the bake, with its movers where the scene has them
    #[arg(long, value_name = "PNG")]
    preview: Option<PathBuf>,
    #[command(flatten)]
    picture: PictureArguments,
    #[command(flatten)]
    lighting: LightArguments,
    /// Bakes on the farm at this URL instead of in this process
    #[arg(long, value_name = "URL", conflicts_with_all = ["threads", "state"])]
    server: Option<String>,
    #[command(flatten)]
    limits: LimitArguments,
    #[command(flatten)]
    trust: TrustArgument,
    #[command(flatten)]
    patience: PatienceArgument,
    /// Threads to bake with [default: one per processor]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Folder that keeps finished tasks, so that nothing is baked twice; several bakes may share it at once
    /// [env: KILN_STATE; default: lightkiln in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Tells of each task whether it was run and why, once the bake is done
    #[arg(long)]
    explain: bool,
    /// Measures the bake against a path tracer, as 'kiln evaluate' does; the figures go into report.json and --json
    #[arg(long, help_heading = "Evaluation")]
    evaluate: bool,
    #[command(flatten)]
    wanted: EvaluationArguments,
    /// Ends with one JSON object on standard output: bake, scene, out, kind, tasks_run, tasks_reused, rays_closest,
    /// rays_occlusion, rays_linking, bytes_total, elapsed_secs, stages, warnings (code, message, try_setting), and the kind's own figures; with --mover also movers (node, bake, out, object, tasks_run,
    /// tasks_reused, bytes_total), with --evaluate also evaluation
    #[arg(long)]
    json: bool,
}

/// Bakes, writes the bundle, and draws the picture if one is wanted.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let started = Instant::now();
    let wanted = arguments.settings.resolve(&kinds.contract)?;
    arguments.picture.check()?;
    arguments.wanted.own_lights()?;
    arguments.wanted.check_figures(&kinds.worker)?;
    arguments.wanted.check_place(&kinds.worker, wanted.kind.name())?;
    if !arguments.evaluate && !arguments.wanted.fail_if.is_empty() {
        return Err(Failure::bad_input("--fail-if has nothing to look at").try_this("--evaluate beside it"));
    }
    let out = arguments.out.clone().unwrap_or_else(|| default_out(&arguments.scene.path));
    refuse_foreign_folder(&out)?;
    check_folder(&out)?;
    arguments.preview.as_deref().map_or(Ok(()), check_png)?;
    let scene = PackedScene::read(&arguments.scene)?;
    let Parted { scene, wanted, movers, warnings } =
        arguments.movers.part(&kinds.contract, scene, wanted, &out)?;
    let interrupt = Interrupt::listen()?;
    let farm = Place::open(&arguments, kinds, &interrupt)?;
    let client = farm.patient(arguments.trust.connect(farm.url(), &interrupt)?, &arguments.patience);
    let scene_name = arguments.scene.path.display().to_string();
    let bake = |scene: &PackedScene, wanted: &Wanted, out: &Path, started: Instant| -> Result<Summary> {
        let bake = scene.submit(&client, |bake| {
            wanted.set(bake);
            arguments.limits.set(bake);
            farm.reserve(bake);
        })?;
        let bake = follow(&client, &bake.id, &interrupt, || farm.check())
            .map_err(|failure| wind_down(failure, &farm, &client, &bake.id))?;
        Ok(write_bundle(&kinds.contract, &client, &bake, &scene_name, out, started)?.0)
    };
    // Objects first: they are small, and whatever is wrong with one is told soon.
    let mut moving = Vec::new();
    for mover in &movers {
        say!("mover {}", mover.node);
        let done = bake(&mover.scene, &mover.wanted, mover.object.file(), Instant::now())?;
        let (out, nodes) = (mover.object.file(), &arguments.movers.mover);
        complete_report(out, &NotedScene::of_object(&arguments.scene, nodes, &mover.node, out), &done)?;
        moving.push(MoverSummary::of(&mover.node, mover.object.words(), &done));
    }
    let mut summary = bake(&scene, &wanted, &out, started)?;
    summary.movers = moving;
    summary.warnings.splice(0..0, warnings);
    let explained = if arguments.explain { explanation(&client, &summary.bake)? } else { String::new() };
    drop(farm);
    let source = Source::bundle(&out)?;
    let noted = NotedScene::of(&arguments.scene, &arguments.movers.mover, &out);
    complete_report(&out, &noted, &summary)?;
    // The bake is done: whatever fails from here on, its place and its figures are told.
    let look = || -> Result<()> {
        if arguments.evaluate {
            let lighting = &arguments.lighting;
            let measured = measure(kinds, &source, scene, (&arguments.wanted, lighting), &interrupt)?;
            summary.evaluation = Some(measured.evaluation);
            complete_report(&out, &noted, &summary)?;
        }
        if let Some(png) = &arguments.preview {
            let objects: Vec<ObjectArgument> = movers.iter().map(|mover| mover.object.clone()).collect();
            let reel = Reel::of_objects(&objects, &kinds.client)?;
            arguments.picture.draw_reel(reel, &kinds.client, &arguments.lighting, &source, png)?;
            say!("picture: {}", png.display());
        }
        Ok(())
    };
    let looked_at = look();
    eprint!("{}{}", printable(&explained), printable(&summary.words()));
    say!("bundle: {}", out.display());
    summary.movers.iter().for_each(|mover| eprint!("{}", printable(&mover.words())));
    if let Some(evaluation) = &summary.evaluation {
        eprint!("{}", printable(&words(evaluation)));
    }
    if arguments.json {
        put_json(&summary);
    }
    looked_at?;
    summary.evaluation.map_or(Ok(()), |evaluation| check(&arguments.wanted.fail_if, &evaluation))
}

/// Where the bake runs.
enum Place {
    Embedded(Box<EmbeddedFarm>),
    Farm(String),
}

impl Place {
    fn open(arguments: &Arguments, kinds: &KindTables, interrupt: &Interrupt) -> Result<Self> {
        if let Some(url) = &arguments.server {
            return Ok(Self::Farm(url.clone()));
        }
        let state = arguments.state.clone().map_or_else(default_state, Ok)?;
        let threads = arguments.threads.map_or_else(all_processors, usize::from);
        Ok(Self::Embedded(Box::new(EmbeddedFarm::start(&state, threads, kinds, interrupt)?)))
    }

    fn url(&self) -> &str {
        match self {
            Self::Embedded(farm) => farm.url(),
            Self::Farm(url) => url,
        }
    }

    fn reserve(&self, bake: &mut NewBake) {
        match self {
            Self::Embedded(farm) => farm.reserve(bake),
            Self::Farm(_) => (),
        }
    }

    /// The server, waited for: inside this process it is slow at worst.
    fn patient(&self, client: ApiClient, patience: &PatienceArgument) -> ApiClient {
        match self {
            Self::Embedded(_) => client.with_retry(PATIENCE),
            Self::Farm(_) => patience.with(client),
        }
    }

    fn check(&self) -> Result<Option<String>> {
        match self {
            Self::Embedded(farm) => farm.check(),
            Self::Farm(_) => Ok(None),
        }
    }
}

/// Stops the work and cancels the bake, so that nothing goes on behind the user's back: in this process after any
/// failure, on a farm, where the bake can be watched again, after Ctrl-C.
fn wind_down(failure: Failure, farm: &Place, client: &ApiClient, id: &str) -> Failure {
    let is_interrupted = failure.exit() == Exit::Interrupted;
    let cancelled = match farm {
        Place::Farm(_) if !is_interrupted => return failure,
        Place::Farm(_) => client.cancel(id).map(drop),
        Place::Embedded(farm) => {
            farm.stop_worker();
            // A bake that has ended cannot be cancelled, and one that goes on is when the state is opened next. A full disk
            // refuses it for as long as it is asked.
            if let Err(error) = client.clone().with_retry(USUAL).cancel(id) {
                tracing::debug!(%error, "the bake was not cancelled");
            }
            Ok(())
        }
    };
    match cancelled {
        Ok(()) if !is_interrupted => failure,
        Ok(()) => failure.try_this("the same command again; it goes on from the tasks that are done"),
        Err(error) => {
            failure.caused_by(&error).try_this(format!("'kiln cancel {id}', as the bake may still run"))
        }
    }
}

fn default_out(scene: &Path) -> PathBuf {
    PathBuf::from(scene.file_stem().unwrap_or(scene.as_os_str())).with_added_extension("kiln")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bundle_is_named_after_the_scene() {
        assert_eq!(default_out(Path::new("scenes/cornell.glb")), Path::new("cornell.kiln"));
        assert_eq!(default_out(Path::new("a.b.gltf")), Path::new("a.b.kiln"));
    }
}
