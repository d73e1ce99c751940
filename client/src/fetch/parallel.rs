//! Work on chunks at the same time: as much of it as a line or the processor takes, within a bound on bytes.

use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};

use lightkiln_http::CONNECTIONS;

use super::Source;
use crate::error::Result;

/// Most bytes of chunks under way at a time; a larger chunk goes alone. More → faster where chunks are large; more memory.
const BYTES_MAX: u64 = 256 << 20;

impl Source {
    /// Chunks that are worked on at the same time: those of a server wait for the line most of the time, those on disk for the
    /// processor, which decodes them.
    fn lanes(&self) -> usize {
        match self {
            Self::Bundle(_) => std::thread::available_parallelism().map_or(1, NonZero::get),
            Self::Server { .. } => CONNECTIONS,
        }
    }
}

/// Results of `work` on each of some chunks of a source, of so many bytes, a few at a time, in their order; the first error ends it, and
/// with it come the results that were there by then.
pub fn parallel<T: Send>(
    source: &Source,
    sizes: &[u64],
    work: impl Fn(usize) -> Result<T> + Sync,
) -> (Vec<Option<T>>, Result<()>) {
    let slots: Vec<Mutex<Option<T>>> = sizes.iter().map(|_| Mutex::new(None)).collect();
    let ended = for_each_parallel(source, sizes, |index| {
        let value = work(index)?;
        *slots[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(value);
        Ok(())
    });
    let values = slots.into_iter().map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner));
    (values.collect(), ended)
}

/// Runs `work` on each of some chunks of a source, of so many bytes, on a few threads; stops early at the first error and returns it.
pub fn for_each_parallel(
    source: &Source,
    sizes: &[u64],
    work: impl Fn(usize) -> Result<()> + Sync,
) -> Result<()> {
    let next = AtomicUsize::new(0);
    let failure = Mutex::new(None);
    let under_way = UnderWay::default();
    std::thread::scope(|scope| {
        for _ in 0..source.lanes().min(sizes.len()) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&bytes) = sizes.get(index) else { return };
                    let _entered = under_way.enter(bytes);
                    if let Err(error) = work(index) {
                        next.store(sizes.len(), Ordering::Relaxed);
                        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                        return;
                    }
                }
            });
        }
    });
    failure.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

/// Bytes of the chunks that are worked on.
#[derive(Default)]
struct UnderWay {
    bytes: Mutex<u64>,
    /// Told when there are fewer.
    fewer: Condvar,
}

impl UnderWay {
    /// Waits until there is room for so many more, which are there until the guard is dropped.
    fn enter(&self, bytes: u64) -> Entered<'_> {
        let is_full = |held: &mut u64| *held > 0 && held.saturating_add(bytes) > BYTES_MAX;
        let held = self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        let mut held = self.fewer.wait_while(held, is_full).unwrap_or_else(PoisonError::into_inner);
        *held += bytes;
        Entered { of: self, bytes }
    }
}

/// Bytes of a chunk that is worked on.
struct Entered<'a> {
    of: &'a UnderWay,
    bytes: u64,
}

impl Drop for Entered<'_> {
    fn drop(&mut self) {
        *self.of.bytes.lock().unwrap_or_else(PoisonError::into_inner) -= self.bytes;
        self.of.fewer.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::ApiClient;

    /// Most chunks of so many bytes that are worked on at the same time.
    fn most(bytes: u64) -> usize {
        let source = Source::server(ApiClient::new("http://127.0.0.1:1", None).unwrap(), "bake");
        let [there, most] = [0, 0].map(AtomicUsize::new);
        for_each_parallel(&source, &[bytes; 40], |_| {
            most.fetch_max(there.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            (0..100).for_each(|_| std::thread::yield_now());
            there.fetch_sub(1, Ordering::SeqCst);
            Ok(())
        })
        .unwrap();
        most.into_inner()
    }

    #[test]
    fn bytes_under_way_are_bounded_and_a_larger_chunk_goes_alone() {
        assert_eq!(most(BYTES_MAX + 1), 1);
        let few = most(BYTES_MAX / 3);
        assert!((1..=3).contains(&few), "{few}");
    }
}
