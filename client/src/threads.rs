//! Work over rows, on all of the processor's threads.

use lightkiln_proto::relight::Parallel;
use rayon::prelude::*;

/// Rayon's threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Threads;

impl Parallel for Threads {
    fn map<T: Send>(&self, count: usize, each: impl Fn(usize) -> T + Send + Sync) -> Vec<T> {
        (0..count).into_par_iter().map(each).collect()
    }
}
