//! Surface patches: receivers that lie near each other, face the same way and see each other, in a tree from coarse to fine.
//!
//! Task `scene.patches`. The tree depends on the lightmap alone: every kind of bake that speaks of patches shares it.

mod chunk;
mod grow;
mod seen;

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::{AreaCode, PatchKey};
use lightkiln_proto::jobs::TaskSpec;
use serde::{Deserialize, Serialize};

use crate::lightmap::World;
use crate::task::{Context, TaskError, TaskOutput, artefact, params};

pub use chunk::encoded;

/// Magic of the patch tree artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKpt";
/// Name under which tasks see it.
const ARTEFACT: &str = "patches/patches";

/// Parameters of the task.
#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct PatchParams {
    /// The scene is a thing that is looked at from all around.
    from_around: bool,
}

/// Runs task `scene.patches`: inputs are those of [`World::of`]; output `patches`.
pub fn run(context: &Context, task: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let params = if task.params.is_null() { PatchParams::default() } else { params(task)? };
    let world = World::of(context)?;
    let receivers = &world.lightmap.receivers;
    // Receivers stand block by block.
    chunk::check_blocks(receivers.chunk_by(|a, b| a.block == b.block).count())?;
    let tree = grow::tree(&world, params.from_around, context.progress)?;
    Ok(TaskOutput {
        artefacts: vec![("patches".into(), artefact::encode(ARTEFACT_MAGIC, &tree)?)],
        counters: [("patches".to_owned(), tree.patches.len() as f64)].into(),
        ..TaskOutput::default()
    })
}

/// Surface patches, coarse to fine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PatchTree {
    /// Patches, each before its parts; the leaves of a patch are `first_leaf..first_leaf + leaf_count`.
    pub patches: Vec<Patch>,
    /// Leaf of each receiver; of a guest without meaning.
    pub leaf_of_receiver: Vec<u32>,
    /// Receivers, leaf by leaf, without guests.
    pub receivers: Vec<u32>,
    /// First entry of each leaf in `receivers`, and the end.
    pub leaf_starts: Vec<u32>,
    /// Indices of patches, ascending by key.
    pub by_key: Vec<u32>,
    /// Seen area of each receiver of the lightmap: its weight in the mean radiance of its patches.
    pub seen_areas: Vec<AreaCode>,
}

/// A surface patch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Identity.
    pub key: PatchKey,
    /// First leaf.
    pub first_leaf: u32,
    /// Leaves.
    pub leaf_count: u32,
    /// Index after the last of its parts; its first part, if it has any, follows itself, and each part the end of the
    /// one before.
    pub end: u32,
    /// Lower and upper corner of its receivers' positions in metres.
    pub bounds_m: [Vec3; 2],
    /// Sum of its receivers' seen areas, in texels.
    pub seen_texels: f32,
}

impl PatchTree {
    /// The tree among a task's inputs, decoded once per worker.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        context.shared(ARTEFACT_MAGIC, ARTEFACT)
    }

    /// Indices of patches that are part of no other.
    pub fn roots(&self) -> impl Iterator<Item = u32> + '_ {
        self.siblings(0, self.patches.len() as u32)
    }

    /// Indices of a patch's parts.
    pub fn parts(&self, patch: u32) -> impl Iterator<Item = u32> + '_ {
        self.siblings(patch + 1, self.patches[patch as usize].end)
    }

    fn siblings(&self, first: u32, end: u32) -> impl Iterator<Item = u32> + '_ {
        let within = move |index: &u32| *index < end;
        std::iter::successors(Some(first).filter(within), move |&index| {
            Some(self.patches[index as usize].end).filter(within)
        })
    }

    /// The patch of a key.
    pub fn of_key(&self, key: PatchKey) -> Option<&Patch> {
        let place = self.by_key.binary_search_by_key(&key, |&index| self.patches[index as usize].key).ok()?;
        Some(&self.patches[self.by_key[place] as usize])
    }

    /// Receivers of a patch.
    pub fn receivers_of(&self, patch: &Patch) -> &[u32] {
        let at = |leaf: u32| self.leaf_starts[leaf as usize] as usize;
        &self.receivers[at(patch.first_leaf)..at(patch.first_leaf + patch.leaf_count)]
    }
}
