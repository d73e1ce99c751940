//! An upload: one glTF and the files that it names, in memory.

use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

use zip::ZipArchive;

use super::error::{ImportError, Result, shown};
use super::limits::{Budget, Limits, within};
use super::{glb, uri};

/// The signature of an entry in a zip's directory.
const ZIP_DIRECTORY_ENTRY: &[u8; 4] = b"PK\x01\x02";
/// Directory signatures that may turn up by chance inside compressed bytes before a zip counts as too big.
const CHANCE_SIGNATURES: u64 = 64;

/// A set of named files with one root glTF; nothing outside it is ever read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bundle {
    files: BTreeMap<String, Vec<u8>>,
    root: String,
}

impl Bundle {
    /// Opens an upload: a `.glb`, a `.gltf` with data URIs only, or a `.zip` with one of them and its files.
    ///
    /// The format is read from the bytes, not from a name. Errors if it is none of these, on a zip that is broken,
    /// unsafe or beyond the limits, and on a zip without exactly one glTF.
    pub fn from_bytes(bytes: Vec<u8>, limits: &Limits) -> Result<Self> {
        within("bytes in the upload", bytes.len() as u64, limits.bundle_bytes)?;
        match Format::of(&bytes).ok_or(ImportError::UnknownFormat)? {
            Format::Glb => Ok(Self::single("scene.glb", bytes)),
            Format::Gltf => Ok(Self::single("scene.gltf", bytes)),
            Format::Zip => from_zip(&bytes, limits),
        }
    }

    fn single(name: &str, bytes: Vec<u8>) -> Self {
        Self { files: BTreeMap::from([(name.to_owned(), bytes)]), root: name.to_owned() }
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
        match self.files.keys().find(same) {
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

fn from_zip(bytes: &[u8], limits: &Limits) -> Result<Bundle> {
    // The zip reader allocates for its whole directory before it says how long that is.
    let signatures = bytes.windows(4).filter(|window| window == ZIP_DIRECTORY_ENTRY).count() as u64;
    within("files in the zip", signatures, limits.files.saturating_add(CHANCE_SIGNATURES))?;
    let at_archive = |source| ImportError::Zip { place: "its directory".to_owned(), source };
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(at_archive)?;
    within("files in the zip", archive.len() as u64, limits.files)?;
    let mut budget = Budget::new("bytes in the zip once decompressed", limits.decompressed_bytes);
    let mut files = BTreeMap::new();
    for index in 0..archive.len() {
        let Some((name, content)) = read_entry(&mut archive, index, limits, &mut budget)? else { continue };
        if files.contains_key(&name) {
            return Err(ImportError::UnsafeEntry { name: shown(&name), problem: "the name is there twice" });
        }
        files.insert(name, content);
    }
    let root = find_root(&files)?;
    Ok(Bundle { files, root })
}

fn read_entry(
    archive: &mut ZipArchive<Cursor<&[u8]>>,
    index: usize,
    limits: &Limits,
    budget: &mut Budget,
) -> Result<Option<(String, Vec<u8>)>> {
    let at_index = |source| ImportError::Zip { place: format!("entry {index}"), source };
    let mut entry = archive.by_index(index).map_err(at_index)?;
    let name = entry.name().map_err(at_index)?.into_owned();
    let safe_name = checked_name(&name, limits)?;
    if entry.is_symlink() {
        return Err(ImportError::UnsafeEntry { name: shown(&name), problem: "it is a symbolic link" });
    }
    if entry.is_dir() || is_finder_litter(&safe_name) {
        return Ok(None);
    }
    // The stated size is not believed: reading stops one byte after the limit, whatever the entry says.
    let left = limits.decompressed_bytes.saturating_sub(budget.used());
    let mut content = Vec::new();
    let in_entry = |source| ImportError::ZipEntry { place: shown(&name), source };
    entry.by_ref().take(left.saturating_add(1)).read_to_end(&mut content).map_err(in_entry)?;
    budget.spend(content.len() as u64)?;
    Ok(Some((safe_name, content)))
}

fn checked_name(name: &str, limits: &Limits) -> Result<String> {
    let refuse = |problem| ImportError::UnsafeEntry { name: shown(name), problem };
    if name.split(['/', '\\']).any(|part| part == "..") {
        return Err(refuse("it climbs out of a folder"));
    }
    let path = uri::resolve("", name).map_err(refuse)?;
    within("nested folders in the zip", path.split('/').count() as u64, limits.path_depth)?;
    Ok(path)
}

/// macOS adds a shadow of each file to its zips, with the same ending.
fn is_finder_litter(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or(path);
    path.starts_with("__MACOSX/") || name.starts_with("._")
}

fn find_root(files: &BTreeMap<String, Vec<u8>>) -> Result<String> {
    let is_gltf = |name: &&String| {
        let lower = name.to_ascii_lowercase();
        lower.ends_with(".gltf") || lower.ends_with(".glb")
    };
    let roots: Vec<&String> = files.keys().filter(is_gltf).collect();
    match roots.as_slice() {
        [root] => Ok((*root).clone()),
        several => {
            let names: Vec<String> =
                several.iter().take(4).map(|name| format!("{:?}", shown(name))).collect();
            let names = if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) };
            Err(ImportError::RootCount { found: several.len(), names })
        }
    }
}
