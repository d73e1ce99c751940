//! The table of kinds of bake that a client plays.

use std::sync::Arc;

use lightkiln_proto::kinds::Kind;
use lightkiln_proto::manifest::Manifest;

use super::{Edited, Light, LightStream, QuickBake};
use crate::error::{ClientError, Result};
use crate::fetch::{Following, Source};
use crate::scene::LoadedScene;

/// A kind of bake as the client plays it.
pub trait ClientKind: Send + Sync {
    /// The kind's row of the contract: its name, and the check of its manifests.
    fn contract(&self) -> &'static dyn Kind;

    /// Fetches and decodes the light of a bake whose scene is loaded, and whose manifest the contract has checked.
    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>>;

    /// The browser's modules show its bakes too.
    fn is_in_browsers(&self) -> bool {
        false
    }

    /// The quick bake of an edited scene that [`Self::edited`] needs. Errs for a kind that shows no edits before they are baked.
    fn quick_bake(&self, manifest: &Manifest) -> Result<QuickBake> {
        let _ = manifest;
        Err(self.shows_no_edits())
    }

    /// The light of an edited scene, of the bake of the scene as it was and of the quick one of the scene as it is.
    fn edited(&self, before: &Source, after: &Source) -> Result<Edited> {
        let _ = (before, after);
        Err(self.shows_no_edits())
    }

    /// The error of such a kind.
    fn shows_no_edits(&self) -> ClientError {
        let text = format!("kind {}", self.contract().name());
        ClientError::Source { text, problem: "shows no edits before they are baked: bake them".to_owned() }
    }

    /// Bytes of light beside clusters that come after these.
    fn bytes_last(&self, manifest: &Manifest) -> u64 {
        let _ = manifest;
        0
    }

    /// Fetches the part of the light that comes first. Errs for a kind whose bakes have no such part.
    fn stream(&self, source: &Source, manifest: &Manifest) -> Result<Box<dyn LightStream>> {
        let _ = (source, manifest);
        let text = format!("kind {}", self.contract().name());
        let problem = "has no part of the light that comes first: fetch all of it".to_owned();
        Err(ClientError::Source { text, problem })
    }
}

/// Kinds by name.
#[derive(Clone, Default)]
pub struct ClientKinds(Vec<Arc<dyn ClientKind>>);

impl ClientKinds {
    /// A table without kinds.
    pub fn new() -> Self {
        Self::default()
    }

    /// The table with one more kind.
    ///
    /// # Panics
    /// If the table has a kind of that name.
    #[must_use]
    pub fn with(mut self, kind: impl ClientKind + 'static) -> Self {
        let name = kind.contract().name();
        assert!(self.names().all(|known| known != name), "two kinds are named '{name}'");
        self.0.push(Arc::new(kind));
        self
    }

    /// The kind of a manifest, whose settings and body that kind has checked.
    pub fn of(&self, manifest: &Manifest) -> Result<&dyn ClientKind> {
        let kind = self.named(&manifest.kind)?;
        kind.contract().check(manifest)?;
        Ok(kind)
    }

    /// Follows the bake of a source that goes on; `None` where it is done. Errs for one that failed or was cancelled, and for one of
    /// a kind that is seen only once its bakes are done.
    pub fn follow(&self, source: &Source) -> Result<Option<Following>> {
        Following::of(source, |kind| Ok(self.named(kind)?.contract().under_way()))
    }

    /// The kind of that name.
    pub(crate) fn named(&self, name: &str) -> Result<&dyn ClientKind> {
        let found = self.0.iter().find(|kind| kind.contract().name() == name);
        found.map(AsRef::as_ref).ok_or_else(|| {
            let known: Vec<&str> = self.names().collect();
            let text = name.chars().take(40).collect();
            let problem =
                format!("is no kind of bake that can be drawn here; known are {}", known.join(", "));
            ClientError::Source { text, problem }
        })
    }

    fn names(&self) -> impl Iterator<Item = &'static str> {
        self.0.iter().map(|kind| kind.contract().name())
    }
}
