//! A zip opened: its directory is checked whole, and no byte is decompressed that the scene does not need.

use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

use gltf::json::Root;
use zip::ZipArchive;

use super::bundle::Bundle;
use super::error::{ImportError, Result, shown};
use super::limits::{self, Budget, Limits, within};
use super::{document, uri};

/// The signature of an entry in a zip's directory.
const ZIP_DIRECTORY_ENTRY: &[u8; 4] = b"PK\x01\x02";
/// Directory signatures that may turn up by chance inside compressed bytes before a zip counts as too big.
const CHANCE_SIGNATURES: u64 = 64;

/// Opens a zip.
///
/// The glTF is read first. It says which files it needs, and of a buffer how many bytes; all together stay below what
/// scenes of the upload's size decompress to.
pub(super) fn open(bytes: &[u8], limits: &Limits) -> Result<Bundle> {
    // The zip reader allocates for its whole directory before it says how long that is.
    let signatures = bytes.windows(4).filter(|window| window == ZIP_DIRECTORY_ENTRY).count() as u64;
    within(limits::ZIP_FILES, signatures, limits.files.saturating_add(CHANCE_SIGNATURES))?;
    let at_archive = |source| ImportError::Zip { place: "its directory".to_owned(), source };
    let archive = ZipArchive::new(Cursor::new(bytes)).map_err(at_archive)?;
    within(limits::ZIP_FILES, archive.len() as u64, limits.files)?;
    let budget = Budget::new(limits::ZIP_BYTES, limits.decompressed_bytes_of(bytes.len() as u64));
    let mut zip = Zip { archive, budget };
    let index_of = zip.directory(limits)?;
    let root = find_root(&index_of)?;
    let root_bytes = zip.read(index_of[&root], u64::MAX)?;
    let wanted = wanted_files(&root, &root_bytes, limits)?;
    let mut files = BTreeMap::new();
    let mut others = Vec::new();
    for (name, index) in index_of.into_iter().filter(|(name, _)| *name != root) {
        match wanted.get(&name) {
            Some(&needed) => drop(files.insert(name, zip.read(index, needed)?)),
            None => others.push(name),
        }
    }
    files.insert(root.clone(), root_bytes);
    Ok(Bundle::new(files, root, others))
}

/// Bytes needed of each file that a glTF may mean: names count both decoded and as they are written.
fn wanted_files(root: &str, root_bytes: &[u8], limits: &Limits) -> Result<BTreeMap<String, u64>> {
    let (gltf, _) = document::parse(root_bytes, limits)?;
    let folder = uri::folder_of(root);
    let mut wanted = BTreeMap::new();
    for (name, needed) in named_files(&gltf) {
        for path in [uri::resolve(folder, &uri::decode_file(name)), uri::resolve(folder, name)] {
            let Ok(path) = path else { continue };
            let most = wanted.entry(path).or_insert(0);
            *most = needed.max(*most);
        }
    }
    Ok(wanted)
}

/// The URIs of buffers with the bytes that are read of each, and those of images, read to their end.
fn named_files(gltf: &Root) -> impl Iterator<Item = (&str, u64)> {
    let buffers =
        gltf.buffers.iter().filter_map(|buffer| Some((buffer.uri.as_deref()?, buffer.byte_length.0)));
    let images = gltf.images.iter().filter_map(|image| Some((image.uri.as_deref()?, u64::MAX)));
    buffers.chain(images).filter(|(name, _)| matches!(uri::classify(name), uri::Uri::File(_)))
}

struct Zip<'a> {
    archive: ZipArchive<Cursor<&'a [u8]>>,
    budget: Budget,
}

impl Zip<'_> {
    /// The files by name, each with its place in the archive.
    fn directory(&mut self, limits: &Limits) -> Result<BTreeMap<String, usize>> {
        let mut index_of = BTreeMap::new();
        for index in 0..self.archive.len() {
            let at_index = |source| ImportError::Zip { place: format!("entry {index}"), source };
            let entry = self.archive.by_index(index).map_err(at_index)?;
            let name = entry.name().map_err(at_index)?.into_owned();
            let safe_name = checked_name(&name, limits)?;
            if entry.is_symlink() {
                return Err(ImportError::UnsafeEntry {
                    name: shown(&name),
                    problem: "it is a symbolic link",
                });
            }
            if entry.is_dir() || is_finder_litter(&safe_name) {
                continue;
            }
            if index_of.insert(safe_name, index).is_some() {
                return Err(ImportError::UnsafeEntry {
                    name: shown(&name),
                    problem: "the name is there twice",
                });
            }
        }
        Ok(index_of)
    }

    /// The first `needed` bytes of an entry, all if it has fewer.
    ///
    /// The stated size is not believed: reading stops one byte after the budget, whatever the entry says.
    fn read(&mut self, index: usize, needed: u64) -> Result<Vec<u8>> {
        let at_index = |source| ImportError::Zip { place: format!("entry {index}"), source };
        let entry = self.archive.by_index(index).map_err(at_index)?;
        let name = shown(&entry.name().map_err(at_index)?);
        let most = needed.min(self.budget.left().saturating_add(1));
        // Room at once: a list that doubles would hold half of it twice.
        let mut content = Vec::with_capacity(entry.size().min(most) as usize);
        let in_entry = |source| ImportError::ZipEntry { place: name, source };
        entry.take(most).read_to_end(&mut content).map_err(in_entry)?;
        self.budget.spend(content.len() as u64)?;
        Ok(content)
    }
}

fn checked_name(name: &str, limits: &Limits) -> Result<String> {
    let refuse = |problem| ImportError::UnsafeEntry { name: shown(name), problem };
    if name.split(['/', '\\']).any(|part| part == "..") {
        return Err(refuse("it climbs out of a folder"));
    }
    let path = uri::resolve("", name).map_err(refuse)?;
    within(limits::ZIP_FOLDERS, path.split('/').count() as u64, limits.path_depth)?;
    Ok(path)
}

/// macOS adds a shadow of each file to its zips, with the same ending.
fn is_finder_litter(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or(path);
    path.starts_with("__MACOSX/") || name.starts_with("._")
}

fn find_root(index_of: &BTreeMap<String, usize>) -> Result<String> {
    let is_gltf = |name: &&String| {
        let lower = name.to_ascii_lowercase();
        lower.ends_with(".gltf") || lower.ends_with(".glb")
    };
    let roots: Vec<&String> = index_of.keys().filter(is_gltf).collect();
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
