//! Parts of the tree of patches that a cut reads: small patches as a whole, large ones by their shape and, where parts are told by
//! their shares, by their areas.

use lightkiln_proto::content::PatchKey;

use super::marks::{Bytes, Mark, Name, Part};
use crate::patches::PatchTree;
use crate::transport::{FINE_LEVEL, stepped_area};

/// Names and digests of all parts of a tree.
pub fn marks(tree: &PatchTree) -> Vec<(Name, Mark)> {
    let mut found = Vec::new();
    let mut open: Vec<(u32, PatchKey)> = tree.roots().map(|root| (root, PatchKey(u64::MAX))).collect();
    while let Some((patch, parent)) = open.pop() {
        let key = tree.patches[patch as usize].key;
        if is_small(tree, patch) {
            found.push((Name::patch(Part::Branch, key), branch(tree, patch, parent)));
            continue;
        }
        let shape = of_parts(tree, patch, parent, |seen_texels| stepped_area(seen_texels).to_bits());
        let shares = of_parts(tree, patch, parent, |seen_texels| seen_texels.to_bits().into());
        found.push((Name::patch(Part::Shape, key), shape));
        found.push((Name::patch(Part::Shares, key), shares));
        open.extend(tree.parts(patch).map(|part| (part, key)));
    }
    found
}

/// Names of the parts that a cut over hits on some leaves, ascending, reads; `by_share` are those patches of it whose parts are told
/// by their shares.
pub fn read(tree: &PatchTree, leaves: &[u32], by_share: &[u32]) -> Vec<Name> {
    let key = |patch: u32| tree.patches[patch as usize].key;
    let large = by_share.iter().filter(|patch| !is_small(tree, **patch));
    let mut names: Vec<Name> = large.map(|&patch| Name::patch(Part::Shares, key(patch))).collect();
    let mut open: Vec<u32> = tree.roots().collect();
    while let Some(patch) = open.pop() {
        let of = &tree.patches[patch as usize];
        let first = leaves.partition_point(|&leaf| leaf < of.first_leaf);
        if leaves.get(first).is_none_or(|&leaf| leaf >= of.first_leaf + of.leaf_count) {
            continue;
        }
        if is_small(tree, patch) {
            names.push(Name::patch(Part::Branch, of.key));
        } else {
            names.push(Name::patch(Part::Shape, of.key));
            open.extend(tree.parts(patch));
        }
    }
    names
}

/// Names of the small patches, parts of no other small one, that some leaves, ascending, lie in.
pub fn branches(tree: &PatchTree, leaves: &[u32]) -> Vec<Name> {
    let names = read(tree, leaves, &[]);
    names.into_iter().filter(|name| name.part() == Part::Branch).collect()
}

fn is_small(tree: &PatchTree, patch: u32) -> bool {
    tree.patches[patch as usize].key.level() <= FINE_LEVEL
}

fn branch(tree: &PatchTree, patch: u32, parent: PatchKey) -> Mark {
    let mut bytes = Bytes::default();
    bytes.number(parent.0);
    for index in patch..tree.patches[patch as usize].end {
        let of = &tree.patches[index as usize];
        bytes.number(of.key.0).number((of.end - patch).into()).floats(&[of.seen_texels]);
        of.bounds_m.iter().for_each(|corner| {
            bytes.vector(*corner);
        });
    }
    bytes.mark()
}

fn of_parts(tree: &PatchTree, patch: u32, parent: PatchKey, area: impl Fn(f32) -> u64) -> Mark {
    let mut bytes = Bytes::default();
    bytes.number(parent.0);
    for index in std::iter::once(patch).chain(tree.parts(patch)) {
        let of = &tree.patches[index as usize];
        bytes.number(of.key.0).number(area(of.seen_texels));
        of.bounds_m.iter().for_each(|corner| {
            bytes.vector(*corner);
        });
    }
    bytes.mark()
}
