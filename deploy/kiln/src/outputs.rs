//! Places to write to, tried before any work is done: nobody shall wait for a bake to hear that its picture has no folder.

use std::fs::{self, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use crate::failure::{Exit, Failure, Result};

/// Refuses a picture that is named as another format than PNG, or cannot be written.
pub fn check_png(path: &Path) -> Result<()> {
    let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    if is_png {
        return check_file(path);
    }
    let what = format!("{} is not named as a PNG, and pictures are written as PNG alone", path.display());
    Err(Failure::bad_input(what).try_this(path.with_extension("png").display().to_string()))
}

/// Refuses a file that cannot be written, a folder say, or one in a folder that is not there.
pub fn check_file(path: &Path) -> Result<()> {
    if path.is_dir() {
        return Err(Failure::bad_input(format!("{} is a folder, not a file to write", path.display())));
    }
    let folder = folder_of(path);
    if !folder.is_dir() {
        let what = format!("{} cannot be written: there is no folder {}", path.display(), folder.display());
        return Err(Failure::bad_input(what).try_this("another place, or make the folder first"));
    }
    tried(folder, path)
}

/// Refuses a folder that can neither be written in nor made; it is not made yet.
pub fn check_folder(path: &Path) -> Result<()> {
    let there = path.ancestors().find(|ancestor| ancestor.exists() || ancestor.as_os_str().is_empty());
    let there = there.filter(|ancestor| !ancestor.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        let what = format!("{} cannot be made: {} is no folder", path.display(), there.display());
        return Err(Failure::bad_input(what).try_this("another place with --out DIR"));
    }
    tried(there, path)
}

/// The folder that a path lies in.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes a file in a folder that is there, and removes it again.
fn tried(folder: &Path, wanted: &Path) -> Result<()> {
    let made = make_and_remove(folder.join(format!(".kiln-{}", std::process::id())));
    made.map_err(|error| {
        let exit = if error.kind() == io::ErrorKind::StorageFull { Exit::Failed } else { Exit::BadInput };
        Failure::new(exit, format!("{} cannot be written", wanted.display()))
            .caused_by(&error)
            .try_this("another place, or make this one writable")
    })
}

fn make_and_remove(probe: PathBuf) -> io::Result<()> {
    OpenOptions::new().write(true).create(true).truncate(true).open(&probe)?;
    fs::remove_file(&probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_that_cannot_be_written_are_named_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("file"), b"").unwrap();
        check_png(&at("a.png")).unwrap();
        check_png(&at("a.PNG")).unwrap();
        check_file(&at("file")).unwrap();
        check_folder(&at("x/y/z")).unwrap();
        let words = |refused: Result<()>| {
            let failure = refused.unwrap_err();
            assert_eq!(failure.exit(), Exit::BadInput);
            failure.to_string()
        };
        assert!(words(check_png(&at("a.jpg"))).contains("a.png"));
        assert!(words(check_png(&at("a"))).contains("a.png"));
        assert!(words(check_file(&at("none/a.csv"))).contains("none"));
        assert!(words(check_file(folder.path())).contains("is a folder"));
        assert!(words(check_folder(&at("file/out"))).contains("is no folder"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing stays behind");
    }
}
