//! The chunk of patches, as the run time reads it.

use lightkiln_proto::chunk::encode_patches;
use lightkiln_proto::chunk::limits::PATCH_BLOCKS_MAX;
use lightkiln_proto::content::{self, PatchSet};

use super::PatchTree;
use crate::lightmap::{Lightmap, Numbering};
use crate::task::TaskError;

/// Errs when a chunk could not name all blocks with receivers: before the work on a tree that nobody can store.
pub fn check_blocks(blocks: usize) -> Result<(), TaskError> {
    if blocks <= PATCH_BLOCKS_MAX {
        return Ok(());
    }
    Err(TaskError::bad_input(format!(
        "the scene has {blocks} parts with receivers, more than {PATCH_BLOCKS_MAX}: join meshes of one material, as \
         'gltf-transform join' does, or bake to a kind without patches"
    )))
}

/// A tree over the receivers of a lightmap, encoded; `sky_parts` is how many parts the sky has beside it.
///
/// Errors with [`TaskError::BadInput`] when the scene has more blocks than a chunk can name.
pub fn encoded(tree: &PatchTree, lightmap: &Lightmap, sky_parts: u32) -> Result<Vec<u8>, TaskError> {
    let blocks = Numbering::of(tree.receivers.iter().map(|&receiver| lightmap.block_key(receiver)));
    check_blocks(blocks.len())?;
    let patch = |patch: &super::Patch| content::Patch {
        key: patch.key,
        first_leaf: patch.first_leaf,
        leaf_count: patch.leaf_count,
    };
    let of_receivers = || tree.receivers.iter().map(|&receiver| &lightmap.receivers[receiver as usize]);
    let block = |&receiver: &u32| blocks.place(lightmap.block_key(receiver)) as u32;
    let set = PatchSet {
        patches: tree.patches.iter().map(patch).collect(),
        leaf_starts: tree.leaf_starts.clone(),
        block: tree.receivers.iter().map(block).collect(),
        texel: of_receivers().map(|receiver| receiver.texel).collect(),
        area: tree.receivers.iter().map(|&receiver| tree.seen_areas[receiver as usize]).collect(),
        blocks: blocks.into_values(),
        sky_parts,
    };
    encode_patches(&set).map_err(|error| TaskError::bad_input_from("the patches cannot be stored", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_parts_than_a_chunk_can_name_are_refused_with_a_way_out() {
        assert!(check_blocks(PATCH_BLOCKS_MAX).is_ok());
        let refused = check_blocks(5_000_000).unwrap_err().to_string();
        assert!(refused.contains("5000000 parts") && refused.contains("gltf-transform join"), "{refused}");
    }
}
