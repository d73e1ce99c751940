//! The chunk of patches, as the run time reads it.

use lightkiln_proto::chunk::encode_patches;
use lightkiln_proto::content::{self, PatchSet};

use super::PatchTree;
use crate::lightmap::{Lightmap, Numbering};
use crate::task::TaskError;

/// Blocks that one chunk can name.
const BLOCKS_MAX: usize = 1 << 16;

/// A tree over the receivers of a lightmap, encoded; `sky_parts` is how many parts the sky has beside it.
///
/// Errors with [`TaskError::BadInput`] when the scene has more blocks than a chunk can name.
pub fn encoded(tree: &PatchTree, lightmap: &Lightmap, sky_parts: u32) -> Result<Vec<u8>, TaskError> {
    let blocks = Numbering::of(tree.receivers.iter().map(|&receiver| lightmap.block_key(receiver)));
    if blocks.len() > BLOCKS_MAX {
        return Err(TaskError::bad_input(format!(
            "the scene has {} parts with receivers, more than {BLOCKS_MAX}: join meshes",
            blocks.len()
        )));
    }
    let patch = |patch: &super::Patch| content::Patch {
        key: patch.key,
        first_leaf: patch.first_leaf,
        leaf_count: patch.leaf_count,
    };
    let of_receivers = || tree.receivers.iter().map(|&receiver| &lightmap.receivers[receiver as usize]);
    let block = |&receiver: &u32| blocks.place_u16(lightmap.block_key(receiver));
    let set = PatchSet {
        patches: tree.patches.iter().map(patch).collect(),
        leaf_starts: tree.leaf_starts.clone(),
        block: tree.receivers.iter().map(block).collect(),
        texel: of_receivers().map(|receiver| receiver.texel).collect(),
        area: of_receivers().map(|receiver| receiver.area).collect(),
        blocks: blocks.into_values(),
        sky_parts,
    };
    encode_patches(&set).map_err(|error| TaskError::bad_input_from("the patches cannot be stored", error))
}
