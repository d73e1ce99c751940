//! A bounce in some detail, on the processor.

use lightkiln_proto::relight::{Columns, Incoming, Limit, LodPlan, LodTable, Settled, Transport};

use crate::threads::Threads;

/// Bounces in which the clusters that are due take part, as [`Transport::settle_in`].
pub fn settle<C: Columns>(
    transport: &Transport<C>,
    incoming: &Incoming<'_>,
    limit: Limit,
    detail: (&LodTable, &LodPlan),
) -> Settled {
    transport.settle_in(&Threads, incoming, limit, Some(detail))
}
