//! The bytes behind buffers and buffer views, each range checked before it is used.

use std::borrow::Cow;

use gltf::json::buffer::View;
use gltf::json::{Index, Root};

use super::bundle::Bundle;
use super::document::{self, buffer_place};
use super::error::{ImportError, Result};
use super::uri::{self, Uri};

/// Every buffer's bytes, or `None` for the stand-ins of compressed views, which have none.
pub(super) struct Buffers<'a> {
    root: &'a Root,
    loaded: Vec<Option<Cow<'a, [u8]>>>,
}

impl<'a> Buffers<'a> {
    /// Finds the bytes of all buffers: the GLB's chunk, data URIs or files of the bundle.
    ///
    /// Errors on a missing file, a broken data URI and on fewer bytes than a buffer states.
    pub(super) fn load(root: &'a Root, bin: Option<&'a [u8]>, bundle: &'a Bundle) -> Result<Self> {
        let load_one = |index| load_buffer(root, index, bin, bundle);
        let loaded = (0..root.buffers.len()).map(load_one).collect::<Result<_, _>>()?;
        Ok(Self { root, loaded })
    }

    /// The bytes of a view; `place` is who reads it.
    pub(super) fn view(&self, index: Index<View>, place: &dyn Fn() -> String) -> Result<&[u8]> {
        let view = document::get(self.root, index, "buffer view", place)?;
        let buffer_index = view.buffer.value();
        let in_view = || format!("buffer view {} of {}", index.value(), place());
        document::get(self.root, view.buffer, "buffer", in_view)?;
        let Some(bytes) = self.loaded[buffer_index].as_deref() else {
            let problem = "it has no bytes of its own, only compressed ones; export without mesh compression";
            let place = buffer_place(self.root, buffer_index);
            return Err(ImportError::Buffer { place, problem: problem.to_owned() });
        };
        let offset = view.byte_offset.unwrap_or_default().0;
        slice(bytes, offset, view.byte_length.0).ok_or_else(|| {
            let (length, found) = (view.byte_length.0, bytes.len());
            let problem = format!("it spans {length} bytes from {offset}, but its buffer has {found}");
            ImportError::Buffer { place: in_view(), problem }
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
        Some(uri) => read_uri(uri, place(), bundle)?,
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

fn is_compression_stand_in(buffer: &gltf::json::Buffer) -> bool {
    let Some(extensions) = &buffer.extensions else { return false };
    ["EXT_meshopt_compression", "KHR_meshopt_compression"]
        .iter()
        .any(|name| extensions.others.contains_key(*name))
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
