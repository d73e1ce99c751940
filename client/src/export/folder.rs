//! The folder of an export: it appears whole, in place of an earlier export or of nothing.
//!
//! An export is written as `.NAME.part` beside its place; an earlier one stands as `.NAME.old` between two renames. A process that is
//! killed leaves these names, and the next one finds them.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use super::glb::is_own;
use super::{Exported, SCENE_FILE, probes};
use crate::error::{ClientError, Result};

/// How much of an export may lie in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Extent {
    /// All of it, as after a rename.
    Whole,
    /// Some of its files, each whole: it was being removed.
    Rest,
    /// Some of its files, one of them cut off: it was being written.
    Draft,
}

/// Refuses a place that holds other things than an earlier export, or that an export cannot be written beside.
pub fn check_folder(folder: &Path) -> Result<()> {
    if folder.file_name().is_none() {
        return Err(refused(folder, "ends in no name, and exports are written beside it first"));
    }
    let [part, old] = leftovers(folder);
    check(folder, Extent::Whole)?;
    check(&part, Extent::Draft)?;
    check(&old, Extent::Rest)
}

/// Refuses a folder that holds other things than an export; one that is not there holds none.
fn check(folder: &Path, extent: Extent) -> Result<()> {
    match foreign(folder, extent) {
        Ok(None) => Ok(()),
        Ok(Some(name)) => Err(refused(folder, &format!("holds '{name}', which is of no export"))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::NotADirectory => {
            Err(refused(folder, "is no folder and cannot become one"))
        }
        Err(error) => Err(failed("read", folder)(error)),
    }
}

fn refused(folder: &Path, problem: &str) -> ClientError {
    let text = folder.display().to_string();
    ClientError::Source { text, problem: format!("{problem}; give another folder") }
}

/// A thing in a folder that no export has put there. Pages are an export's where its scene is.
fn foreign(folder: &Path, extent: Extent) -> io::Result<Option<String>> {
    let (mut has_scene, mut page) = (false, None);
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let (name, path) = (entry.file_name().to_string_lossy().into_owned(), entry.path());
        let is_scene = name == SCENE_FILE;
        let is_ours = path.is_file()
            && if is_scene {
                extent == Extent::Draft || is_own(File::open(&path)?)?
            } else {
                is_page(&name) || probes::is_file(&name)
            };
        if !is_ours {
            return Ok(Some(name));
        }
        has_scene |= is_scene;
        if !is_scene {
            page = Some(name);
        }
    }
    Ok(page.filter(|_| extent == Extent::Whole && !has_scene))
}

fn is_page(name: &str) -> bool {
    let page = name.strip_prefix("lightmap-").and_then(|name| name.strip_suffix(".ktx2"));
    page.is_some_and(|page| !page.is_empty() && page.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Writes an export through a folder beside `folder`, which takes its name when it is whole. An earlier export there is gone then. Where
/// a process was killed between, the earlier one is put back first. Two processes at once need two folders.
pub fn write(exported: &Exported, folder: &Path) -> Result<()> {
    check_folder(folder)?;
    let [part, old] = leftovers(folder);
    recover(folder, &old)?;
    if let Some(parent) = folder.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        fs::create_dir_all(parent).map_err(failed("create", parent))?;
    }
    let written = write_files(exported, &part).and_then(|()| {
        let has_old = folder.exists();
        if has_old {
            fs::rename(folder, &old).map_err(failed("move", folder))?;
        }
        let moved = fs::rename(&part, folder).map_err(failed("write", folder));
        if has_old {
            // Best effort: the export, or the error that matters, is there.
            let _ = if moved.is_ok() { fs::remove_dir_all(&old) } else { fs::rename(&old, folder) };
        }
        moved
    });
    if written.is_err() {
        // Best effort: the error that matters is the one above.
        let _ = fs::remove_dir_all(&part);
    }
    written
}

/// Puts back the earlier export that a killed process had moved away, or removes it where the newer one is there.
fn recover(folder: &Path, old: &Path) -> Result<()> {
    if !old.exists() {
        return Ok(());
    }
    if folder.exists() {
        fs::remove_dir_all(old).map_err(failed("remove", old))
    } else {
        fs::rename(old, folder).map_err(failed("restore", folder))
    }
}

fn write_files(exported: &Exported, folder: &Path) -> Result<()> {
    // One that a killed process left.
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(failed("remove", folder))?;
    }
    fs::create_dir(folder).map_err(failed("create", folder))?;
    for (name, bytes) in &exported.files {
        let path = folder.join(name);
        File::create(&path)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .map_err(failed("write", &path))?;
    }
    Ok(())
}

/// `.NAME.part` and `.NAME.old` beside a folder.
fn leftovers(folder: &Path) -> [PathBuf; 2] {
    ["part", "old"].map(|what| {
        let mut name = OsString::from(".");
        name.push(folder.file_name().unwrap_or_default());
        name.push(format!(".{what}"));
        folder.with_file_name(name)
    })
}

fn failed<'a>(action: &'static str, path: &'a Path) -> impl Fn(io::Error) -> ClientError + 'a {
    move |source| ClientError::File { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::export::glb::Glb;

    /// A scene that Lightkiln wrote; names tell them apart.
    fn scene(name: &str) -> Vec<u8> {
        Glb::default().finish(json!(name)).unwrap()
    }

    fn exported(files: &[(&str, &[u8])]) -> Exported {
        let files = files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
        Exported { files, ..Exported::default() }
    }

    /// Names in a folder, in order.
    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn export_takes_the_place_of_an_earlier_one_whole() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("a/out");
        let (one, two) = (scene("one"), scene("two"));
        write(
            &exported(&[(SCENE_FILE, &one), ("lightmap-0.ktx2", b"x"), ("lightmap-1.ktx2", b"y")]),
            &folder,
        )
        .unwrap();
        write(&exported(&[(SCENE_FILE, &two), ("lightmap-0.ktx2", b"z")]), &folder).unwrap();
        assert_eq!(names(&folder), ["lightmap-0.ktx2", SCENE_FILE]);
        assert_eq!(fs::read(folder.join(SCENE_FILE)).unwrap(), two);
        assert_eq!(names(folder.parent().unwrap()), ["out"], "nothing stays beside it");
    }

    #[test]
    fn folder_with_other_things_is_refused_and_stays_as_it_was() {
        let parent = tempfile::tempdir().unwrap();
        for name in ["diary.txt", "lightmap-.ktx2", "lightmap-1x.ktx2", "lightmap-0.ktx2"] {
            let folder = parent.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join(name), b"dear diary").unwrap();
            let error = write(&exported(&[(SCENE_FILE, b"one")]), &folder).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("another folder"), "{error}");
            assert_eq!(names(&folder), [name]);
        }
        let file = parent.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(write(&exported(&[]), &file).unwrap_err().to_string().contains("no folder"));
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 5, "nothing stays behind");
        let unnamed = check_folder(&parent.path().join("..")).unwrap_err().to_string();
        assert!(unnamed.contains("ends in no name"), "{unnamed}");
    }

    #[test]
    fn scene_that_lightkiln_did_not_write_is_refused_and_untouched() {
        let own = scene("own");
        let at = own.windows(9).position(|bytes| bytes == b"Lightkiln").unwrap();
        let mut blender = own.clone();
        blender[at..at + 9].copy_from_slice(b"Blender 5");
        let mut binary = own.clone();
        binary[16..20].copy_from_slice(b"BIN\0");
        let parent = tempfile::tempdir().unwrap();
        for folder in ["out", ".out.old"].map(|name| parent.path().join(name)) {
            fs::create_dir(&folder).unwrap();
            for foreign in [&b"mine"[..], &b""[..], &blender[..], &binary[..], &own[..own.len() / 2]] {
                fs::write(folder.join(SCENE_FILE), foreign).unwrap();
                let place = parent.path().join("out");
                let error = write(&exported(&[(SCENE_FILE, &own)]), &place).unwrap_err().to_string();
                assert!(error.contains(SCENE_FILE) && error.contains("another folder"), "{error}");
                assert_eq!(fs::read(folder.join(SCENE_FILE)).unwrap(), foreign);
            }
            fs::remove_dir_all(&folder).unwrap();
        }
    }

    #[test]
    fn traces_of_a_killed_process_are_mended_by_the_next() {
        let parent = tempfile::tempdir().unwrap();
        let at = |name: &str| parent.path().join(name);
        let folder = at("out");
        let (one, two) = (scene("one"), scene("two"));
        // Killed between both renames, with the newer one whole; the next one cannot write its files.
        write(&exported(&[(SCENE_FILE, &one)]), &folder).unwrap();
        fs::rename(&folder, at(".out.old")).unwrap();
        write(&exported(&[(SCENE_FILE, &two)]), &at(".out.part")).unwrap();
        assert!(write(&exported(&[("no/such/folder", b"")]), &folder).is_err());
        assert_eq!(names(parent.path()), ["out"]);
        assert_eq!(fs::read(folder.join(SCENE_FILE)).unwrap(), one, "the earlier one is back");
        // Killed as the earlier one was removed, and another as it wrote.
        fs::create_dir(at(".out.old")).unwrap();
        fs::write(at(".out.old").join("lightmap-3.ktx2"), b"x").unwrap();
        fs::create_dir(at(".out.part")).unwrap();
        fs::write(at(".out.part").join(SCENE_FILE), &two[..9]).unwrap();
        write(&exported(&[(SCENE_FILE, &two)]), &folder).unwrap();
        assert_eq!(names(parent.path()), ["out"]);
        assert_eq!(fs::read(folder.join(SCENE_FILE)).unwrap(), two);
    }

    #[test]
    fn file_that_cannot_be_written_leaves_nothing_behind() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("out");
        assert!(write(&exported(&[("no/such/folder", b"")]), &folder).is_err());
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
