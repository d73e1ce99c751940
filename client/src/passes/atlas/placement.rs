//! Places of the texels of a draw's sides, as shaders read them.

use crate::scene::{LightmapLayout, LoadedScene};

/// Blocks of a draw's sides; twin of `Placement` in `lightmap.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Placement {
    /// Block of the front: page, origin.
    pub front: [u32; 4],
    /// Its size; 0 when there is none.
    pub front_size: [u32; 4],
    /// Block of the back: page, origin.
    pub back: [u32; 4],
    /// Its size; 0 when there is none.
    pub back_size: [u32; 4],
}

/// The placement of every draw of a scene.
pub fn placements(scene: &LoadedScene) -> Vec<Placement> {
    let of_draw = |draw: &crate::scene::LoadedDraw| {
        let [front, front_size] = placed(&scene.lightmap, draw.front);
        let [back, back_size] = placed(&scene.lightmap, draw.back);
        Placement { front, front_size, back, back_size }
    };
    scene.draws.draws.iter().map(of_draw).collect()
}

/// Page and origin, and size, of a block; zeros when there is none.
fn placed(layout: &LightmapLayout, block: u32) -> [[u32; 4]; 2] {
    layout.block(block).map_or([[0; 4]; 2], |block| {
        [[block.page, block.origin[0], block.origin[1], 0], [block.size[0], block.size[1], 0, 0]]
    })
}
