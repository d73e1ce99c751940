//! Parts of clusters: of an overview the receivers that stand for those which have not come, of a bake of before what an edit left of it.

use lightkiln_proto::content::{BlockKey, ClusterTransport, NearHits, NearSurface, Texel, TransportFactors};

/// Names of a cluster's receivers.
pub(super) fn names(cluster: &ClusterTransport) -> impl Iterator<Item = (BlockKey, Texel)> + '_ {
    let receivers = &cluster.receivers;
    let block = |&block: &u16| receivers.blocks.get(usize::from(block)).copied().unwrap_or_default();
    receivers.block.iter().map(block).zip(receivers.texel.iter().copied())
}

/// A cluster with the receivers alone that `is_wanted` names; `None` if it names none.
pub fn only(
    cluster: &ClusterTransport,
    is_wanted: impl Fn((BlockKey, Texel)) -> bool,
) -> Option<ClusterTransport> {
    let keep: Vec<bool> = names(cluster).map(is_wanted).collect();
    let rank = cluster.factors.rank as usize;
    let mut kept = cluster.clone();
    let receivers = &mut kept.receivers;
    keep_of(&mut receivers.block, &keep);
    keep_of(&mut receivers.texel, &keep);
    keep_of(&mut receivers.position_m, &keep);
    keep_of(&mut receivers.normal, &keep);
    keep_of(&mut receivers.albedo, &keep);
    keep_of(&mut receivers.emission, &keep);
    keep_of(&mut receivers.links, &keep);
    keep_of(&mut receivers.coverage, &keep);
    keep_of(&mut receivers.edge, &keep);
    kept.emitters.iter_mut().for_each(|column| keep_of(&mut column.irradiance, &keep));
    let rows = cluster.factors.u.chunks(rank.max(1)).zip(&keep);
    kept.factors.u = rows.filter(|(_, keep)| **keep).flat_map(|(row, _)| row.iter().copied()).collect();
    keep_hits(&mut kept.near, &keep);
    drop_unused(&mut kept.receivers.blocks, kept.receivers.block.iter_mut().collect());
    let of_hits = kept.near.surface.iter_mut().filter_map(|surface| match surface {
        NearSurface::Texel { block, .. } => Some(block),
        NearSurface::Own { .. } => None,
    });
    drop_unused(&mut kept.near.blocks, of_hits.collect());
    (!kept.receivers.texel.is_empty()).then_some(kept)
}

/// Leaves out blocks that none of these name any more, and numbers the others anew.
fn drop_unused(blocks: &mut Vec<BlockKey>, mut named: Vec<&mut u16>) {
    let mut is_used = vec![false; blocks.len()];
    for block in &named {
        if let Some(is_used) = is_used.get_mut(usize::from(**block)) {
            *is_used = true;
        }
    }
    let mut next = 0;
    let numbers: Vec<u16> = is_used
        .iter()
        .map(|is_used| {
            let number = next;
            next += u16::from(*is_used);
            number
        })
        .collect();
    for block in &mut named {
        // One that is out of range stays so.
        **block = numbers.get(usize::from(**block)).copied().unwrap_or(u16::MAX);
    }
    keep_of(blocks, &is_used);
}

/// Leaves out the hits of receivers that are not kept.
fn keep_hits(near: &mut NearHits, keep: &[bool]) {
    let of_hits: Vec<bool> = near
        .count
        .iter()
        .zip(keep)
        .flat_map(|(count, keep)| std::iter::repeat_n(*keep, usize::from(*count)))
        .collect();
    keep_of(&mut near.surface, &of_hits);
    keep_of(&mut near.offset, &of_hits);
    keep_of(&mut near.count, keep);
    keep_of(&mut near.weight, keep);
}

/// Gives each column the keys of those that together are it now, with their factors, and leaves those out that get none; several columns may
/// get the same key.
pub fn rename_columns(factors: &mut TransportFactors, names: impl Fn(u64) -> Vec<(u64, f32)>) {
    let of_key = factors.coefficients();
    let renamed: Vec<Vec<(u64, f32)>> = factors.keys.iter().map(|key| names(*key)).collect();
    // By new column, those of the sky last: the old one and its factor.
    let new = renamed
        .iter()
        .enumerate()
        .flat_map(|(old, names)| names.iter().map(move |(_, factor)| (old, *factor)));
    let sky = factors.sky.then_some((factors.keys.len(), 1.0));
    let new: Vec<(usize, f32)> = new.chain(sky).collect();
    let rows = factors.vt.chunks(factors.columns().max(1));
    let row = |row: &[f32]| -> Vec<f32> {
        let of = |&(old, factor): &(usize, f32)| {
            row.iter().skip(old * of_key).take(of_key).map(move |number| factor * number)
        };
        new.iter().flat_map(of).collect()
    };
    factors.vt = rows.flat_map(row).collect();
    let scale = &factors.steps.scale;
    let of_keys = new.iter().filter(|(old, _)| *old < factors.keys.len());
    // Stored numbers are whole numbers of steps.
    factors.steps.scale =
        of_keys.map(|(old, factor)| scale.get(*old).copied().unwrap_or(1.0) * factor.abs()).collect();
    factors.keys = renamed.into_iter().flatten().map(|(key, _)| key).collect();
}

fn keep_of<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| keep.next().copied().unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::narrow_contents;

    #[test]
    fn near_hits_of_receivers_that_stay_are_theirs() {
        let contents = narrow_contents();
        let cluster = contents.clusters.iter().find(|cluster| !cluster.near.surface.is_empty()).unwrap();
        let all: Vec<_> = names(cluster).collect();
        let kept = only(cluster, |name| name != all[0]).unwrap();
        // Surfaces by the keys of their blocks, as these are numbered anew.
        let hits = |cluster: &ClusterTransport, row: usize| {
            let range = cluster.near.ranges().nth(row).unwrap();
            let named = |surface: &NearSurface| match surface {
                NearSurface::Texel { block, texel } => {
                    (Some((cluster.near.blocks[usize::from(*block)], *texel)), None)
                }
                NearSurface::Own { .. } => (None, Some(*surface)),
            };
            let surfaces: Vec<_> = cluster.near.surface[range.clone()].iter().map(named).collect();
            (surfaces, cluster.near.offset[range].to_vec())
        };
        assert_eq!(kept.receivers.len() + 1, all.len());
        assert!((1..all.len()).any(|row| !hits(cluster, row).0.is_empty()));
        for row in 1..all.len() {
            assert_eq!(hits(&kept, row - 1), hits(cluster, row));
            assert_eq!(kept.near.weight[row - 1], cluster.near.weight[row]);
        }
    }

    #[test]
    fn blocks_of_which_nothing_is_left_are_named_no_more() {
        let contents = crate::fixture::prt_contents();
        let cluster = &contents.clusters[0];
        let mut two = cluster.clone();
        two.receivers.blocks.insert(0, 0xdead);
        two.receivers.block.iter_mut().for_each(|block| *block += 1);
        two.receivers.block[0] = 0;
        let all: Vec<_> = names(&two).collect();
        let kept = only(&two, |(block, _)| block != 0xdead).unwrap();
        assert_eq!(kept.receivers.blocks, cluster.receivers.blocks);
        assert_eq!(names(&kept).collect::<Vec<_>>(), all[1..]);
    }

    #[test]
    fn columns_keep_their_numbers_by_factors_under_other_names() {
        let mut factors = TransportFactors { keys: vec![3, 5, 9], rank: 2, sky: true, ..Default::default() };
        factors.vt = (0..8).map(|number| number as f32).collect();
        factors.steps.scale = vec![1.0, 2.0, 3.0];
        rename_columns(&mut factors, |key| match key {
            3 => vec![(7, 1.0)],
            5 => Vec::new(),
            key => vec![(key, 1.0), (4, -0.5)],
        });
        assert_eq!((&factors.keys[..], &factors.steps.scale[..]), (&[7, 9, 4][..], &[1.0, 3.0, 1.5][..]));
        assert_eq!(factors.vt, [0.0, 2.0, -1.0, 3.0, 4.0, 6.0, -3.0, 7.0]);
    }
}
