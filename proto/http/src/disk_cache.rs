//! Fetched bytes, kept on disk between runs by their digest: artefacts of workers, chunks of clients. Several processes may share one
//! folder.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use lightkiln_proto::ids::Digest;

/// An unfinished write older than this was left behind by a process that died.
const STALE_WRITE: Duration = Duration::from_secs(3600);

/// Extension of files that hold the first bytes of a digest's.
const PREFIX: &str = "prefix";

/// Size-bounded cache of files by digest; the least recently used ones go first.
#[derive(Debug)]
pub struct DiskCache {
    folder: PathBuf,
    bytes_max: u64,
    /// Bytes in the folder as far as this process knows; measured anew when it passes the bound.
    bytes_estimate: AtomicU64,
    writes: AtomicU64,
}

impl DiskCache {
    /// Opens `folder`, making it if need be, and keeps at most about `bytes_max` bytes in it.
    pub fn open(folder: &Path, bytes_max: u64) -> io::Result<Self> {
        fs::create_dir_all(folder.join("writes"))?;
        let cache = Self {
            folder: folder.to_owned(),
            bytes_max,
            bytes_estimate: AtomicU64::new(0),
            writes: AtomicU64::new(0),
        };
        cache.drop_stale_writes()?;
        let bytes = cache.files()?.iter().map(|file| file.bytes).sum();
        cache.bytes_estimate.store(bytes, Ordering::Relaxed);
        Ok(cache)
    }

    /// The bytes of a digest if they are here and whole; a damaged file is removed.
    pub fn get(&self, digest: Digest) -> Option<Vec<u8>> {
        let path = self.path(digest);
        let bytes = fs::read(&path).ok()?;
        if Digest::of(&bytes) != digest {
            tracing::warn!(path = %path.display(), "a cached file was damaged; it will be fetched again");
            let _ = fs::remove_file(&path);
            return None;
        }
        // The time of last use decides what goes first; a folder that forbids it only makes a worse choice.
        let _ =
            File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    /// The first bytes of a digest's, if some are here and `is_right` approves them; others are removed.
    pub fn get_prefix(&self, digest: Digest, is_right: impl FnOnce(&[u8]) -> bool) -> Option<Vec<u8>> {
        let path = self.prefix_path(digest);
        let bytes = fs::read(&path).ok()?;
        if !is_right(&bytes) {
            tracing::warn!(path = %path.display(), "the begin of a cached file was damaged; it will be fetched again");
            let _ = fs::remove_file(&path);
            return None;
        }
        let _ =
            File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    /// Keeps bytes. A reader never sees half of it: it is written aside, then renamed.
    pub fn put(&self, digest: Digest, bytes: &[u8]) -> io::Result<()> {
        let path = self.path(digest);
        if path.exists() {
            return Ok(());
        }
        self.write(&path, bytes)?;
        // All of it is here: its begin is no use. The room that this makes is known when it is measured.
        let _ = fs::remove_file(self.prefix_path(digest));
        Ok(())
    }

    /// Keeps the first bytes of a digest's in place of those that are here.
    pub fn put_prefix(&self, digest: Digest, bytes: &[u8]) -> io::Result<()> {
        if self.path(digest).exists() {
            return Ok(());
        }
        self.write(&self.prefix_path(digest), bytes)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let write = self.writes.fetch_add(1, Ordering::Relaxed);
        let aside = self.folder.join("writes").join(format!("{}-{write}", std::process::id()));
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let written = fs::write(&aside, bytes).and_then(|()| fs::rename(&aside, path));
        if written.is_err() {
            let _ = fs::remove_file(&aside);
        }
        written?;
        let held = self.bytes_estimate.fetch_add(bytes.len() as u64, Ordering::Relaxed) + bytes.len() as u64;
        if held > self.bytes_max { self.evict() } else { Ok(()) }
    }

    fn path(&self, digest: Digest) -> PathBuf {
        let name = digest.to_string();
        self.folder.join(&name[..2]).join(name)
    }

    fn prefix_path(&self, digest: Digest) -> PathBuf {
        self.path(digest).with_extension(PREFIX)
    }

    /// Removes files until a tenth of the room is free again, so that not every write has to look.
    fn evict(&self) -> io::Result<()> {
        let mut files = self.files()?;
        files.sort_by_key(|file| file.used);
        let mut held: u64 = files.iter().map(|file| file.bytes).sum();
        let wanted = self.bytes_max / 10 * 9;
        for file in files {
            if held <= wanted {
                break;
            }
            // Another process may have removed it first: gone either way.
            if fs::remove_file(&file.path).is_ok() || !file.path.exists() {
                held -= file.bytes;
            }
        }
        self.bytes_estimate.store(held, Ordering::Relaxed);
        Ok(())
    }

    /// Files of the cache: others in the folder are not its own, and are left alone.
    fn files(&self) -> io::Result<Vec<CachedFile>> {
        let mut files = Vec::new();
        for folder in fs::read_dir(&self.folder)?.flatten() {
            if folder.file_name().len() != 2 {
                continue;
            }
            let Ok(entries) = fs::read_dir(folder.path()) else { continue };
            for entry in entries.flatten() {
                let name = entry.file_name();
                let name = name.to_str().unwrap_or_default();
                let stem = name.strip_suffix(PREFIX).and_then(|name| name.strip_suffix('.')).unwrap_or(name);
                let digest = stem.parse::<Digest>().ok();
                let is_own = digest.is_some_and(|digest| {
                    [self.path(digest), self.prefix_path(digest)].contains(&entry.path())
                });
                let Some(metadata) = entry.metadata().ok().filter(|_| is_own) else { continue };
                let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                files.push(CachedFile { path: entry.path(), bytes: metadata.len(), used });
            }
        }
        Ok(files)
    }

    fn drop_stale_writes(&self) -> io::Result<()> {
        for entry in fs::read_dir(self.folder.join("writes"))?.flatten() {
            // Names of processes and their writes; others are not the cache's own.
            let name = entry.file_name();
            let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
            let of_two = name.to_str().and_then(|name| name.split_once('-'));
            if !of_two.is_some_and(|(process, write)| is_number(process) && is_number(write)) {
                continue;
            }
            let age = entry.metadata().and_then(|metadata| metadata.modified()).map(|time| time.elapsed());
            if matches!(age, Ok(Ok(age)) if age > STALE_WRITE) {
                let _ = fs::remove_file(entry.path());
            }
        }
        Ok(())
    }
}

#[derive(Debug)]
struct CachedFile {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn digest(name: &str) -> Digest {
        Digest::of(name.as_bytes())
    }

    /// Sets the time of last use, as file times are too coarse to tell two uses in a row apart.
    fn used_at(cache: &DiskCache, name: &str, secs: u64) {
        let file = File::options().append(true).open(cache.path(digest(name))).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(secs)).unwrap();
    }

    #[test]
    fn bytes_survive_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        DiskCache::open(folder.path(), 100).unwrap().put(digest("a"), b"a").unwrap();
        let again = DiskCache::open(folder.path(), 100).unwrap();
        assert_eq!(again.get(digest("a")), Some(b"a".to_vec()));
        assert_eq!(again.get(digest("b")), None);
    }

    #[test]
    fn damaged_file_is_not_given_and_makes_room_for_a_new_one() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path(), 100).unwrap();
        cache.put(digest("a"), b"a").unwrap();
        fs::write(cache.path(digest("a")), b"b").unwrap();
        assert_eq!(cache.get(digest("a")), None);
        cache.put(digest("a"), b"a").unwrap();
        assert_eq!(cache.get(digest("a")), Some(b"a".to_vec()));
    }

    #[test]
    fn first_bytes_are_kept_until_all_are_there_and_given_only_as_their_reader_approves() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path(), 100).unwrap();
        let digest = digest("abcd");
        cache.put_prefix(digest, b"ab").unwrap();
        assert_eq!(cache.get(digest), None, "a begin is not the whole");
        assert_eq!(cache.get_prefix(digest, |bytes| bytes == b"ab"), Some(b"ab".to_vec()));
        cache.put_prefix(digest, b"abc").unwrap();
        assert_eq!(cache.files().unwrap().len(), 1, "it counts, once");
        assert_eq!(cache.get_prefix(digest, |bytes| bytes == b"ab"), None);
        assert_eq!(cache.get_prefix(digest, |_| true), None, "a refused one is gone");
        cache.put_prefix(digest, b"abc").unwrap();
        cache.put(digest, b"abcd").unwrap();
        assert_eq!((cache.get(digest), cache.get_prefix(digest, |_| true)), (Some(b"abcd".to_vec()), None));
        cache.put_prefix(digest, b"abc").unwrap();
        assert_eq!(cache.get_prefix(digest, |_| true), None, "the whole is there");
    }

    #[test]
    fn least_recently_used_files_go_when_the_room_is_used_up() {
        let folder = tempfile::tempdir().unwrap();
        let cache = DiskCache::open(folder.path(), 10).unwrap();
        for (secs, name) in [(1, "aaaa"), (2, "bbbb")] {
            cache.put(digest(name), name.as_bytes()).unwrap();
            used_at(&cache, name, secs);
        }
        assert!(cache.get(digest("aaaa")).is_some());
        cache.put(digest("cccc"), b"cccc").unwrap();
        assert_eq!(cache.get(digest("bbbb")), None);
        assert!(cache.get(digest("aaaa")).is_some() && cache.get(digest("cccc")).is_some());
    }

    #[test]
    fn files_of_others_in_the_folder_are_neither_counted_nor_removed() {
        let folder = tempfile::tempdir().unwrap();
        let others = ["db/table", "writes/letter.txt", "ab/notes"].map(|name| folder.path().join(name));
        let old = SystemTime::now() - 2 * STALE_WRITE;
        for path in &others {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, [0; 100]).unwrap();
            File::options().append(true).open(path).unwrap().set_modified(old).unwrap();
        }
        let cache = DiskCache::open(folder.path(), 10).unwrap();
        cache.put(digest("aaaa"), b"aaaa").unwrap();
        assert!(cache.get(digest("aaaa")).is_some(), "others take none of its room");
        for name in ["bbbb", "cccc", "dddd"] {
            cache.put(digest(name), name.as_bytes()).unwrap();
        }
        assert!(others.iter().all(|path| path.exists()));
    }

    #[test]
    fn unfinished_write_of_a_dead_process_is_cleared_away() {
        let folder = tempfile::tempdir().unwrap();
        let aside = folder.path().join("writes");
        fs::create_dir_all(&aside).unwrap();
        fs::write(aside.join("1-0"), b"half").unwrap();
        let old = SystemTime::now() - 2 * STALE_WRITE;
        File::options().append(true).open(aside.join("1-0")).unwrap().set_modified(old).unwrap();
        fs::write(aside.join("2-0"), b"under way").unwrap();
        DiskCache::open(folder.path(), 100).unwrap();
        assert!(!aside.join("1-0").exists() && aside.join("2-0").exists());
    }
}
