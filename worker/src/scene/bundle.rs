//! An upload: one glTF and the files that it names, in memory.

use std::collections::BTreeMap;

use super::error::{ImportError, Result, shown};
use super::limits::{self, Limits, within};
use super::{glb, unzip, uri};

/// A set of named files with one root glTF; nothing outside it is ever read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bundle {
    files: BTreeMap<String, Vec<u8>>,
    root: String,
    /// Names of files beside them that the glTF does not name.
    others: Vec<String>,
    /// Bytes of the upload.
    upload_bytes: u64,
}

impl Bundle {
    /// Opens an upload: a `.glb`, a `.gltf` with data URIs only, or a `.zip` with one of them and its files.
    ///
    /// The format is read from the bytes, not from a name. Errors if it is none of these, on a zip that is broken,
    /// unsafe or beyond the limits, and on a zip without exactly one glTF. Of a zip, only files that its glTF names are
    /// decompressed.
    pub fn from_bytes(bytes: Vec<u8>, limits: &Limits) -> Result<Self> {
        within(limits::UPLOAD_BYTES, bytes.len() as u64, limits.bundle_bytes)?;
        let upload_bytes = bytes.len() as u64;
        let bundle = match Format::of(&bytes).ok_or(ImportError::UnknownFormat)? {
            Format::Glb => Self::single("scene.glb", bytes),
            Format::Gltf => Self::single("scene.gltf", bytes),
            Format::Zip => unzip::open(&bytes, limits)?,
        };
        Ok(Self { upload_bytes, ..bundle })
    }

    /// Files of which `root` is the glTF, and the names of `others` that it does not name.
    pub(super) fn new(files: BTreeMap<String, Vec<u8>>, root: String, others: Vec<String>) -> Self {
        Self { files, root, others, upload_bytes: 0 }
    }

    /// Bytes of the upload that it came from.
    pub(super) fn upload_bytes(&self) -> u64 {
        self.upload_bytes
    }

    fn single(name: &str, bytes: Vec<u8>) -> Self {
        Self::new(BTreeMap::from([(name.to_owned(), bytes)]), name.to_owned(), Vec::new())
    }

    /// The glTF or GLB itself.
    pub(super) fn root_bytes(&self) -> &[u8] {
        self.files.get(&self.root).map_or(&[], Vec::as_slice)
    }

    /// The file that `uri` names, seen from the root; `place` is who asks.
    pub(super) fn file(&self, place: &str, uri: &str) -> Result<&[u8]> {
        let folder = uri::folder_of(&self.root);
        let decoded = uri::resolve(folder, &uri::decode_file(uri));
        let found = decoded.as_ref().ok().and_then(|path| self.files.get(path));
        // Some exporters do not escape '%', so the name as written is tried too.
        let as_written = || uri::resolve(folder, uri).ok().and_then(|path| self.files.get(&path));
        match (found.or_else(as_written), decoded) {
            (Some(bytes), _) => Ok(bytes),
            (None, Err(problem)) => {
                Err(ImportError::OutsidePath { place: place.to_owned(), uri: shown(uri), problem })
            }
            (None, Ok(path)) => Err(ImportError::MissingFile {
                place: place.to_owned(),
                uri: shown(uri),
                hint: self.similar_name(&path),
            }),
        }
    }

    fn similar_name(&self, path: &str) -> String {
        let same = |name: &&String| name.eq_ignore_ascii_case(path);
        match self.files.keys().chain(&self.others).find(same) {
            Some(name) => format!(" (there is {:?}: capitals matter)", shown(name)),
            None => String::new(),
        }
    }
}

/// The formats of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    /// Binary glTF.
    Glb,
    /// glTF JSON.
    Gltf,
    /// A zip archive.
    Zip,
}

impl Format {
    /// Tells the format by the first bytes.
    pub(super) fn of(bytes: &[u8]) -> Option<Self> {
        if glb::is_glb(bytes) {
            return Some(Self::Glb);
        }
        if bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"PK\x05\x06") {
            return Some(Self::Zip);
        }
        let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        let first = text.iter().find(|byte| !byte.is_ascii_whitespace())?;
        (*first == b'{').then_some(Self::Gltf)
    }
}
