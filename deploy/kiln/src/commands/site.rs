//! `kiln site`: a bake as a website of plain files, which browsers relight.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use lightkiln_client::bake::ClientKinds;
use lightkiln_client::fetch::{Source, download_bundle, write_atomically};
use lightkiln_client::web::{FACE, MODULES, SITE, shaders};

use crate::arguments::BakeArgument;
use crate::console::say;
use crate::failure::{Failure, Result};
use crate::kinds::KindTables;
use crate::outputs::check_folder;

/// The page.
const PAGE: &str = "index.html";
/// Folder of the bundle; the page's module knows it.
const BAKE: &str = "bake";
/// Folder of modules and shaders.
const MODULES_FOLDER: &str = "web";

/// Arguments of `kiln site`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    /// Folder to write: index.html, the modules in web, the bundle in bake; new, empty, or of an earlier site, whose chunks are kept
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Writes the site, the page last.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let out = &arguments.out;
    check_folder(out)?;
    check_is_ours(out)?;
    let source = arguments.source.open()?;
    check_kind(&source, &kinds.client)?;
    let (manifest, _) = download_bundle(&source, &out.join(BAKE))?;
    for (name, bytes) in MODULES.iter().filter(|(name, _)| ![FACE, SITE].contains(name)) {
        write(&out.join(MODULES_FOLDER).join(name), bytes)?;
    }
    for (name, text) in shaders() {
        write(&out.join(MODULES_FOLDER).join(format!("shaders/{name}.wgsl")), text.as_bytes())?;
    }
    let page = MODULES.iter().find(|(name, _)| *name == SITE);
    write(&out.join(PAGE), page.map_or(&[][..], |(_, bytes)| bytes))?;
    let megabytes = manifest.bytes() as f64 / 1e6;
    say!(
        "{}: a site with {megabytes:.1} MB of chunks; any web server hands it out, over HTTPS or on this machine",
        out.display()
    );
    Ok(())
}

/// Refuses a folder with anything else in it.
fn check_is_ours(folder: &Path) -> Result<()> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => {
            let what = format!("the folder {} cannot be read", folder.display());
            return Err(Failure::bad_input(what).caused_by(&error));
        }
    };
    let ours = [PAGE, BAKE, MODULES_FOLDER];
    for entry in entries.flatten() {
        if !ours.iter().any(|name| entry.file_name() == *name) {
            let name = entry.file_name().to_string_lossy().into_owned();
            let what = format!("the folder {} holds '{name}', which is no part of a site", folder.display());
            return Err(Failure::bad_input(what).try_this("another folder with --out DIR"));
        }
    }
    Ok(())
}

/// Refuses a kind that browsers do not show.
fn check_kind(source: &Source, kinds: &ClientKinds) -> Result<()> {
    let (_, manifest) = source.manifest()?;
    if kinds.of(&manifest)?.is_in_browsers() {
        return Ok(());
    }
    let what = format!("the bake is of kind '{}', which browsers do not show", manifest.kind);
    Err(Failure::bad_input(what).try_this("a bake of the default kind"))
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|error| {
            Failure::bad_input(format!("the folder {} cannot be made", folder.display())).caused_by(&error)
        })?;
    }
    Ok(write_atomically(path, bytes)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_others_are_refused_and_sites_are_written_again() {
        let folder = tempfile::tempdir().unwrap();
        check_is_ours(&folder.path().join("new")).unwrap();
        check_is_ours(folder.path()).unwrap();
        fs::create_dir(folder.path().join(BAKE)).unwrap();
        fs::write(folder.path().join(PAGE), b"").unwrap();
        check_is_ours(folder.path()).unwrap();
        fs::write(folder.path().join("thesis.txt"), b"").unwrap();
        let problem = check_is_ours(folder.path()).unwrap_err().to_string();
        assert!(problem.contains("thesis.txt") && problem.contains("--out"), "{problem}");
    }

    #[test]
    fn page_of_a_site_names_files_that_a_site_has() {
        let file = |name: &str| MODULES.iter().find(|(found, _)| *found == name).map(|(_, bytes)| *bytes);
        let page = std::str::from_utf8(file(SITE).unwrap()).unwrap();
        let named: Vec<&str> =
            page.split("\"web/").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(named.len(), 3, "{named:?}");
        for name in named {
            assert!(file(name).is_some(), "{name}");
        }
    }
}
