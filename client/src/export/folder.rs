//! The folder of an export: it appears whole, in place of an earlier export or of nothing.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::{Exported, SCENE_FILE};
use crate::error::{ClientError, Result};

/// Refuses a place that holds other things than an earlier export.
pub fn check_folder(folder: &Path) -> Result<()> {
    let refused = |problem: &str| {
        let text = folder.display().to_string();
        Err(ClientError::Source { text, problem: format!("{problem}; give another folder") })
    };
    let Ok(entries) = fs::read_dir(folder) else {
        return if folder.exists() { refused("is no folder") } else { Ok(()) };
    };
    for entry in entries {
        let entry = entry.map_err(failed("read", folder))?;
        let name = entry.file_name();
        let is_ours = name.to_str().is_some_and(is_of_export) && !entry.path().is_dir();
        if !is_ours {
            return refused(&format!("holds '{}', which is of no export", name.to_string_lossy()));
        }
    }
    Ok(())
}

fn is_of_export(name: &str) -> bool {
    let page = name.strip_prefix("lightmap-").and_then(|name| name.strip_suffix(".ktx2"));
    name == SCENE_FILE
        || page.is_some_and(|page| !page.is_empty() && page.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Writes an export through a folder beside `folder`, which takes its name when it is whole. An earlier export there is gone then.
pub fn write(exported: &Exported, folder: &Path) -> Result<()> {
    check_folder(folder)?;
    let [part, old] = ["part", "old"].map(|what| beside(folder, what));
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

fn write_files(exported: &Exported, folder: &Path) -> Result<()> {
    // One that a killed process of this number left.
    if folder.exists() {
        fs::remove_dir_all(folder).map_err(failed("remove", folder))?;
    }
    fs::create_dir(folder).map_err(failed("create", folder))?;
    for (name, bytes) in &exported.files {
        let path = folder.join(name);
        fs::File::create(&path)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .map_err(failed("write", &path))?;
    }
    Ok(())
}

/// `NAME.what-PID` beside a folder.
fn beside(folder: &Path, what: &str) -> PathBuf {
    let mut name = folder.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{what}-{}", std::process::id()));
    folder.with_file_name(name)
}

fn failed<'a>(action: &'static str, path: &'a Path) -> impl Fn(std::io::Error) -> ClientError + 'a {
    move |source| ClientError::File { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exported(files: &[(&str, &[u8])]) -> Exported {
        let files = files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
        Exported { files, ..Exported::default() }
    }

    #[test]
    fn export_takes_the_place_of_an_earlier_one_whole() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("a/out");
        write(
            &exported(&[(SCENE_FILE, b"one"), ("lightmap-0.ktx2", b"x"), ("lightmap-1.ktx2", b"y")]),
            &folder,
        )
        .unwrap();
        write(&exported(&[(SCENE_FILE, b"two"), ("lightmap-0.ktx2", b"z")]), &folder).unwrap();
        let mut names: Vec<_> =
            fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["lightmap-0.ktx2", SCENE_FILE]);
        assert_eq!(fs::read(folder.join(SCENE_FILE)).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.parent().unwrap()).unwrap().count(), 1, "nothing stays beside it");
    }

    #[test]
    fn folder_with_other_things_is_refused_and_stays_as_it_was() {
        let parent = tempfile::tempdir().unwrap();
        for name in ["diary.txt", "lightmap-.ktx2", "lightmap-1x.ktx2"] {
            let folder = parent.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join(name), b"dear diary").unwrap();
            let error = write(&exported(&[(SCENE_FILE, b"one")]), &folder).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("another folder"), "{error}");
            assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        }
        let file = parent.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(write(&exported(&[]), &file).unwrap_err().to_string().contains("no folder"));
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 4, "nothing stays behind");
    }

    #[test]
    fn file_that_cannot_be_written_leaves_nothing_behind() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("out");
        assert!(write(&exported(&[("no/such/folder", b"")]), &folder).is_err());
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
