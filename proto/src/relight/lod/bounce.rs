//! A bounce of the clusters that are due.

use glam::Vec4;

use super::{LodPlan, LodTable, NO_STAND_IN, StandIn};
use crate::relight::{ClusterTable, Parallel, ReceiverTable};

/// Arrays that a bounce reads.
#[derive(Clone, Copy, Debug)]
pub(in crate::relight) struct BounceArrays<'a> {
    /// λ.
    pub lambda: &'a [Vec4],
    /// N of near hits by slot.
    pub near: &'a [Vec4],
    /// E_emit by slot.
    pub emit: &'a [Vec4],
    /// E_ind of the bounce before by slot.
    pub ind: &'a [Vec4],
}

impl LodTable {
    /// E_ind after bounce `number`, W·m⁻² by slot: of clusters that are not due as it was, of rows that are left out the mean of
    /// their stand-ins.
    pub(in crate::relight) fn bounce(
        &self,
        parallel: &impl Parallel,
        (clusters, receivers): (&ClusterTable, &ReceiverTable),
        plan: &LodPlan,
        arrays: BounceArrays<'_>,
        number: u32,
    ) -> Vec<Vec4> {
        let computed = parallel.map(clusters.clusters.len(), |index| {
            let (cluster, detail) = (&clusters.clusters[index], &plan.details[index]);
            if !detail.is_due(index, number) {
                return Vec::new();
            }
            let b = clusters.basis_of(cluster, detail, arrays.lambda);
            let order = &self.order[cluster.rows()][..detail.rows as usize];
            let at = |&row: &u32| {
                let slot = cluster.first_row + row as usize;
                let sum = clusters.row_of(cluster, row as usize, &b, arrays.near[slot]);
                (slot, sum.max(-arrays.emit[slot]))
            };
            order.iter().map(at).collect()
        });
        let mut ind = arrays.ind.to_vec();
        computed.into_iter().flatten().for_each(|(slot, light)| ind[slot] = light);
        for (level, stand_ins) in self.stand_ins.iter().enumerate().rev() {
            // Stand-ins are of higher levels: none of them changes with the others of this one.
            let filled = parallel.map(stand_ins.len(), |index| {
                let stand_in = &stand_ins[index];
                filled((plan, level), stand_in, receivers, &ind, number).map(|light| {
                    let slot = stand_in.slot as usize;
                    (slot, light.max(-arrays.emit[slot]))
                })
            });
            filled.into_iter().flatten().for_each(|(slot, light)| ind[slot] = light);
        }
        ind
    }
}

/// Light of a receiver with its stand-ins' share in it; `None` where they have none.
pub(super) fn filled(
    (plan, level): (&LodPlan, usize),
    stand_in: &StandIn,
    receivers: &ReceiverTable,
    ind: &[Vec4],
    number: u32,
) -> Option<Vec4> {
    let detail = &plan.details[stand_in.cluster as usize];
    if !detail.is_due(stand_in.cluster as usize, number) {
        return None;
    }
    let slot = stand_in.slot as usize;
    let share = match detail.level as usize > level {
        true => 1.0,
        false => plan.share(level, receivers.position_m[slot].truncate()),
    };
    if share <= 0.0 {
        return None;
    }
    let from = stand_in.sources.iter().take_while(|from| **from != NO_STAND_IN);
    let (sum, count) =
        from.fold((Vec4::ZERO, 0.0), |(sum, count), &from| (sum + ind[from as usize], count + 1.0));
    let mean = sum / count;
    Some(if share >= 1.0 { mean } else { ind[slot].lerp(mean, share) })
}
