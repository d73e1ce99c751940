//! The change of E_ind, on the processor.

use glam::Vec4;
use lightkiln_proto::relight::Settled;

/// Σ|E − E before| / Σ|E|, as [`Settled::change`].
pub fn change(before: &[Vec4], now: &[Vec4]) -> f32 {
    Settled::change(before, now)
}
