//! Packing a scene on disk into the one blob that is uploaded.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;

use gltf::json::Root;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::bundle::{Bundle, Format};
use super::document::{self, buffer_place, image_place};
use super::error::{ImportError, Result, shown};
use super::limits::{self, Budget, Limits, within};
use super::uri::{self, Uri};

/// Endings of files that are compressed already.
const COMPRESSED_ENDINGS: [&str; 5] = [".png", ".jpg", ".jpeg", ".webp", ".ktx2"];

impl Bundle {
    /// Reads a `.glb`, `.gltf` or `.zip` from disk as one self-contained upload.
    ///
    /// A file that names no other files is taken as it is. One that does becomes a zip of itself and those files, the
    /// same bytes for the same files whatever their dates and wherever they lie. Errors on files that are missing,
    /// outside the glTF's folder (also through symbolic links), remote or beyond the limits.
    pub fn pack_path(path: &Path, limits: &Limits) -> Result<Vec<u8>> {
        let mut budget = Budget::new(limits::UPLOAD_BYTES, limits.bundle_bytes);
        let bytes = read_file(path, &mut budget)?;
        if Format::of(&bytes).ok_or(ImportError::UnknownFormat)? == Format::Zip {
            return Ok(bytes);
        }
        let (root, _) = document::parse(&bytes, limits)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut files = read_named_files(&root, folder, limits, &mut budget)?;
        if files.is_empty() {
            return Ok(bytes);
        }
        files.insert(root_name(path), bytes);
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

/// The name of the glTF inside the zip; one that [`Bundle::from_bytes`] knows again.
fn root_name(path: &Path) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let lower = name.to_ascii_lowercase();
    if lower.ends_with(".gltf") || lower.ends_with(".glb") { name } else { "scene.gltf".to_owned() }
}

fn read_named_files(
    root: &Root,
    folder: &Path,
    limits: &Limits,
    budget: &mut Budget,
) -> Result<BTreeMap<String, Vec<u8>>> {
    let mut files = BTreeMap::new();
    let buffers = root.buffers.iter().enumerate();
    let images = root.images.iter().enumerate();
    let named = buffers
        .map(|(index, buffer)| (buffer_place(root, index), buffer.uri.as_deref()))
        .chain(images.map(|(index, image)| (image_place(root, index), image.uri.as_deref())));
    for (place, uri) in named {
        let Some(uri) = uri else { continue };
        let outside = |problem| ImportError::OutsidePath { place: place.clone(), uri: shown(uri), problem };
        match uri::classify(uri) {
            Uri::Data(_) => continue,
            Uri::Remote => return Err(outside("is not a file beside the glTF")),
            Uri::File(_) => {}
        }
        let decoded = uri::resolve("", &uri::decode_file(uri)).map_err(outside)?;
        let as_written = uri::resolve("", uri).map_err(outside)?;
        let candidates = [decoded, as_written];
        let Some(name) = candidates.into_iter().find(|name| folder.join(name).exists()) else {
            let hint = String::new();
            return Err(ImportError::MissingFile { place, uri: shown(uri), hint });
        };
        if files.contains_key(&name) {
            continue;
        }
        if !lies_inside(folder, &name)? {
            return Err(outside("is a symbolic link out of the scene's folder"));
        }
        files.insert(name.clone(), read_file(&folder.join(&name), budget)?);
        within(limits::UPLOAD_FILES, files.len() as u64, limits.files.saturating_sub(1))?;
    }
    Ok(files)
}

fn lies_inside(folder: &Path, name: &str) -> Result<bool> {
    let here = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    Ok(real_path(&here.join(name))?.starts_with(real_path(here)?))
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
