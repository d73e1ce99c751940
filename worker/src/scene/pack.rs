//! Packing a scene on disk into the one blob that is uploaded.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;

use gltf::json::Root;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::buffers::is_compression_stand_in;
use super::bundle::{Bundle, Format};
use super::document::{self, buffer_place, image_place};
use super::error::{ImportError, Result, shown};
use super::limits::{self, Budget, Limits, within};
use super::uri::{self, Uri};

/// Why a symbolic link is refused that a wider folder would hold.
pub(super) const LINKS_OUT: &str = "is a symbolic link out of the scene's folder";

/// Endings of files that are compressed already.
const COMPRESSED_ENDINGS: [&str; 5] = [".png", ".jpg", ".jpeg", ".webp", ".ktx2"];

impl Bundle {
    /// Reads a `.glb`, `.gltf` or `.zip` from disk as one self-contained upload.
    ///
    /// A file that names no other files is taken as it is. One that does becomes a zip of itself and those files, the
    /// same bytes for the same files whatever their dates and wherever they lie. Errors on files that are missing,
    /// outside the glTF's folder (also through symbolic links), remote or beyond the limits.
    pub fn pack_path(path: &Path, limits: &Limits) -> Result<Vec<u8>> {
        Self::pack_path_in(path.parent().unwrap_or(Path::new("")), path, limits)
    }

    /// The same with files anywhere in a folder that holds the glTF. Errors also if it does not.
    pub fn pack_path_in(root: &Path, path: &Path, limits: &Limits) -> Result<Vec<u8>> {
        let mut budget = Budget::new(limits::UPLOAD_BYTES, limits.bundle_bytes);
        let bytes = read_file(path, &mut budget)?;
        if Format::of(&bytes).ok_or(ImportError::UnknownFormat)? == Format::Zip {
            return Ok(bytes);
        }
        let (gltf, _) = document::parse(&bytes, limits)?;
        let folder = Folder::of(root, path)?;
        let mut files = folder.read_named_files(&gltf, limits, &mut budget)?;
        if files.is_empty() {
            return Ok(bytes);
        }
        files.insert(folder.name_of_gltf(path), bytes);
        let pack = |method| write_zip(&files, method).map_err(|source| ImportError::Pack { source });
        let mut packed = pack(CompressionMethod::Deflated)?;
        let total: u64 = files.values().map(|bytes| bytes.len() as u64).sum();
        if total > limits.decompressed_bytes_of(packed.len() as u64) {
            // A scene of mostly equal bytes would look like a bomb.
            packed = pack(CompressionMethod::Stored)?;
        }
        within(limits::UPLOAD_BYTES, packed.len() as u64, limits.bundle_bytes)?;
        Ok(packed)
    }
}

/// Where the files of a scene lie.
struct Folder<'a> {
    /// Folder that all of them are in.
    root: &'a Path,
    /// That of the glTF in it, with slashes; empty if they are the same.
    of_gltf: String,
}

impl<'a> Folder<'a> {
    fn of(root: &'a Path, gltf: &Path) -> Result<Self> {
        let outside = || ImportError::OutsideRoot { root: root.to_owned(), scene: gltf.to_owned() };
        let folder = real_path(here(gltf.parent().unwrap_or(Path::new(""))))?;
        let way = folder.strip_prefix(real_path(here(root))?).map_err(|_| outside())?;
        let parts: Option<Vec<&str>> = way.iter().map(|part| part.to_str()).collect();
        Ok(Self { root, of_gltf: parts.ok_or_else(outside)?.join("/") })
    }

    /// The name of the glTF inside the zip; one that [`Bundle::from_bytes`] knows again.
    fn name_of_gltf(&self, path: &Path) -> String {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let lower = name.to_ascii_lowercase();
        let is_known = lower.ends_with(".gltf") || lower.ends_with(".glb");
        let name = if is_known { name.as_str() } else { "scene.gltf" };
        if self.of_gltf.is_empty() { name.to_owned() } else { format!("{}/{name}", self.of_gltf) }
    }

    /// The files that the glTF names, by their names in the root.
    fn read_named_files(
        &self,
        gltf: &Root,
        limits: &Limits,
        budget: &mut Budget,
    ) -> Result<BTreeMap<String, Vec<u8>>> {
        let mut files = BTreeMap::new();
        let buffers = gltf.buffers.iter().enumerate();
        let images = gltf.images.iter().enumerate();
        let named = buffers
            .map(|(index, buffer)| {
                (buffer_place(gltf, index), buffer.uri.as_deref(), is_compression_stand_in(buffer))
            })
            .chain(images.map(|(index, image)| (image_place(gltf, index), image.uri.as_deref(), false)));
        for (place, uri, is_dispensable) in named {
            let Some(uri) = uri else { continue };
            let outside =
                |problem| ImportError::OutsidePath { place: place.clone(), uri: shown(uri), problem };
            match uri::classify(uri) {
                Uri::Data(_) => continue,
                Uri::Remote => return Err(outside("is not a file beside the glTF")),
                Uri::File(_) => {}
            }
            let decoded = uri::resolve(&self.of_gltf, &uri::decode_file(uri)).map_err(outside)?;
            let as_written = uri::resolve(&self.of_gltf, uri).map_err(outside)?;
            let candidates = [decoded, as_written];
            let Some(name) = candidates.into_iter().find(|name| self.root.join(name).exists()) else {
                if is_dispensable {
                    continue;
                }
                let hint = String::new();
                return Err(ImportError::MissingFile { place, uri: shown(uri), hint });
            };
            if files.contains_key(&name) {
                continue;
            }
            if !self.holds(&name)? {
                return Err(outside(LINKS_OUT));
            }
            files.insert(name.clone(), read_file(&self.root.join(&name), budget)?);
            within(limits::UPLOAD_FILES, files.len() as u64, limits.files.saturating_sub(1))?;
        }
        Ok(files)
    }

    fn holds(&self, name: &str) -> Result<bool> {
        let root = here(self.root);
        Ok(real_path(&root.join(name))?.starts_with(real_path(root)?))
    }
}

/// The folder, this one if the path is empty.
fn here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

fn real_path(path: &Path) -> Result<std::path::PathBuf> {
    fs::canonicalize(path).map_err(|source| ImportError::Io { path: path.to_owned(), source })
}

fn read_file(path: &Path, budget: &mut Budget) -> Result<Vec<u8>> {
    let failed = |source| ImportError::Io { path: path.to_owned(), source };
    let metadata = fs::metadata(path).map_err(failed)?;
    if !metadata.is_file() {
        let what = if metadata.is_dir() { "it is a folder" } else { "it is no ordinary file" };
        return Err(failed(std::io::Error::new(std::io::ErrorKind::InvalidInput, what)));
    }
    budget.spend(metadata.len())?;
    fs::read(path).map_err(failed)
}

/// A zip of the files, by `deflated` where they are not compressed already.
fn write_zip(
    files: &BTreeMap<String, Vec<u8>>,
    deflated: CompressionMethod,
) -> zip::result::ZipResult<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    // Date and mode would otherwise differ between machines, and with them the scene's digest.
    let plain = SimpleFileOptions::default().last_modified_time(DateTime::DEFAULT).unix_permissions(0o644);
    for (name, content) in files {
        let lower = name.to_ascii_lowercase();
        let is_compressed = COMPRESSED_ENDINGS.iter().any(|ending| lower.ends_with(ending));
        let method = if is_compressed { CompressionMethod::Stored } else { deflated };
        writer.start_file(name.as_str(), plain.compression_method(method))?;
        writer.write_all(content)?;
    }
    Ok(writer.finish()?.into_inner())
}
