//! Sides of a world's triangles: the patch of the receiver that stands for each point.

use std::cell::RefCell;
use std::collections::BTreeMap;

use glam::Vec3;
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::voxels::Glow;

use super::touches::{At, Sides, Triangle};
use crate::emitters::EmissiveTriangle;
use crate::lightmap::{Surface, World};
use crate::patches::PatchTree;
use crate::rays::Hit;
use crate::reads::{Reads, Stage};

/// Steps of the share of its emitter's radiance that a triangle has.
const GLOW_STEPS: f32 = 255.0;

/// Number of no patch.
const NONE: u32 = u32::MAX;

/// Tables of a world and its patches that all tasks of voxels read.
pub struct SurfaceTables {
    /// Of each patch the one that it is part of, [`NONE`] of a root.
    parent: Vec<u32>,
    /// Of each leaf its patch.
    patch_of_leaf: Vec<u32>,
    /// Of each instance its place in the order of their names.
    order: Vec<u32>,
    /// Of each emissive triangle its glow.
    glow_of: BTreeMap<u32, u16>,
    glows: Vec<Glow>,
}

impl SurfaceTables {
    /// Of a world and its patches, with its emissive triangles.
    pub fn new(world: &World, tree: &PatchTree, emissive: &[EmissiveTriangle]) -> Self {
        let mut parent = vec![NONE; tree.patches.len()];
        let mut patch_of_leaf = vec![NONE; tree.leaf_starts.len()];
        for patch in 0..tree.patches.len() as u32 {
            tree.parts(patch).for_each(|part| parent[part as usize] = patch);
            let of = &tree.patches[patch as usize];
            // Of a patch and its only part the part comes later, and is the leaf.
            if of.leaf_count == 1 {
                patch_of_leaf[of.first_leaf as usize] = patch;
            }
        }
        let instances = &world.geometry.scene.instances;
        let mut by_path: Vec<u32> = (0..instances.len() as u32).collect();
        by_path.sort_by_key(|&instance| (&instances[instance as usize].path, instance));
        let mut order = vec![0; instances.len()];
        by_path.iter().zip(0..).for_each(|(&instance, place)| order[instance as usize] = place);
        let (glow_of, glows) = glows(emissive);
        Self { parent, patch_of_leaf, order, glow_of, glows }
    }

    /// Bytes in memory, about.
    pub fn bytes(&self) -> usize {
        4 * (self.parent.len() + self.patch_of_leaf.len() + self.order.len()) + 32 * self.glow_of.len()
    }
}

/// A world's surfaces as voxels ask for them.
pub struct Surfaces<'a> {
    pub world: &'a World,
    pub tree: &'a PatchTree,
    pub tables: &'a SurfaceTables,
}

impl Surfaces<'_> {
    /// Emission of elements.
    pub fn glows(&self) -> &[Glow] {
        &self.tables.glows
    }

    /// Triangles that stop walks, in the order of their instances' names, which hangs on nothing else in the scene; of glass none.
    pub fn triangles(&self, is_wanted: impl Fn([Vec3; 2]) -> bool) -> Vec<Triangle> {
        let geometry = &self.world.geometry;
        let all = 0..geometry.triangles.len() as u32;
        let wanted = all.filter(|&index| {
            let [a, b, c] = geometry.corners(index);
            geometry.material(index).glass.is_none() && is_wanted([a.min(b).min(c), a.max(b).max(c)])
        });
        let mut triangles: Vec<Triangle> = wanted.map(|index| self.triangle(index)).collect();
        triangles.sort_by_key(|triangle| {
            let at = geometry.triangles[triangle.index as usize];
            (self.tables.order[at.instance as usize], at.triangle)
        });
        triangles
    }

    fn triangle(&self, index: u32) -> Triangle {
        let World { geometry, lightmap, .. } = self.world;
        let instance = geometry.triangles[index as usize].instance as usize;
        let block = lightmap.blocks.get(lightmap.first_block[instance] as usize);
        let texels = block.map_or(1.0, |block| block.texel_m / lightmap.texel_m);
        Triangle {
            index,
            corners: geometry.corners(index),
            is_double_sided: geometry.material(index).double_sided,
            glow: self.tables.glow_of.get(&index).copied().unwrap_or(0),
            lowest_level: (texels.max(1.0).log2().round() as u32).min(LEVEL_MAX),
        }
    }

    /// The patch of a leaf of a level up to `level`; the leaf's own where that has a higher one.
    fn patch_of(&self, leaf: u32, level: u32) -> PatchKey {
        let key = |patch: u32| self.tree.patches[patch as usize].key;
        let mut patch = self.tables.patch_of_leaf[leaf as usize];
        while let parent = self.tables.parent[patch as usize]
            && parent != NONE
            && key(parent).level() <= level.into()
        {
            patch = parent;
        }
        key(patch)
    }

    /// Sides of points, with what their patches are read from noted.
    pub fn noting<'b>(&'b self, stage: &'b Stage) -> Noting<'b> {
        Noting { surfaces: self, reads: Reads::new(self.world, stage), leaves: RefCell::default() }
    }
}

/// Last level that there can be.
const LEVEL_MAX: u32 = lightkiln_proto::voxels::LEVELS_MAX - 1;

/// Number of each emissive triangle's glow and 1, and the glows.
fn glows(emissive: &[EmissiveTriangle]) -> (BTreeMap<u32, u16>, Vec<Glow>) {
    let code = |of: &EmissiveTriangle| {
        (of.emitter, of.mean_glow.map(|share| (share.clamp(0.0, 1.0) * GLOW_STEPS).round() as u8))
    };
    let mut codes: Vec<_> = emissive.iter().map(code).collect();
    codes.sort_unstable();
    codes.dedup();
    codes.truncate(usize::from(u16::MAX));
    let number = |of: &EmissiveTriangle| {
        let place = codes.binary_search(&code(of)).unwrap_or_else(|place| place.min(codes.len() - 1));
        (of.triangle, place as u16 + 1)
    };
    let of = emissive.iter().map(number).collect();
    let share = |code: u8| f32::from(code) / GLOW_STEPS;
    (of, codes.iter().map(|(emitter, shares)| Glow { emitter: *emitter, share: shares.map(share) }).collect())
}

/// Surfaces, and what was read of them by one thread.
pub struct Noting<'a> {
    surfaces: &'a Surfaces<'a>,
    pub reads: Reads<'a>,
    /// Leaves that were named.
    pub leaves: RefCell<Vec<u32>>,
}

impl Sides for Noting<'_> {
    fn patch(
        &self,
        At { triangle, barycentric, point_m }: At,
        is_front: bool,
        level: u32,
    ) -> Option<PatchKey> {
        let hit = Hit { t: 0.0, triangle, barycentric, front: is_front };
        let found = self.surfaces.world.found_at(&hit, point_m);
        self.reads.note_hit(&found, point_m);
        let Surface::Receiver(receiver) = found.linked else { return None };
        let leaf = self.surfaces.tree.leaf_of_receiver[receiver as usize];
        self.leaves.borrow_mut().push(leaf);
        Some(self.surfaces.patch_of(leaf, level))
    }

    fn stops(&self, At { triangle, barycentric, .. }: At) -> bool {
        self.surfaces.world.geometry.tracer.is_wall_at(triangle, barycentric)
    }
}
