//! Parts of clusters of an overview: the receivers that stand for those which have not come.

use lightkiln_proto::content::{BlockKey, ClusterTransport, Texel};

/// Names of a cluster's receivers.
pub(super) fn names(cluster: &ClusterTransport) -> impl Iterator<Item = (BlockKey, Texel)> + '_ {
    let receivers = &cluster.receivers;
    let block = |&block: &u16| receivers.blocks.get(usize::from(block)).copied().unwrap_or_default();
    receivers.block.iter().map(block).zip(receivers.texel.iter().copied())
}

/// A cluster of an overview with the receivers alone that `is_wanted` names; `None` if it names none.
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
    (!kept.receivers.texel.is_empty()).then_some(kept)
}

fn keep_of<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| keep.next().copied().unwrap_or_default());
}
