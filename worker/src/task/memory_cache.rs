//! Decoded artefacts kept in memory between tasks, by digest.

use std::any::{Any, TypeId};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lightkiln_proto::ids::Digest;

type Key = (Digest, TypeId);
type Value = Arc<dyn Any + Send + Sync>;

/// Byte-bounded cache of decoded artefacts; the least recently used one goes first.
///
/// The same digest may be held as several types. A value in use stays alive after it was dropped from the cache.
#[derive(Debug)]
pub struct MemoryCache {
    bytes_max: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    entries: BTreeMap<Key, Entry>,
    bytes: usize,
    uses: u64,
}

#[derive(Debug)]
struct Entry {
    slot: Arc<Slot>,
    bytes: usize,
    last_use: u64,
}

/// Holds a value once one caller has decoded it; the others wait on the lock meanwhile.
#[derive(Debug, Default)]
struct Slot(Mutex<Option<Value>>);

impl MemoryCache {
    /// An empty cache that keeps at most `bytes_max` bytes, by the sizes that [`get_or_insert`](Self::get_or_insert)
    /// is told.
    pub fn new(bytes_max: usize) -> Self {
        Self { bytes_max, state: Mutex::default() }
    }

    /// The value of `digest` as a `T`; `decode` gives it and its size in bytes if it is not held.
    ///
    /// Callers that ask for the same digest at the same time wait for one decoding. So ask before a parallel loop, not
    /// inside one: a rayon thread that waits here may hold the work that the decoding waits for. An error is given to
    /// the caller whose `decode` it was and nothing is kept.
    pub fn get_or_insert<T, E>(
        &self,
        digest: Digest,
        decode: impl FnOnce() -> Result<(T, usize), E>,
    ) -> Result<Arc<T>, E>
    where
        T: Any + Send + Sync,
    {
        let key = (digest, TypeId::of::<T>());
        let slot = self.slot(key);
        let mut held = lock(&slot.0);
        if let Some(value) = held.clone().and_then(|value| value.downcast::<T>().ok()) {
            return Ok(value);
        }
        match decode() {
            Ok((value, bytes)) => {
                let value = Arc::new(value);
                *held = Some(value.clone());
                drop(held);
                // A value without size would never be dropped.
                self.account(key, &slot, bytes.max(1));
                Ok(value)
            }
            Err(error) => {
                drop(held);
                self.forget_if_empty(key, &slot);
                Err(error)
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        lock(&self.state).bytes
    }

    fn slot(&self, key: Key) -> Arc<Slot> {
        let mut state = lock(&self.state);
        state.uses += 1;
        let last_use = state.uses;
        let entry =
            state.entries.entry(key).or_insert_with(|| Entry { slot: Arc::default(), bytes: 0, last_use });
        entry.last_use = last_use;
        entry.slot.clone()
    }

    fn account(&self, key: Key, slot: &Arc<Slot>, bytes: usize) {
        let mut state = lock(&self.state);
        match state.entries.get_mut(&key) {
            Some(entry) if Arc::ptr_eq(&entry.slot, slot) => entry.bytes = bytes,
            _ => return,
        }
        state.bytes += bytes;
        while state.bytes > self.bytes_max {
            // Entries still being decoded count nothing yet: dropping them would free nothing.
            let filled = state.entries.iter().filter(|(_, entry)| entry.bytes > 0);
            let Some(oldest) = filled.min_by_key(|(_, entry)| entry.last_use).map(|(key, _)| *key) else {
                break;
            };
            if let Some(entry) = state.entries.remove(&oldest) {
                state.bytes -= entry.bytes;
            }
        }
    }

    /// Drops the entry unless another caller has filled it or is about to.
    fn forget_if_empty(&self, key: Key, slot: &Arc<Slot>) {
        let mut state = lock(&self.state);
        let unused = state
            .entries
            .get(&key)
            // Two references are this call's and the map's own.
            .is_some_and(|entry| Arc::ptr_eq(&entry.slot, slot) && Arc::strong_count(slot) == 2);
        if unused && state.entries.get(&key).is_some_and(|entry| entry.bytes == 0) {
            state.entries.remove(&key);
        }
    }
}

/// A panic while the lock was held leaves the state whole: every change under it is complete or absent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::Barrier;
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    fn held(cache: &MemoryCache, name: &str) -> bool {
        let mut was_held = true;
        let decode = || {
            was_held = false;
            Err::<(String, usize), ()>(())
        };
        let _ = cache.get_or_insert::<String, ()>(Digest::of(name.as_bytes()), decode);
        was_held
    }

    fn put(cache: &MemoryCache, name: &str, bytes: usize) -> Arc<String> {
        let decode = || Ok::<_, Infallible>((name.to_owned(), bytes));
        cache.get_or_insert(Digest::of(name.as_bytes()), decode).unwrap()
    }

    #[test]
    fn least_recently_used_value_goes_first_when_the_bytes_are_used_up() {
        let cache = MemoryCache::new(100);
        put(&cache, "a", 40);
        put(&cache, "b", 40);
        put(&cache, "a", 40);
        put(&cache, "c", 40);
        assert_eq!((held(&cache, "a"), held(&cache, "b"), held(&cache, "c")), (true, false, true));
        assert_eq!(cache.bytes(), 80);
    }

    #[test]
    fn value_larger_than_the_cache_is_given_but_not_kept() {
        let cache = MemoryCache::new(10);
        assert_eq!(*put(&cache, "big", 11), "big");
        assert!(!held(&cache, "big"));
        assert_eq!(cache.bytes(), 0);
    }

    #[test]
    fn failed_decoding_is_tried_again_by_the_next_caller() {
        let cache = MemoryCache::new(10);
        let digest = Digest::of(b"a");
        assert_eq!(cache.get_or_insert::<u32, &str>(digest, || Err("no")), Err("no"));
        assert_eq!(cache.get_or_insert::<u32, &str>(digest, || Ok((7, 4))), Ok(Arc::new(7)));
    }

    #[test]
    fn one_digest_is_held_as_several_types() {
        let cache = MemoryCache::new(100);
        let digest = Digest::of(b"a");
        let number = cache.get_or_insert(digest, || Ok::<_, Infallible>((7_u32, 4))).unwrap();
        let text = cache.get_or_insert(digest, || Ok::<_, Infallible>(("seven", 5))).unwrap();
        assert_eq!((*number, *text), (7, "seven"));
    }

    #[test]
    fn callers_of_one_digest_at_one_time_decode_once() {
        let cache = MemoryCache::new(100);
        let decodings = AtomicU32::new(0);
        let start = Barrier::new(8);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    start.wait();
                    let decode = || {
                        decodings.fetch_add(1, Ordering::Relaxed);
                        Ok::<_, Infallible>((1_u8, 1))
                    };
                    cache.get_or_insert(Digest::of(b"shared"), decode).unwrap();
                });
            }
        });
        assert_eq!(decodings.load(Ordering::Relaxed), 1);
    }
}
