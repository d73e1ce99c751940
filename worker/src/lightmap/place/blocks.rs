//! Blocks: a side of a part of an instance's unwrap, with an identity that hangs on the instance's path alone.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;

use crate::lightmap::{Block, Charts};
use crate::scene::model::Scene;
use crate::task::TaskError;

/// How many sides of an instance have receivers.
pub fn sides(scene: &Scene, instance: usize) -> u32 {
    if scene.materials[scene.instances[instance].material_index as usize].double_sided { 2 } else { 1 }
}

/// Index of each instance's first block.
pub fn first_blocks(scene: &Scene, charts: &Charts) -> Vec<u32> {
    let mut next = 0;
    let mut first = Vec::with_capacity(charts.unwraps.len());
    for (instance, unwrap) in charts.unwraps.iter().enumerate() {
        first.push(next);
        next += unwrap.blocks.len() as u32 * sides(scene, instance);
    }
    first
}

/// Empty blocks of all instances: part by part, front before back.
pub fn blocks(scene: &Scene, charts: &Charts) -> Result<Vec<Block>, TaskError> {
    let mut blocks = Vec::new();
    let mut keys = BTreeSet::new();
    for (instance, unwrap) in charts.unwraps.iter().enumerate() {
        for (part, block) in unwrap.blocks.iter().enumerate() {
            for side in ["front", "back"].into_iter().take(sides(scene, instance) as usize) {
                let name = format!("{} · part {part} · {side}", scene.instances[instance].path);
                let key = Digest::of(name.as_bytes()).short();
                if !keys.insert(key) {
                    return Err(TaskError::bad_input(format!(
                        "two blocks have the same identity ('{name}'): rename a node of the scene"
                    )));
                }
                let size = [block.width, block.height];
                blocks.push(Block {
                    key,
                    name,
                    texel_m: block.texel_m,
                    size,
                    instance: instance as u32,
                    receiver_of_texel: Vec::new(),
                });
            }
        }
    }
    Ok(blocks)
}
