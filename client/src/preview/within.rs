//! A bake whose light is fetched within a number of bytes.

use std::sync::Arc;

use super::{Prepared, View};
use crate::bake::{ClientKinds, LightStream, LoadedBake};
use lightkiln_proto::manifest::{CLUSTERS, DIRECTORY, OVERVIEW};

use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::passes::shadow::reference::draw;
use crate::scene::{LoadedScene, Object, Recolour, Tints};
use crate::stream::{Budget, Streamed, Viewpoint};

/// Share of the light's memory that is tried where an adapter has no room for it. Nearer to 1 → more of its room is used, after more
/// tries.
const FALL: [u64; 2] = [3, 4];
/// A share of all light below one in so many is none.
const FALL_END: u64 = 64;

/// A bake whose light comes piece by piece.
pub struct StreamedBake {
    source: Source,
    /// The scene, and the light of the pieces that have come.
    pub bake: Arc<LoadedBake>,
    stream: Box<dyn LightStream>,
    manifest_bytes: u64,
    /// Memory of the part that comes first.
    memory_least: u64,
    tints: Tints,
    /// The view that pieces were fetched for last.
    view: Option<View>,
}

impl StreamedBake {
    /// Fetches the scene, and the part of the light that comes first. Errs before that if the bake has no such part, or if it has
    /// more than
    /// the budget.
    pub fn begin(source: &Source, kinds: &ClientKinds, budget: Budget) -> Result<Self> {
        let (bytes, manifest) = source.manifest()?;
        let kind = kinds.of(&manifest)?;
        if manifest.chunks(OVERVIEW).is_empty() {
            let problem = format!(
                "of kind {} has no overview, the part of the light that comes first: draw it with all of its bytes, or bake it again",
                manifest.kind
            );
            return Err(ClientError::Source { text: "the bake".to_owned(), problem });
        }
        let clusters = manifest.bytes_of(CLUSTERS);
        let first = bytes.len() as u64 + manifest.bytes_light() - clusters
            + [DIRECTORY, OVERVIEW].iter().map(|role| manifest.bytes_of(role)).sum::<u64>();
        if budget.bytes < first {
            let what = format!("{} bytes of light", budget.bytes);
            let problem =
                format!("are too few: manifest, directory, patches and overview alone have {first}");
            return Err(ClientError::Argument { what, problem });
        }
        // Neither waits for the other's answers, nor for its decoding.
        let (scene, stream) = std::thread::scope(|threads| {
            let stream = threads.spawn(|| kind.stream(source, &manifest));
            let scene = LoadedScene::fetch(source, manifest.clone());
            (scene, stream.join())
        });
        let (scene, stream) = (scene?, stream.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        let memory = stream.streamed().memory;
        if budget.memory < memory {
            let what = format!("{} bytes of memory for light", budget.memory);
            let problem = format!("are too few: patches and overview alone take some {memory}");
            return Err(ClientError::Argument { what, problem });
        }
        let light = stream.light(&scene)?;
        let bake = Arc::new(LoadedBake { scene: Arc::new(scene), light });
        let manifest_bytes = bytes.len() as u64;
        let (source, tints) = (source.clone(), Tints::default());
        Ok(Self { source, bake, stream, manifest_bytes, memory_least: memory, tints, view: None })
    }

    /// Bytes and clusters that have come, the manifest's bytes among them.
    pub fn streamed(&self) -> Streamed {
        let Streamed { bytes, bytes_all, .. } = self.stream.streamed();
        let with_manifest = |bytes| bytes + self.manifest_bytes;
        Streamed {
            bytes: with_manifest(bytes),
            bytes_all: with_manifest(bytes_all),
            ..self.stream.streamed()
        }
    }

    /// A budget of memory below `memory`, for an adapter that has no room for as much light; none below the part that comes first.
    pub fn less_memory(&self, memory: u64) -> Option<u64> {
        let all = self.stream.streamed().memory_all - self.memory_least;
        let above = memory.saturating_sub(self.memory_least).min(all);
        let less = above / FALL[1] * FALL[0];
        (above > 0).then(|| self.memory_least + if less > all / FALL_END { less } else { 0 })
    }

    /// Gives materials other colours, for the light that has come and that which will. Once: what was baked is gone then.
    pub fn recolour(&mut self, colours: &[Recolour]) -> Result<()> {
        if colours.is_empty() {
            return Ok(());
        }
        self.tints = Tints::of(&self.bake.scene, colours)?;
        let mut bake = self.assembled()?;
        bake.recolour(colours)?;
        self.bake = Arc::new(bake);
        Ok(())
    }

    /// Puts objects beside the bake, at rest at the origin.
    pub fn add_objects(&mut self, objects: Vec<Object>) -> Result<()> {
        if objects.is_empty() {
            return Ok(());
        }
        let mut bake = self.assembled()?;
        bake.tint_light(&self.tints);
        objects.into_iter().try_for_each(|object| bake.add_object(object))?;
        self.bake = Arc::new(bake);
        Ok(())
    }

    /// Fetches the layers of clusters that a view needs most, as far as the budget goes; its bytes are those of the manifest, too. What
    /// came before an error is in the bake.
    pub fn refine(&mut self, view: &View, budget: Budget) -> Result<()> {
        let prepared = Prepared::new(&self.bake, view)?;
        let maps = draw(&prepared.scene, &prepared.plan);
        let viewpoint = view.eye().map(|eye| Viewpoint { eye_m: eye.position_m, forward: eye.forward });
        let budget = Budget { bytes: budget.bytes.saturating_sub(self.manifest_bytes), ..budget };
        if self.view.as_ref() != Some(view) {
            self.stream.change_view();
            self.view = Some(view.clone());
        }
        let before = self.stream.streamed();
        let (light, lit) = (&*self.bake.light, prepared.lit(&maps));
        let refined = self.stream.refine(&self.source, light, &lit, viewpoint, budget, view.limit);
        if self.stream.streamed() != before {
            let mut bake = self.assembled()?;
            bake.tint_light(&self.tints);
            self.bake = Arc::new(bake);
        }
        refined
    }

    /// The bake with the light that has come, in its own colours.
    fn assembled(&self) -> Result<LoadedBake> {
        let light = self.stream.light(&self.bake.scene)?;
        Ok(LoadedBake { scene: Arc::clone(&self.bake.scene), light })
    }
}
