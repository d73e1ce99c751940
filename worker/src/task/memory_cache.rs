//! Decoded artefacts kept in memory between tasks, by digest.

use std::any::{Any, TypeId};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use lightkiln_proto::ids::Digest;

type Value = Arc<dyn Any + Send + Sync>;
/// Holds a value once one caller has decoded it; the others wait on the lock meanwhile.
type Slot = Mutex<Option<Value>>;

/// Byte-bounded cache of decoded artefacts; the least recently used one goes first.
///
/// The same digest may be held as several types. A value in use stays alive after it was dropped from the cache.
///
/// We differ from `moka` and `quick_cache`, which are made for many small values: the former gives the error of the task
/// that decodes, its cancellation among them, to the tasks that wait; the latter admits no value of half the room.
#[derive(Debug)]
pub struct MemoryCache {
    bytes_max: usize,
    /// The least recently used first.
    entries: Mutex<Vec<Entry>>,
}

#[derive(Debug)]
struct Entry {
    key: (Digest, TypeId),
    slot: Arc<Slot>,
    /// 0 until the value is decoded.
    bytes: usize,
}

impl MemoryCache {
    /// An empty cache that keeps at most `bytes_max` bytes, by the sizes that [`get_or_insert`](Self::get_or_insert)
    /// is told.
    pub fn new(bytes_max: usize) -> Self {
        Self { bytes_max, entries: Mutex::default() }
    }

    /// The value of `digest` as a `T`; `decode` gives it and its size in bytes if it is not held.
    ///
    /// Callers that ask for the same digest at the same time wait for one decoding. So ask before a parallel loop, not
    /// inside one: a rayon thread that waits here may hold the work that the decoding waits for. An error is given to
    /// the caller whose `decode` it was, and the next in line decodes.
    pub fn get_or_insert<T, E>(
        &self,
        digest: Digest,
        decode: impl FnOnce() -> Result<(T, usize), E>,
    ) -> Result<Arc<T>, E>
    where
        T: Any + Send + Sync,
    {
        let slot = self.slot((digest, TypeId::of::<T>()));
        let mut held = lock(&slot);
        if let Some(value) = held.clone().and_then(|value| value.downcast::<T>().ok()) {
            return Ok(value);
        }
        let (value, bytes) = decode()?;
        let value = Arc::new(value);
        *held = Some(value.clone());
        drop(held);
        self.account(&slot, bytes);
        Ok(value)
    }

    /// Drops every value that is not in use.
    pub fn clear(&self) {
        lock(&self.entries).clear();
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        lock(&self.entries).iter().map(|entry| entry.bytes).sum()
    }

    /// The slot of `key`, from now on the most recently used.
    fn slot(&self, key: (Digest, TypeId)) -> Arc<Slot> {
        let mut entries = lock(&self.entries);
        let entry = match entries.iter().position(|entry| entry.key == key) {
            Some(index) => entries.remove(index),
            None => Entry { key, slot: Arc::default(), bytes: 0 },
        };
        let slot = entry.slot.clone();
        entries.push(entry);
        slot
    }

    /// Counts a decoded value, and drops others until there is room.
    fn account(&self, slot: &Arc<Slot>, bytes: usize) {
        let mut entries = lock(&self.entries);
        // Slots whose decoding failed and that nobody waits for.
        entries.retain(|entry| entry.bytes > 0 || Arc::strong_count(&entry.slot) > 1);
        if let Some(entry) = entries.iter_mut().find(|entry| Arc::ptr_eq(&entry.slot, slot)) {
            // A value without size would never be dropped.
            entry.bytes = bytes.max(1);
        }
        let mut held: usize = entries.iter().map(|entry| entry.bytes).sum();
        entries.retain(|entry| {
            let goes = held > self.bytes_max && entry.bytes > 0;
            held -= if goes { entry.bytes } else { 0 };
            !goes
        });
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
