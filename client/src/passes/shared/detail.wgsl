// The part of each cluster that bounces compute; joined in front of the passes that ask for it. Twin: `Detail` of the contract.

struct Detail {
    first_row: u32,
    row_count: u32,
    // Rows that are computed: the first of the cluster's order.
    rows: u32,
    // Columns of each class that count: the first.
    wide: u32,
    bytes: u32,
    rest: u32,
    // Groups of ranks that count.
    groups: u32,
    // Receivers below this level are left out.
    level: u32,
    // Bounces from one that the cluster takes part in to the next, a power of two.
    interval: u32,
}

struct Turn {
    // Number of the bounce.
    bounce: u32,
    // Clusters, and those in a row of a dispatch over all.
    cluster_count: u32,
    stride: u32,
}

// Whether a cluster takes part in a bounce.
fn is_due(interval: u32, index: u32, bounce: u32) -> bool {
    return (bounce + index) % interval == 0u;
}

