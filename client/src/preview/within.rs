//! A bake whose light is fetched within a number of bytes, and while it is baked.

use std::sync::Arc;

use lightkiln_proto::manifest::{CLUSTERS, DIRECTORY, Manifest, OVERVIEW};

use super::{Prepared, View};
use crate::bake::{Beside, ClientKinds, LightStream, LoadedBake};
use crate::error::{ClientError, Result};
use crate::fetch::{Following, News, Source, check_outline, outline_of};
use crate::passes::shadow::reference::draw;
use crate::scene::{LoadedScene, Recolour, Tints};
use crate::stream::{Baked, Budget, Streamed, Viewpoint};

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
    listing: Listing,
    manifest_bytes: u64,
    /// Memory that the budget at the beginning allows: the overview of a bake under way, which comes at its end, must fit.
    memory_max: u64,
    tints: Tints,
    /// The view that pieces were fetched for last.
    view: Option<View>,
}

/// Manifest that lists the clusters to fetch.
enum Listing {
    /// The scene's.
    Scene,
    /// Of a bake under way, as far as it has landed; the scene has the outline.
    UnderWay(Box<Following>, ClientKinds),
    /// Of a bake that was under way and is done.
    Own(Box<Manifest>),
}

impl Listing {
    fn manifest<'a>(&'a self, scene: &'a LoadedScene) -> &'a Manifest {
        match self {
            Self::Scene => &scene.manifest,
            Self::UnderWay(following, _) => following.manifest().unwrap_or(&scene.manifest),
            Self::Own(manifest) => manifest,
        }
    }
}

impl StreamedBake {
    /// Fetches the scene, and the part of the light that comes first. Errs before that if the bake has no such part, or if it has
    /// more than
    /// the budget.
    pub fn begin(source: &Source, kinds: &ClientKinds, budget: Budget) -> Result<Self> {
        let (bytes, manifest) = source.manifest()?;
        kinds.of(&manifest)?;
        if manifest.chunks(OVERVIEW).is_empty() {
            let problem = format!(
                "of kind {} has no overview, the part of the light that comes first: draw it with all of its bytes, or bake it again",
                manifest.kind
            );
            return Err(ClientError::Source { text: "the bake".to_owned(), problem });
        }
        Self::opened(source, kinds, (&manifest, bytes.len() as u64), Listing::Scene, budget)
    }

    /// As [`Self::begin`], of a bake under way: with the clusters that have landed, and no overview, which is made of all of them.
    /// [`Self::hear`] goes on with it. A bake that is done by now is as any other. Errs where nothing of it has landed yet, not even its
    /// outline.
    pub fn follow(mut following: Following, kinds: &ClientKinds, budget: Budget) -> Result<Self> {
        let source = following.source().clone();
        if following.hear(0)? == News::Done {
            return Self::begin(&source, kinds, budget);
        }
        let bytes = following.bytes();
        let Some(manifest) = following.manifest().cloned() else {
            let problem = "has no scene to draw yet, as its receivers are not placed: try again a little later, or wait for \
                its end (--wait)";
            return Err(ClientError::Source { text: "the bake".to_owned(), problem: problem.to_owned() });
        };
        kinds.of(&outline_of(&manifest))?;
        let listing = Listing::UnderWay(Box::new(following), kinds.clone());
        Self::opened(&source, kinds, (&manifest, bytes), listing, budget)
    }

    /// Fetches the scene of a manifest, and the part of its light that comes first.
    fn opened(
        source: &Source,
        kinds: &ClientKinds,
        (manifest, manifest_bytes): (&Manifest, u64),
        listing: Listing,
        budget: Budget,
    ) -> Result<Self> {
        let kind = kinds.named(&manifest.kind)?;
        let clusters = manifest.bytes_of(CLUSTERS);
        let first = manifest_bytes + manifest.bytes_light() - clusters - kind.bytes_last(manifest)
            + [DIRECTORY, OVERVIEW].iter().map(|role| manifest.bytes_of(role)).sum::<u64>();
        if budget.bytes < first {
            let what = format!("{} bytes of light", budget.bytes);
            let problem =
                format!("are too few: manifest, directory, patches and overview alone have {first}");
            return Err(ClientError::Argument { what, problem });
        }
        let of_scene = match &listing {
            Listing::UnderWay(..) => outline_of(manifest),
            Listing::Scene | Listing::Own(_) => manifest.clone(),
        };
        // Neither waits for the other's answers, nor for its decoding.
        let (scene, stream) = std::thread::scope(|threads| {
            let stream = threads.spawn(|| kind.stream(source, manifest));
            let scene = LoadedScene::fetch(source, of_scene);
            (scene, stream.join())
        });
        let scene = scene?;
        let mut stream = stream.unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        check_memory(&*stream, budget.memory)?;
        if let Listing::UnderWay(following, _) = &listing {
            stream.grown(manifest, baked(following));
        }
        let light = stream.light(&scene, manifest)?;
        let bake = Arc::new(LoadedBake::new(scene, light));
        let (source, tints) = (source.clone(), Tints::default());
        let memory_max = budget.memory;
        Ok(Self { source, bake, stream, listing, manifest_bytes, memory_max, tints, view: None })
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
        let Streamed { memory_all, memory_least, .. } = self.stream.streamed();
        let all = memory_all - memory_least;
        let above = memory.saturating_sub(memory_least).min(all);
        let less = above / FALL[1] * FALL[0];
        (above > 0).then(|| memory_least + if less > all / FALL_END { less } else { 0 })
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
    pub fn add_objects(&mut self, objects: Vec<Beside>) -> Result<()> {
        if objects.is_empty() {
            return Ok(());
        }
        let mut bake = self.assembled()?;
        bake.tint_light(&self.tints);
        objects.into_iter().try_for_each(|object| bake.put(object))?;
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
        let of = (&self.source, self.listing.manifest(&self.bake.scene));
        let refined = self.stream.refine(of, light, &lit, viewpoint, budget, view.limit);
        if self.stream.streamed() != before {
            self.assemble()?;
        }
        refined
    }

    /// The bake goes on: more light is to come than [`Self::streamed`] tells of.
    pub fn is_under_way(&self) -> bool {
        matches!(self.listing, Listing::UnderWay(..))
    }

    /// Hears of more of a bake under way, waiting up to so long, and answers whether there is any: [`Self::refine`] fetches what has
    /// landed. At its end the light is that of any other bake, with an overview and in the order of the bake's manifest. Errs if the bake
    /// ended otherwise, and if the overview has more than the memory of the budget at the beginning. An error is the end of the stream:
    /// [`Self::bake`] stays as it is, and nothing more is to be asked for.
    pub fn hear(&mut self, wait_secs: u32) -> Result<bool> {
        let Listing::UnderWay(following, kinds) = &mut self.listing else { return Ok(false) };
        match following.hear(wait_secs)? {
            News::None => return Ok(false),
            News::More => {
                if let Some(manifest) = following.manifest() {
                    self.stream.grown(manifest, baked(following));
                }
                self.manifest_bytes = following.bytes();
                return Ok(true);
            }
            News::Done => {}
        }
        let (bytes, manifest) = self.source.manifest()?;
        kinds.of(&manifest)?;
        let before = following.manifest().unwrap_or(&self.bake.scene.manifest);
        check_outline(before, &manifest)?;
        self.stream.ended(&self.source, before, &manifest)?;
        (self.manifest_bytes, self.listing) = (bytes.len() as u64, Listing::Own(Box::new(manifest)));
        check_memory(&*self.stream, self.memory_max)?;
        self.assemble()?;
        Ok(true)
    }

    /// Takes the light that has come, in the colours that were given.
    fn assemble(&mut self) -> Result<()> {
        let mut bake = self.assembled()?;
        bake.tint_light(&self.tints);
        self.bake = Arc::new(bake);
        Ok(())
    }

    /// The bake with the light that has come, in its own colours.
    fn assembled(&self) -> Result<LoadedBake> {
        let manifest = self.listing.manifest(&self.bake.scene);
        let light = self.stream.light(&self.bake.scene, manifest)?;
        let movers = self.bake.movers.clone();
        Ok(LoadedBake { movers, ..LoadedBake::new(Arc::clone(&self.bake.scene), light) })
    }
}

/// Errs where the part of the light that always stays has more than so much memory.
fn check_memory(stream: &dyn LightStream, memory_max: u64) -> Result<()> {
    let memory = stream.streamed().memory_least;
    if memory_max >= memory {
        return Ok(());
    }
    let what = format!("{memory_max} bytes of memory for light");
    let problem = format!("are too few: patches and overview alone take some {memory}");
    Err(ClientError::Argument { what, problem })
}

fn baked(following: &Following) -> Baked {
    let [cells, cells_all] = following.cells();
    Baked { cells, cells_all }
}
