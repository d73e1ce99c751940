//! Parts of an object's surface that a level of its volume tells apart: sets of patches, split where facing and place differ most.

use glam::Vec3;
use lightkiln_proto::transfer::{PartPatch, TransferPart};

use crate::lightmap::World;
use crate::patches::PatchTree;

/// Length of the mean normal of a flat part, at least: normals within 1.1°.
const FLAT: f32 = 0.9998;
/// Receivers of a flat part lie so near to its plane, as a share of the object's largest side.
const FLAT_SHARE: f32 = 0.005;

/// Number of no part, in [`Parts::of_leaf`].
pub const NO_PART: u8 = u8::MAX;

/// Parts, and the part of each leaf of the tree.
pub struct Parts {
    pub parts: Vec<TransferPart>,
    pub of_leaf: Vec<u8>,
}

/// Patches of the tree, none of which holds another, with the surface that they are.
#[derive(Clone, Debug)]
struct Group {
    patches: Vec<u32>,
    area_m2: f32,
    /// Sum of normals times area.
    normal: Vec3,
    /// Sum of places times area.
    place_m: Vec3,
    low_m: Vec3,
    high_m: Vec3,
}

/// Weight of what nothing outside was found to see: little of it decides how parts are split.
const UNSEEN: f32 = 0.02;

/// The surface of patches.
struct Facing<'a> {
    world: &'a World,
    tree: &'a PatchTree,
    /// By leaf.
    is_seen: &'a [bool],
}

impl Facing<'_> {
    /// Receivers of a patch with their areas, as far as these are seen.
    fn receivers(&self, patch: u32) -> impl Iterator<Item = (&crate::lightmap::Receiver, f32)> {
        let Self { world, tree, is_seen } = self;
        let of = tree.receivers_of(&tree.patches[patch as usize]);
        of.iter().map(|&receiver| {
            let texel_m = world.lightmap.texel_m_of(receiver);
            let weight =
                if is_seen[tree.leaf_of_receiver[receiver as usize] as usize] { 1.0 } else { UNSEEN };
            let area_m2 = weight * tree.seen_areas[receiver as usize].texels() * texel_m * texel_m;
            (&world.lightmap.receivers[receiver as usize], area_m2)
        })
    }

    fn area_m2(&self, patch: u32) -> f32 {
        self.receivers(patch).map(|(_, area_m2)| area_m2).sum()
    }

    fn group(&self, patches: Vec<u32>) -> Group {
        let mut group = Group {
            patches,
            area_m2: 0.0,
            normal: Vec3::ZERO,
            place_m: Vec3::ZERO,
            low_m: Vec3::INFINITY,
            high_m: Vec3::NEG_INFINITY,
        };
        for (receiver, area_m2) in group.patches.iter().flat_map(|&patch| self.receivers(patch)) {
            group.area_m2 += area_m2;
            group.normal += receiver.normal * area_m2;
            group.place_m += receiver.position_m * area_m2;
            group.low_m = group.low_m.min(receiver.position_m);
            group.high_m = group.high_m.max(receiver.position_m);
        }
        group
    }

    fn direction(&self, patch: u32) -> u64 {
        self.tree.patches[patch as usize].key.direction()
    }

    /// Two parts of a group: what faces one way and the rest, else halves along its longest axis; `None` of one that is a single texel.
    fn halves(&self, group: &Group) -> Option<[Vec<u32>; 2]> {
        let mut patches = group.patches.clone();
        // A patch alone is split as the parts that it has.
        while let [patch] = patches[..] {
            patches = self.tree.parts(patch).filter(|part| self.area_m2(*part) > 0.0).collect();
            if patches.is_empty() {
                return None;
            }
        }
        let mut areas = [0.0_f32; 6];
        patches.iter().for_each(|&patch| areas[self.direction(patch) as usize % 6] += self.area_m2(patch));
        if areas.iter().filter(|area| **area > 0.0).count() > 1 {
            let largest = (0..6).fold(0, |best, at| if areas[at] > areas[best] { at } else { best });
            let (own, rest) =
                patches.into_iter().partition(|&patch| self.direction(patch) as usize == largest);
            return Some([own, rest]);
        }
        let extent_m = group.high_m - group.low_m;
        let axis = extent_m.max_position();
        let middle_m = |patch: u32| {
            let [low, high] = self.tree.patches[patch as usize].bounds_m;
            0.5 * (low + high)[axis]
        };
        patches.sort_by(|a, b| middle_m(*a).total_cmp(&middle_m(*b)).then(a.cmp(b)));
        let total: f32 = patches.iter().map(|&patch| self.area_m2(patch)).sum();
        let (mut sum, mut count) = (0.0, 0);
        while count + 1 < patches.len()
            && (count == 0 || sum + 0.5 * self.area_m2(patches[count]) < 0.5 * total)
        {
            sum += self.area_m2(patches[count]);
            count += 1;
        }
        let rest = patches.split_off(count);
        Some([patches, rest])
    }

    /// Plane behind which nothing of a flat part is seen.
    fn plane(&self, group: &Group, side_m: f32) -> [f32; 4] {
        let normal = group.normal.normalize_or_zero();
        if group.normal.length() < FLAT * group.area_m2 {
            return [0.0; 4];
        }
        let offsets = group.patches.iter().flat_map(|&patch| self.receivers(patch));
        let offsets = offsets.map(|(receiver, _)| normal.dot(receiver.position_m));
        let (least, most) = offsets
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), at| (least.min(at), most.max(at)));
        if most - least > FLAT_SHARE * side_m { [0.0; 4] } else { normal.extend(least).to_array() }
    }
}

/// How much of a group its mean does not tell: area times the spread of normals and of places.
fn spread(group: &Group, side_m: f32) -> f32 {
    let of_normals = 1.0 - group.normal.length() / group.area_m2.max(f32::MIN_POSITIVE);
    let extent = (group.high_m - group.low_m).length() / side_m;
    group.area_m2 * (of_normals + extent * extent)
}

impl Parts {
    /// At most so many of an object whose largest side is `side_m`; by leaf, whether anything outside sees it.
    pub fn of((world, tree): (&World, &PatchTree), is_seen: &[bool], count: u32, side_m: f32) -> Self {
        let facing = Facing { world, tree, is_seen };
        let roots: Vec<u32> = tree.roots().filter(|&root| facing.area_m2(root) > 0.0).collect();
        let mut groups: Vec<Group> = Vec::new();
        if !roots.is_empty() {
            groups.push(facing.group(roots));
        }
        let mut whole: Vec<Group> = Vec::new();
        while !groups.is_empty() && groups.len() + whole.len() < count as usize {
            let widest = (0..groups.len()).fold(0, |best, at| {
                if spread(&groups[at], side_m) > spread(&groups[best], side_m) { at } else { best }
            });
            let group = groups.swap_remove(widest);
            match facing.halves(&group) {
                None => whole.push(group),
                Some(halves) => groups.extend(halves.map(|half| facing.group(half))),
            }
        }
        groups.extend(whole);
        groups
            .iter_mut()
            .for_each(|group| group.patches.sort_unstable_by_key(|&patch| tree.patches[patch as usize].key));
        groups.sort_by_key(|group| group.patches.first().map(|&patch| tree.patches[patch as usize].key));
        let mut of_leaf = vec![NO_PART; tree.leaf_starts.len()];
        let mut parts = Vec::with_capacity(groups.len());
        for (number, group) in groups.iter().enumerate() {
            for &patch in &group.patches {
                let of = &tree.patches[patch as usize];
                of_leaf[of.first_leaf as usize..(of.first_leaf + of.leaf_count) as usize].fill(number as u8);
            }
            let patch = |&patch: &u32| {
                let share = (facing.area_m2(patch) / group.area_m2).clamp(0.0, 1.0);
                PartPatch { key: tree.patches[patch as usize].key, share }
            };
            parts.push(TransferPart {
                patches: group.patches.iter().map(patch).collect(),
                middle_m: (group.place_m / group.area_m2.max(f32::MIN_POSITIVE)).to_array(),
                plane: facing.plane(group, side_m),
                ..TransferPart::default()
            });
        }
        Self { parts, of_leaf }
    }
}
