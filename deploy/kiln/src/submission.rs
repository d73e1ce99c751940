//! From a scene on disk to a bake on a server.

use std::hash::{BuildHasher as _, Hasher as _, RandomState};
use std::path::PathBuf;
use std::time::SystemTime;

use clap::Args;
use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{Bake, BakeLimits, BakeState, MAX_CHUNK_BYTES, Needs, NewBake, SCENE_PART_BYTES};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::RetryClass;
use lightkiln_worker::scene::movers::{MoverError, MoverNodes, Split, split};
use lightkiln_worker::scene::{Bundle, ImportError, Limits};
use serde_json::Value;

use crate::failure::{Exit, Failure, Result};

/// The word for all nodes that an animation moves.
const ANIMATED: &str = "animated";
/// Longest name of a bake.
const NAME_CHARS_MAX: usize = 200;
/// Bakes of one commit that may have failed or been cancelled before. More → a commit can be tried more often.
const TRIES_OF_A_COMMIT: usize = 50;

/// Arguments that name a scene.
#[derive(Args, Clone, Debug)]
pub struct SceneArguments {
    /// The scene: a .glb, a .gltf with its files beside it, or a .zip of them
    #[arg(value_name = "SCENE")]
    pub path: PathBuf,
    /// Folder that holds the scene and the files that it names, where some of these lie above it, as ../textures/a.png does
    /// [default: the scene's own]
    #[arg(long, value_name = "DIR")]
    pub root: Option<PathBuf>,
}

/// Arguments that limit a bake.
#[derive(Args, Clone, Copy, Debug)]
pub struct LimitArguments {
    /// Machine limit: workers that hold tasks of this bake at once, at most; each counts as one, however many tasks it holds
    #[arg(long, value_name = "N", help_heading = "Limits", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    max_workers: Option<u32>,
    /// Failed attempts after which a task is given up, and the bake fails [default: 5, or 3 different workers]
    #[arg(long, value_name = "N", help_heading = "Limits", value_parser = clap::value_parser!(u32).range(1..=1_000))]
    attempts: Option<u32>,
    /// Times that a worker may be lost with one task before it is given up [default: the server's --lost-workers]
    #[arg(long, value_name = "N", help_heading = "Limits", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    lost_workers: Option<u32>,
    /// Share of the results, 0 to 1, that idle workers make once more on another machine: one that comes out otherwise is an alarm,
    /// which 'kiln show' tells [default: 0]
    #[arg(long, value_name = "SHARE", help_heading = "Limits", value_parser = parse_share)]
    verify_share: Option<f64>,
}

fn parse_share(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(share @ 0.0..=1.0) => Ok(share),
        _ => Err("write a share of the results in 0..=1, e.g. 0.01".to_owned()),
    }
}

impl LimitArguments {
    /// Writes them into a bake that is to be submitted.
    pub fn set(&self, bake: &mut NewBake) {
        let Self { max_workers, attempts, lost_workers, verify_share } = *self;
        bake.verify_share = verify_share.unwrap_or(0.0);
        bake.limits = BakeLimits { max_workers, attempts, lost_workers };
    }
}

/// A scene packed for upload.
pub struct PackedScene {
    /// Name for people: the file's stem.
    pub name: String,
    bytes: Vec<u8>,
}

impl PackedScene {
    /// Reads the scene and the files that it names.
    pub fn read(scene: &SceneArguments) -> Result<Self> {
        let (path, limits) = (&scene.path, Limits::default());
        let packed = match &scene.root {
            Some(root) => Bundle::pack_path_in(root, path, &limits),
            None => Bundle::pack_path(path, &limits),
        };
        let bytes = packed.map_err(|error| {
            let what = format!("the scene {} cannot be baked", path.display());
            let failure = Failure::bad_input(what).caused_by(&error);
            match error {
                ImportError::Io { .. } | ImportError::UnknownFormat => {
                    failure.try_this("a .glb, a .gltf with its files beside it, or a .zip of them")
                }
                error if error.is_of_wider_folder() => {
                    failure.try_this("--root DIR, a folder that holds the scene and all files that it names")
                }
                ImportError::OutsideRoot { .. } => failure.try_this("--root with a folder above the scene"),
                // The others say what to do themselves.
                _ => failure,
            }
        })?;
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self::new(&stem, bytes))
    }

    /// A packed scene under a name.
    pub fn new(name: &str, bytes: Vec<u8>) -> Self {
        Self { name: name.chars().take(NAME_CHARS_MAX).collect(), bytes }
    }

    /// The scene without nodes that move, and these.
    pub fn split(self, nodes: &MoverNodes) -> Result<(Self, Split)> {
        let limits = Limits::default();
        let bundle = Bundle::from_bytes(self.bytes, &limits).map_err(MoverError::from);
        let split = bundle.and_then(|bundle| split(&bundle, nodes, &limits));
        let mut split = split.map_err(|error| {
            Failure::bad_input(format!("the scene {} cannot be taken apart", self.name)).caused_by(&error)
        })?;
        Ok((Self::new(&self.name, std::mem::take(&mut split.rest)), split))
    }

    /// The scene of a farm's bake, which the farm has kept packed.
    pub fn of_bake(client: &ApiClient, bake: &Bake) -> Result<Self> {
        let bytes = client.chunk(bake.scene, MAX_CHUNK_BYTES)?;
        Ok(Self { name: bake.name.clone(), bytes })
    }

    /// The packed scene, whose digest a manifest names.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Uploads the scene unless the server has it, and asks for its bake; `set` says how it is to be.
    pub fn submit(&self, client: &ApiClient, set: impl FnOnce(&mut NewBake)) -> Result<Bake> {
        let bake = self.request(client, set)?;
        Ok(client.submit(&bake, &idempotency_key(bake.scene))?)
    }

    /// The same for a commit: trying again, on any machine, gives the same bake, unless that one failed or was
    /// cancelled. Then it is a new one, which the next try finds.
    pub fn submit_once(
        &self,
        client: &ApiClient,
        commit: &str,
        set: impl FnOnce(&mut NewBake),
    ) -> Result<Bake> {
        let new = self.request(client, set)?;
        let mut key = commit_key(commit, &new)?;
        for _ in 0..TRIES_OF_A_COMMIT {
            let bake = client.submit(&new, &key)?;
            if !matches!(bake.state, BakeState::Failed | BakeState::Cancelled) {
                return Ok(bake);
            }
            key = commit_key(&format!("{commit}/after/{}", bake.id), &new)?;
        }
        let what = format!("{TRIES_OF_A_COMMIT} bakes of commit {commit} failed or were cancelled");
        Err(Failure::new(Exit::Failed, what).try_this("'kiln list' to see why, then another --commit"))
    }

    fn request(&self, client: &ApiClient, set: impl FnOnce(&mut NewBake)) -> Result<NewBake> {
        let stored = client.upload_scene(&self.bytes).map_err(|error| {
            let may_go_on = error.retry_class() == RetryClass::Backoff;
            let failure = Failure::from(error);
            match may_go_on && self.bytes.len() > SCENE_PART_BYTES {
                true => failure.try_this("the same command later: the upload goes on where it was"),
                false => failure,
            }
        })?;
        let mut bake = NewBake {
            name: self.name.clone(),
            scene: stored.scene,
            kind: String::new(),
            settings: Value::Null,
            priority: 0,
            needs: Needs::default(),
            attempt_limit_secs: None,
            limits: Default::default(),
            verify_share: 0.0,
        };
        set(&mut bake);
        Ok(bake)
    }
}

/// The nodes of these names, if there are some; one name stands for all that are animated.
pub fn nodes_that_move(mut names: Vec<String>) -> Option<MoverNodes> {
    let all = names.len();
    names.retain(|name| name != ANIMATED);
    (all > 0).then_some(MoverNodes { animated: names.len() < all, names })
}

/// The same for the same commit, scene and settings. A digest: commits may be named by anything.
fn commit_key(commit: &str, bake: &NewBake) -> Result<String> {
    let body = serde_json::to_vec(&(commit, bake)).map_err(|error| {
        Failure::new(Exit::Failed, "the bake cannot be written as JSON").caused_by(&error)
    })?;
    Ok(format!("commit-{}", Digest::of(&body)))
}

/// Differs between runs, so that baking a scene again is a new bake; stays the same over the tries of one call.
fn idempotency_key(scene: Digest) -> String {
    let mut random = RandomState::new().build_hasher();
    random.write_u32(std::process::id());
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{:016x}-{:x}-{:016x}", scene.short(), now.as_nanos(), random.finish())
}

#[cfg(test)]
mod tests {
    use super::parse_share;

    #[test]
    fn share_is_a_number_from_nothing_to_all() {
        assert_eq!(["0", "0.01", "1"].map(parse_share), [Ok(0.0), Ok(0.01), Ok(1.0)]);
        for text in ["-0.1", "1.01", "NaN", "inf", "1 %", ""] {
            assert!(parse_share(text).is_err_and(|told| told.contains("0..=1")), "{text}");
        }
    }
}
