//! Edits of a scene, shown before they are baked: a quick bake of the edited scene inside this process, beside the bake of the scene as it was.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::bake::Edited;
use lightkiln_client::fetch::{ApiClient, PATIENCE, Source};
use lightkiln_http::{Level, USUAL};

use crate::arguments::TrustArgument;
use crate::console::say;
use crate::embedded::{EmbeddedFarm, all_processors, default_state};
use crate::failure::{Failure, Result};
use crate::following::follow;
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::submission::{PackedScene, SceneArguments};

/// Arguments of an edit.
#[derive(Args, Clone, Debug)]
pub struct EditArguments {
    /// The scene as it is now: shows it before it is baked, of bakes of kinds that can. Surfaces whose light did not change have that of the bake, all others that of walks
    /// through voxels, which is noisier; how much of the picture that is, is said. Takes a few seconds for what the edit touches, and
    /// keeps finished tasks where 'kiln bake' does
    #[arg(long, value_name = "SCENE", conflicts_with_all = ["max_bytes", "max_memory", "debug"], help_heading = "Picture")]
    edit: Option<PathBuf>,
    /// Folder that holds the edited scene and the files that it names [default: the scene's own]
    #[arg(long, value_name = "DIR", requires = "edit", help_heading = "Picture")]
    edit_root: Option<PathBuf>,
}

impl EditArguments {
    /// The light of the edited scene, beside its bake before the edit; `None` where no edit is asked for.
    pub fn light(&self, kinds: &KindTables, before: &Source) -> Result<Option<Edited>> {
        let Some(path) = self.edit.clone() else { return Ok(None) };
        if kinds.client.follow(before)?.is_some() {
            let what = "an edit is shown beside a bake that is done, and this one goes on";
            return Err(Failure::bad_input(what).try_this("it once the bake is done, or with --wait"));
        }
        let (_, manifest) = before.manifest()?;
        let quick = kinds.client.of(&manifest)?.quick_bake(&manifest)?;
        let scene = PackedScene::read(&SceneArguments { path, root: self.edit_root.clone() })?;
        let interrupt = Interrupt::listen()?;
        let farm = EmbeddedFarm::start(&default_state()?, all_processors(), kinds, &interrupt)?;
        let client = TrustArgument { ca: None }.connect(farm.url(), &interrupt)?.with_retry(PATIENCE);
        let bake = scene.submit(&client, |bake| {
            quick.kind.clone_into(&mut bake.kind);
            bake.settings.clone_from(&quick.settings);
            farm.reserve(bake);
        })?;
        follow(&client, &bake.id, &interrupt, || farm.check())
            .inspect_err(|_| stop(&farm, &client, &bake.id))?;
        // Drawing is not wound down: the next signal ends it at once.
        interrupt.flag().raise(Level::Drain);
        let after = Source::server(client, bake.id);
        let edited = kinds.client.of(&manifest)?.edited(before, &after)?;
        let count = |which: fn(&f32) -> bool| edited.provisional.iter().filter(|share| which(share)).count();
        say!(
            "edit: of {} receivers {} have all of their light from walks, {} some of it",
            edited.provisional.len(),
            count(|share| *share >= 1.0),
            count(|share| *share > 0.0 && *share < 1.0)
        );
        Ok(Some(edited))
    }
}

/// Stops a bake that nobody waits for any more; it goes on where it was when it is asked for again.
fn stop(farm: &EmbeddedFarm, client: &ApiClient, id: &str) {
    farm.stop_worker();
    if let Err(error) = client.clone().with_retry(USUAL).cancel(id) {
        tracing::debug!(%error, "the bake was not cancelled");
    }
}
