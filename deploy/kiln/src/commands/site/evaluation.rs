//! An evaluation in a site: figures and pictures of the folder that `kiln evaluate --out` wrote, which the site's own page shows. Nothing
//! of its HTML is taken over.

use std::borrow::Cow;
use std::fs;
use std::io::Read as _;
use std::path::Path;

use serde_json::Value;

use super::{remove_files, whole_name, write};
use crate::evaluation::{FIGURES, GALLERY_FOLDER, GALLERY_LIST, Gallery};
use crate::failure::{Failure, Result};

/// Largest files that are read.
const JSON_BYTES_MAX: u64 = 16 << 20;
const PICTURE_BYTES_MAX: u64 = 32 << 20;
/// Most pictures.
const PICTURES_MAX: usize = 4096;
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// An evaluation that has been read and checked.
pub struct Read {
    figures: Value,
    gallery: Gallery,
    pictures: Vec<Vec<u8>>,
}

/// Reads an evaluation's folder.
pub fn read(folder: &Path) -> Result<Read> {
    let figures: Value = json(&folder.join(FIGURES))?;
    if !figures.is_object() {
        return Err(wrong(&folder.join(FIGURES), "holds no figures"));
    }
    let list = folder.join(GALLERY_LIST);
    let gallery: Gallery = json(&list)?;
    let files: Vec<&str> = gallery
        .lights
        .iter()
        .flat_map(|light| &light.pictures)
        .map(|picture| picture.file.as_str())
        .collect();
    if files.len() > PICTURES_MAX {
        return Err(wrong(&list, &format!("names more than {PICTURES_MAX} pictures")));
    }
    let picture = |file: &&str| {
        if !is_plain(file) {
            return Err(wrong(&list, &format!("names '{file}', which is no picture of its own")));
        }
        let path = folder.join(GALLERY_FOLDER).join(file);
        let bytes = limited(&path, PICTURE_BYTES_MAX)?;
        if bytes.starts_with(PNG) { Ok(bytes) } else { Err(wrong(&path, "is no PNG")) }
    };
    let pictures = files.iter().map(picture).collect::<Result<_>>()?;
    Ok(Read { figures, gallery, pictures })
}

/// Names and bytes of an evaluation's files, the lists last.
pub fn files(read: &Read) -> Vec<(String, Cow<'_, [u8]>)> {
    let listed = read.gallery.lights.iter().flat_map(|light| &light.pictures);
    let pictures = listed.zip(&read.pictures);
    let pictures = pictures
        .map(|(listed, png)| (format!("{GALLERY_FOLDER}/{}", listed.file), Cow::from(png.as_slice())));
    let list = (GALLERY_LIST.to_owned(), serde_json::json!(read.gallery).to_string());
    let figures = (FIGURES.to_owned(), read.figures.to_string());
    pictures.chain([list, figures].map(|(name, json)| (name, Cow::from(json.into_bytes())))).collect()
}

/// Writes an evaluation into a folder of the site, the lists last.
pub fn place(read: &Read, folder: &Path) -> Result<()> {
    files(read).iter().try_for_each(|(name, bytes)| write(&folder.join(name), bytes))
}

/// Removes what `place` wrote, the lists last.
pub fn remove(folder: &Path) -> Result<()> {
    remove_files(&folder.join(GALLERY_FOLDER), |name| is_plain(&whole_name(name, "png")))?;
    remove_files(folder, |name| [GALLERY_LIST, FIGURES].contains(&whole_name(name, "json").as_str()))
}

/// Whether a name is of a file in the same folder, and of a PNG.
fn is_plain(file: &str) -> bool {
    let is_known = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
    file.strip_suffix(".png").is_some_and(|stem| !stem.is_empty() && stem.bytes().all(is_known))
}

fn json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&limited(path, JSON_BYTES_MAX)?)
        .map_err(|error| wrong(path, "is not what 'kiln evaluate' writes").caused_by(&error))
}

fn limited(path: &Path, bytes_max: u64) -> Result<Vec<u8>> {
    let unread = |error: std::io::Error| {
        let what = format!("{} cannot be read", path.display());
        Failure::bad_input(what)
            .caused_by(&error)
            .try_this("'kiln evaluate BUNDLE --out DIR' writes such a folder")
    };
    let mut bytes = Vec::new();
    fs::File::open(path).map_err(unread)?.take(bytes_max + 1).read_to_end(&mut bytes).map_err(unread)?;
    if bytes.len() as u64 > bytes_max {
        return Err(wrong(path, &format!("has more than {bytes_max} bytes")));
    }
    Ok(bytes)
}

fn wrong(path: &Path, problem: &str) -> Failure {
    Failure::bad_input(format!("{} {problem}", path.display()))
        .try_this("'kiln evaluate BUNDLE --out DIR' writes such a folder")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder of an evaluation with one picture of that name and those bytes.
    fn folder_with(file: &str, bytes: &[u8]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(GALLERY_FOLDER)).unwrap();
        fs::write(folder.path().join(FIGURES), b"{\"rel_rmse\": 0.1}").unwrap();
        let picture = serde_json::json!({ "file": file, "words": "baked", "width": 2, "height": 2 });
        let light = serde_json::json!({ "name": "sun", "words": "a sun", "pictures": [picture] });
        let list = serde_json::json!({ "lights": [light] });
        fs::write(folder.path().join(GALLERY_LIST), list.to_string()).unwrap();
        fs::write(folder.path().join(GALLERY_FOLDER).join("0-0.png"), bytes).unwrap();
        folder
    }

    fn problem(folder: &tempfile::TempDir) -> String {
        read(folder.path()).err().map(|failure| failure.to_string()).unwrap_or_default()
    }

    #[test]
    fn figures_and_pictures_go_into_the_site() {
        let png = [PNG, b"rest"].concat();
        let folder = folder_with("0-0.png", &png);
        let site = tempfile::tempdir().unwrap();
        place(&read(folder.path()).unwrap(), site.path()).unwrap();
        assert_eq!(fs::read(site.path().join(GALLERY_FOLDER).join("0-0.png")).unwrap(), png);
        assert_eq!(fs::read(site.path().join(FIGURES)).unwrap(), b"{\"rel_rmse\":0.1}");
        assert!(site.path().join(GALLERY_LIST).is_file());
        remove(site.path()).unwrap();
        assert!(!site.path().exists(), "all that was placed is removed");
    }

    #[test]
    fn folders_that_kiln_did_not_write_are_refused() {
        let png = [PNG, b"rest"].concat();
        for file in ["../../secret.png", "/etc/passwd", "a/b.png", "page.html", ".png"] {
            let told = problem(&folder_with(file, &png));
            assert!(told.contains("no picture of its own"), "{file}: {told}");
        }
        assert!(problem(&folder_with("0-0.png", b"<html>")).contains("is no PNG"));
        assert!(problem(&folder_with("0-1.png", &png)).contains("cannot be read"));
        let folder = folder_with("0-0.png", &png);
        fs::write(folder.path().join(GALLERY_LIST), b"{\"lights\": [], \"script\": 1}").unwrap();
        assert!(problem(&folder).contains("is not what 'kiln evaluate' writes"));
        fs::write(folder.path().join(FIGURES), b"[]").unwrap();
        assert!(problem(&folder).contains("holds no figures"));
        assert!(problem(&tempfile::tempdir().unwrap()).contains("kiln evaluate BUNDLE --out"));
    }
}
