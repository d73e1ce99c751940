//! The bytes behind buffers and buffer views, each range checked before it is used.

use std::borrow::Cow;
use std::collections::BTreeMap;

use gltf::json::buffer::View;
use gltf::json::{Accessor, Index, Root};

use super::Opening;
use super::bundle::Bundle;
use super::document::{self, buffer_place};
use super::error::{ImportError, Result};
use super::limits::{self, Budget, Limits};
use super::uri::{self, Uri};
use super::{draco, meshopt};

/// Every buffer's bytes, or `None` for the stand-ins of compressed views, which have none.
pub(super) struct Buffers<'a> {
    root: &'a Root,
    limits: &'a Limits,
    loaded: Vec<Option<Cow<'a, [u8]>>>,
    /// Views that were compressed, by index.
    views: BTreeMap<usize, Vec<u8>>,
    /// Elements of accessors whose mesh was compressed as a whole, packed, by index.
    accessors: BTreeMap<usize, Vec<u8>>,
}

impl<'a> Buffers<'a> {
    /// Finds the bytes of all buffers: the GLB's chunk, data URIs or files of the bundle; decompresses what meshes and
    /// images read, and animations where they are to be played.
    ///
    /// Errors on a missing file, a broken data URI, on fewer bytes than a buffer states, and on compressed bytes that do
    /// not decode to what is stated.
    pub(super) fn load(
        root: &'a Root,
        bin: Option<&'a [u8]>,
        bundle: &'a Bundle,
        limits: &'a Limits,
        opening: Opening,
    ) -> Result<Self> {
        let load_one = |index| load_buffer(root, index, bin, bundle);
        let loaded = (0..root.buffers.len()).map(load_one).collect::<Result<_, _>>()?;
        let mut buffers = Self { root, limits, loaded, views: BTreeMap::new(), accessors: BTreeMap::new() };
        let mut budget = Budget::new(limits::DECODED_BYTES, limits.decoded_bytes);
        buffers.views = meshopt::decode_views(root, &buffers, opening, &mut budget)?;
        buffers.accessors = draco::decode_primitives(root, &buffers, &mut budget)?;
        Ok(buffers)
    }

    /// Limits of the import.
    pub(super) fn limits(&self) -> &Limits {
        self.limits
    }

    /// Whether a buffer is more than a stand-in for compressed views.
    pub(super) fn has_bytes(&self, buffer: Index<gltf::json::Buffer>) -> bool {
        self.loaded.get(buffer.value()).is_some_and(Option::is_some)
    }

    /// The packed elements of an accessor whose mesh was compressed.
    pub(super) fn unpacked(&self, index: Index<Accessor>) -> Option<&[u8]> {
        self.accessors.get(&index.value()).map(Vec::as_slice)
    }

    /// The bytes of a view; `place` is who reads it.
    pub(super) fn view(&self, index: Index<View>, place: &dyn Fn() -> String) -> Result<&[u8]> {
        let view = document::get(self.root, index, "buffer view", place)?;
        if let Some(decoded) = self.views.get(&index.value()) {
            return Ok(decoded);
        }
        let in_view = || format!("buffer view {} of {}", index.value(), place());
        let range = (view.byte_offset.unwrap_or_default().0, view.byte_length.0);
        self.range(view.buffer, range, &in_view)
    }

    /// Bytes of a buffer from an offset on, as many as a length says; `place` is who reads them.
    pub(super) fn range(
        &self,
        buffer: Index<gltf::json::Buffer>,
        (offset, length): (u64, u64),
        place: &dyn Fn() -> String,
    ) -> Result<&[u8]> {
        document::get(self.root, buffer, "buffer", place)?;
        let Some(bytes) = self.loaded[buffer.value()].as_deref() else {
            let problem = "it has no bytes of its own, and the view does not say how they are compressed";
            let place = buffer_place(self.root, buffer.value());
            return Err(ImportError::Buffer { place, problem: problem.to_owned() });
        };
        slice(bytes, offset, length).ok_or_else(|| {
            let problem =
                format!("it spans {length} bytes from {offset}, but its buffer has {}", bytes.len());
            ImportError::Buffer { place: place(), problem }
        })
    }
}

/// `bytes[offset..offset + length]`, or `None` if that is not all there.
pub(super) fn slice(bytes: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let start = usize::try_from(offset).ok()?;
    let end = usize::try_from(offset.checked_add(length)?).ok()?;
    bytes.get(start..end)
}

fn load_buffer<'a>(
    root: &'a Root,
    index: usize,
    bin: Option<&'a [u8]>,
    bundle: &'a Bundle,
) -> Result<Option<Cow<'a, [u8]>>> {
    let buffer = &root.buffers[index];
    let place = || buffer_place(root, index);
    let bytes = match &buffer.uri {
        Some(uri) => match read_uri(uri, place(), bundle) {
            // A fallback beside the file that did not come with it.
            Err(ImportError::MissingFile { .. }) if is_compression_stand_in(buffer) => return Ok(None),
            bytes => bytes?,
        },
        // Compressed views point to a buffer without bytes; it is an error only if someone reads it.
        None if is_compression_stand_in(buffer) => return Ok(None),
        None => match bin {
            Some(bin) if index == 0 => Cow::Borrowed(bin),
            _ => {
                let problem = "it has neither a URI nor a GLB chunk".to_owned();
                return Err(ImportError::Buffer { place: place(), problem });
            }
        },
    };
    if (bytes.len() as u64) < buffer.byte_length.0 {
        let problem = format!("it states {} bytes and has {}", buffer.byte_length.0, bytes.len());
        return Err(ImportError::Buffer { place: place(), problem });
    }
    Ok(Some(bytes))
}

/// Whether a buffer stands in for compressed views: it need not hold any bytes.
pub(super) fn is_compression_stand_in(buffer: &gltf::json::Buffer) -> bool {
    let Some(extensions) = &buffer.extensions else { return false };
    meshopt::EXTENSIONS.iter().any(|name| extensions.others.contains_key(*name))
}

/// The bytes that a URI of a buffer or image stands for.
pub(super) fn read_uri<'a>(uri: &str, place: String, bundle: &'a Bundle) -> Result<Cow<'a, [u8]>> {
    match uri::classify(uri) {
        Uri::Data(rest) => match uri::decode_data(rest) {
            Ok(bytes) => Ok(Cow::Owned(bytes)),
            Err(problem) => Err(ImportError::DataUri { place, problem }),
        },
        Uri::Remote => {
            let problem = "is not a file beside the glTF";
            Err(ImportError::OutsidePath { place, uri: super::error::shown(uri), problem })
        }
        Uri::File(name) => bundle.file(&place, name).map(Cow::Borrowed),
    }
}
