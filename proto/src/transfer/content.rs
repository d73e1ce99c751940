//! A level of an object's volume.

use crate::content::PatchKey;

/// Levels of a volume.
pub const LEVELS: u32 = 4;
/// Nodes along each axis at least.
pub const NODES_MIN: u32 = 4;
/// Nodes along each axis at most.
pub const NODES_MAX: u32 = 64;
/// Parts of a level at most.
pub const PARTS_MAX: usize = 64;
/// Surface patches of a part at most.
pub const PATCHES_MAX: usize = 1 << 16;
/// Emitters of a part at most.
pub const GLOWS_MAX: usize = 1 << 10;

/// One level of a volume: F_p and Ω_p of some parts of an object's surface, at nodes around it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransferLevel {
    /// 0 is the finest and nearest.
    pub level: u32,
    /// Lower and upper corner of the object in its own space, in metres.
    pub box_m: [[f32; 3]; 2],
    /// Nodes along each axis.
    pub nodes: u32,
    /// Parts of the surface.
    pub parts: Vec<TransferPart>,
    /// F_p x, y, z and Ω_p in steps of the part's: part after part, node after node, x fastest, then y.
    pub codes: Vec<[i8; 4]>,
}

/// A part of an object's surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransferPart {
    /// Surface patches, none of which holds another; none of a part that is dark.
    pub patches: Vec<PartPatch>,
    /// Emission.
    pub glows: Vec<PartGlow>,
    /// Mean place of its surface in metres.
    pub middle_m: [f32; 3],
    /// Unit normal and offset of a plane, `n·x = d`, behind which nothing of it is seen; a normal of 0 where there is none.
    pub plane: [f32; 4],
    /// Steps of F_p and of Ω_p.
    pub steps: [f32; 2],
}

/// A surface patch of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartPatch {
    /// The patch.
    pub key: PatchKey,
    /// Share of the part's area.
    pub share: f32,
}

/// Emission of a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartGlow {
    /// Emitter of the manifest.
    pub emitter: u16,
    /// Its mean radiance over the part, per channel, as a share of the emitter's.
    pub share: [f32; 3],
}

impl TransferLevel {
    /// Nodes of the level.
    pub fn node_count(&self) -> usize {
        (self.nodes as usize).pow(3)
    }

    /// Codes of a part by node.
    pub fn codes_of(&self, part: usize) -> &[[i8; 4]] {
        &self.codes[part * self.node_count()..(part + 1) * self.node_count()]
    }
}

/// Codes of a part's F_p and Ω_p at nodes, and their steps: the largest number of the part at nodes that are read has 127 of them, larger ones
/// at others count as that.
pub fn node_codes(nodes: &[[f32; 4]], is_read: impl Fn(usize) -> bool) -> (Vec<[i8; 4]>, [f32; 2]) {
    let most = |of: std::ops::Range<usize>| {
        let read = nodes.iter().enumerate().filter(|(index, _)| is_read(*index));
        let all = read.flat_map(|(_, node)| &node[of.clone()]);
        all.fold(0.0_f32, |most, number| most.max(number.abs())) / 127.0
    };
    let steps = [most(0..3), most(3..4)];
    let code = |number: f32, step: f32| {
        if step > 0.0 { (number / step).round().clamp(-127.0, 127.0) as i8 } else { 0 }
    };
    let codes = nodes.iter().map(|&[x, y, z, omega]| {
        let [x, y, z] = [x, y, z].map(|number| code(number, steps[0]));
        [x, y, z, code(omega, steps[1])]
    });
    (codes.collect(), steps)
}
