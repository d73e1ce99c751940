//! How work over rows is spread: this crate runs no threads, callers bring theirs.

/// Runs work that falls into independent items.
pub trait Parallel: Sync {
    /// `each(0), …, each(count − 1)`, in this order.
    fn map<T: Send>(&self, count: usize, each: impl Fn(usize) -> T + Send + Sync) -> Vec<T>;
}

/// One item after the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Serial;

impl Parallel for Serial {
    fn map<T: Send>(&self, count: usize, each: impl Fn(usize) -> T + Send + Sync) -> Vec<T> {
        (0..count).map(each).collect()
    }
}
