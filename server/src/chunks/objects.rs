//! Chunks in an object store: local files, S3.

use std::ffi::OsString;
use std::io;
use std::ops::Range;
use std::path::Path as FilePath;
use std::sync::Arc;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{StreamExt, TryStreamExt};
use lightkiln_proto::ids::Digest;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{GetOptions, GetRange, ObjectStore, ObjectStoreExt, PutPayload, WriteMultipart};

use super::{ByteStream, ChunkError, ChunkName, ChunkStore, Listed, Result, Stored, s3};
use crate::places::ChunksPlace;

/// Size of the parts in which a stream is written.
const PART_BYTES: usize = 8 << 20;
/// Parts of one stream that are being written at a time.
const PARTS_IN_FLIGHT: usize = 2;
/// Streams up to this size are written in one piece.
const ONE_PIECE_BYTES: usize = PART_BYTES;

/// Chunks at `ab/cdef….GENERATION` (digest and generation in hex; generation 0 is left out) in an object store.
pub struct ObjectChunks {
    objects: Arc<dyn ObjectStore>,
}

impl ObjectChunks {
    /// Opens the store at a place.
    pub fn open(place: &ChunksPlace) -> Result<Self> {
        match place {
            ChunksPlace::Folder(folder) => Self::in_folder(folder),
            ChunksPlace::S3 { bucket, prefix } => {
                let text = |(name, value): (OsString, OsString)| {
                    Some((name.into_string().ok()?, value.into_string().ok()?))
                };
                Self::in_s3(bucket, prefix, std::env::vars_os().filter_map(text))
            }
        }
    }

    /// Chunks as objects of an S3 bucket, with keys that begin with `prefix`.
    ///
    /// `settings` are the usual variables and their values: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`,
    /// `AWS_REGION`, `AWS_ENDPOINT_URL` and so on.
    pub fn in_s3(
        bucket: &str,
        prefix: &str,
        settings: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Self> {
        Ok(Self::over(s3::open(bucket, prefix, settings)?))
    }

    /// Chunks in any object store.
    pub fn over(objects: Arc<dyn ObjectStore>) -> Self {
        Self { objects }
    }

    /// Chunks as files under `folder`, which is made if need be.
    ///
    /// A file appears under its name only when it is whole, and both it and its folder are flushed to disk first.
    pub fn in_folder(folder: &FilePath) -> Result<Self> {
        let unavailable = |source: io::Error| object_store::Error::Generic {
            store: "LocalFileSystem",
            source: source.into(),
        };
        std::fs::create_dir_all(folder).map_err(unavailable)?;
        let files = LocalFileSystem::new_with_prefix(folder)?;
        Ok(Self { objects: Arc::new(files.with_fsync(true)) })
    }

    /// Writes the rest of a stream in parts; `head` is its beginning.
    async fn put_parts(
        &self,
        name: ChunkName,
        head: Vec<u8>,
        mut bytes: ByteStream,
        mut check: StreamCheck,
    ) -> Result<Stored> {
        let upload = self.objects.put_multipart(&path_of(name)).await?;
        let mut upload = WriteMultipart::new_with_chunk_size(upload, PART_BYTES);
        upload.write(&head);
        drop(head);
        let written = async {
            while let Some(piece) = bytes.try_next().await? {
                check.take(&piece)?;
                upload.wait_for_capacity(PARTS_IN_FLIGHT).await?;
                upload.put(piece);
            }
            check.finish(name.digest)
        };
        match written.await {
            Ok(length) => {
                let is_new = self.head(name).await? != Some(length);
                upload.finish().await?;
                Ok(Stored { is_new, bytes: length })
            }
            Err(error) => {
                // Staged parts are invisible; failing to remove them changes nothing for the caller.
                let _ = upload.abort().await;
                Err(error)
            }
        }
    }
}

/// Digest and length of a stream as it passes.
pub(crate) struct StreamCheck {
    hasher: blake3::Hasher,
    length: u64,
    limit: u64,
}

impl StreamCheck {
    pub(crate) fn new(limit: u64) -> Self {
        Self { hasher: blake3::Hasher::new(), length: 0, limit }
    }

    pub(crate) fn take(&mut self, piece: &[u8]) -> Result<()> {
        self.length += piece.len() as u64;
        if self.length > self.limit {
            return Err(ChunkError::TooLarge { limit: self.limit });
        }
        self.hasher.update(piece);
        Ok(())
    }

    pub(crate) fn finish(&self, wanted: Digest) -> Result<u64> {
        let found = Digest(*self.hasher.finalize().as_bytes());
        if found != wanted {
            return Err(ChunkError::DigestMismatch { wanted, found });
        }
        Ok(self.length)
    }
}

#[async_trait]
impl ChunkStore for ObjectChunks {
    async fn put_if_absent(&self, name: ChunkName, bytes: Bytes) -> Result<Stored> {
        let found = Digest::of(&bytes);
        if found != name.digest {
            return Err(ChunkError::DigestMismatch { wanted: name.digest, found });
        }
        let length = bytes.len() as u64;
        if self.head(name).await? == Some(length) {
            return Ok(Stored { is_new: false, bytes: length });
        }
        self.objects.put(&path_of(name), PutPayload::from_bytes(bytes)).await?;
        Ok(Stored { is_new: true, bytes: length })
    }

    async fn put_stream(&self, name: ChunkName, mut bytes: ByteStream, limit: u64) -> Result<Stored> {
        let mut check = StreamCheck::new(limit);
        let mut head = Vec::new();
        while let Some(piece) = bytes.try_next().await? {
            check.take(&piece)?;
            head.extend_from_slice(&piece);
            if head.len() > ONE_PIECE_BYTES {
                return self.put_parts(name, head, bytes, check).await;
            }
        }
        let length = check.finish(name.digest)?;
        if self.head(name).await? == Some(length) {
            return Ok(Stored { is_new: false, bytes: length });
        }
        self.objects.put(&path_of(name), head.into()).await?;
        Ok(Stored { is_new: true, bytes: length })
    }

    async fn get(&self, name: ChunkName, limit: u64) -> Result<Bytes> {
        let found = self.objects.get(&path_of(name)).await.map_err(|error| missing(name.digest, error))?;
        if found.meta.size > limit {
            return Err(ChunkError::TooLarge { limit });
        }
        let bytes = found.bytes().await?;
        if Digest::of(&bytes) != name.digest {
            return Err(ChunkError::Damaged { digest: name.digest });
        }
        Ok(bytes)
    }

    async fn get_range(&self, name: ChunkName, range: Range<u64>) -> Result<ByteStream> {
        if range.is_empty() {
            return Ok(futures::stream::empty().boxed());
        }
        let options = GetOptions { range: Some(GetRange::Bounded(range.clone())), ..GetOptions::default() };
        let found = self.objects.get_opts(&path_of(name), options).await;
        let found = found.map_err(|error| missing(name.digest, error))?;
        let is_whole = range == (0..found.meta.size);
        let bytes = found.into_stream().map_err(ChunkError::from).boxed();
        Ok(if is_whole { verified(name.digest, bytes) } else { bytes })
    }

    async fn head(&self, name: ChunkName) -> Result<Option<u64>> {
        match self.objects.head(&path_of(name)).await {
            Ok(meta) => Ok(Some(meta.size)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    async fn delete(&self, name: ChunkName) -> Result<()> {
        match self.objects.delete(&path_of(name)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn list(&self) -> BoxStream<'static, Result<Listed>> {
        let chunk = |meta: object_store::ObjectMeta| {
            let name = name_of(&meta.location)?;
            Some(Listed { name, bytes: meta.size, written_ms: meta.last_modified.timestamp_millis() })
        };
        let listed = self.objects.list(None).map_err(ChunkError::from);
        listed.try_filter_map(move |meta| futures::future::ready(Ok(chunk(meta)))).boxed()
    }
}

/// Passes bytes on, always one piece behind: the last piece leaves only when the digest of all is right.
fn verified(digest: Digest, bytes: ByteStream) -> ByteStream {
    let start = (bytes, blake3::Hasher::new(), None::<Bytes>);
    let pieces = futures::stream::try_unfold(start, move |(mut bytes, mut hasher, mut held)| async move {
        while let Some(piece) = bytes.try_next().await? {
            hasher.update(&piece);
            if let Some(earlier) = held.replace(piece) {
                return Ok(Some((earlier, (bytes, hasher, held))));
            }
        }
        if Digest(*hasher.finalize().as_bytes()) != digest {
            return Err(ChunkError::Damaged { digest });
        }
        // The end is reached once more, with nothing held.
        Ok(held.take().map(|last| (last, (bytes, hasher, None))))
    });
    pieces.boxed()
}

fn path_of(name: ChunkName) -> Path {
    let hex = name.digest.to_string();
    let (shard, rest) = hex.split_at(2);
    match name.generation {
        0 => Path::from_iter([shard, rest]),
        generation => Path::from_iter([shard, &format!("{rest}.{generation:016x}")]),
    }
}

/// The name behind a path, if it is one that [`path_of`] gives.
fn name_of(path: &Path) -> Option<ChunkName> {
    let (shard, rest) = path.as_ref().split_once('/')?;
    let (rest, generation) = match rest.split_once('.') {
        None => (rest, 0),
        Some((rest, generation)) => (rest, u64::from_str_radix(generation, 16).ok()?),
    };
    let name = ChunkName { digest: format!("{shard}{rest}").parse().ok()?, generation };
    (path_of(name) == *path).then_some(name)
}

fn missing(digest: Digest, error: object_store::Error) -> ChunkError {
    match error {
        object_store::Error::NotFound { .. } => ChunkError::NotFound { digest },
        error => error.into(),
    }
}
