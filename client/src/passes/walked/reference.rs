//! Light of walks, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::WalkedTable;

use crate::threads::Threads;

/// `N(r) += w Σ ±λ` in an array by slot, as [`WalkedTable::gather`].
pub fn walked(table: &WalkedTable, lambda: &[Vec4], by_slot: &mut [Vec4]) {
    table.gather(&Threads, lambda, by_slot);
}
