//! `kiln site`: a bake as a website of plain files, which browsers relight.

pub(super) mod evaluation;
pub(super) mod stills;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::Args;
use lightkiln_client::bake::ClientKinds;
use lightkiln_client::fetch::{CHUNKS_FOLDER, Source, download_bundle, write_atomically};
use lightkiln_client::web::{FACE, MODULES, SITE, shaders};
use serde_json::json;

use crate::arguments::BakeArgument;
use crate::bundle::remove_left_over;
use crate::console::say;
use crate::evaluation::PAGE as EVALUATION_PAGE;
use crate::failure::{Failure, Result};
use crate::kinds::KindTables;
use crate::outputs::check_folder;

/// The page.
const PAGE: &str = "index.html";
/// Folder of the bundle; the page's module knows it.
const BAKE: &str = "bake";
/// Folder of modules and shaders.
const MODULES_FOLDER: &str = "web";
/// An empty file by which GitHub's pages keep files whose names begin with an underscore.
const NO_JEKYLL: &str = ".nojekyll";
/// Folder of an evaluation; the page's module knows it.
const EVALUATION: &str = "evaluation";
/// Tells the page which other parts there are.
const CONTENTS: &str = "site.json";
/// Names that a site's folder may hold; the last two are of those who publish it.
const PARTS: [&str; 9] =
    [PAGE, BAKE, MODULES_FOLDER, stills::FOLDER, EVALUATION, CONTENTS, NO_JEKYLL, ".git", "CNAME"];

/// Arguments of `kiln site`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    /// Folder to write: index.html, the modules in web, the bundle in bake; new, empty, or of an earlier site, whose chunks are kept where this bake has them
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Pictures for browsers without WebGPU, from as many of the bake's cameras as it has, under its own lights: each is a render, as of 'kiln preview'; 0 draws none
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=i64::from(stills::STILLS_MAX)))]
    stills: u32,
    /// Shows the figures and pictures of an evaluation too: the folder that 'kiln evaluate BUNDLE --out DIR' wrote, outside of --out
    #[arg(long, value_name = "DIR")]
    evaluation: Option<PathBuf>,
}

/// Writes the site, the page last. Evaluation and pictures are there before anything of an earlier site goes.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let out = &arguments.out;
    check_folder(out)?;
    check_is_ours(out)?;
    check_evaluation(out, arguments.evaluation.as_deref())?;
    let evaluation = arguments.evaluation.as_deref().map(evaluation::read).transpose()?;
    let source = arguments.source.open()?;
    check_kind(&source, &kinds.client)?;
    let stills = stills::draw(&source, &kinds.client, arguments.stills)?;
    let (manifest, _) = download_bundle(&source, &out.join(BAKE))?;
    remove_left_over(&out.join(BAKE), &manifest)?;
    for (name, bytes) in MODULES.iter().filter(|(name, _)| ![FACE, SITE].contains(name)) {
        write(&out.join(MODULES_FOLDER).join(name), bytes)?;
    }
    for (name, text) in shaders() {
        write(&out.join(MODULES_FOLDER).join(format!("shaders/{name}.wgsl")), text.as_bytes())?;
    }
    write(&out.join(NO_JEKYLL), b"")?;
    remove_parts(out)?;
    let pictures = stills::place(&stills, out)?;
    if let Some(read) = &evaluation {
        evaluation::place(read, &out.join(EVALUATION))?;
    }
    let contents = json!({ "stills": pictures, "evaluation": evaluation.is_some() });
    write(&out.join(CONTENTS), contents.to_string().as_bytes())?;
    let page = MODULES.iter().find(|(name, _)| *name == SITE);
    write(&out.join(PAGE), page.map_or(&[][..], |(_, bytes)| bytes))?;
    let megabytes = manifest.bytes() as f64 / 1e6;
    say!(
        "{}: a site with {megabytes:.1} MB of chunks; any web server hands it out, over HTTPS or on this machine",
        out.display()
    );
    Ok(())
}

/// Removes pictures and evaluation of an earlier site, first the file that tells its page of them. Files of others stay.
fn remove_parts(out: &Path) -> Result<()> {
    let contents = out.join(CONTENTS);
    match fs::remove_file(&contents) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            let what = format!("{} of an earlier site cannot be removed", contents.display());
            return Err(Failure::bad_input(what).caused_by(&error));
        }
        _ => {}
    }
    stills::remove(out)?;
    evaluation::remove(&out.join(EVALUATION))
}

/// Removes those files of a folder that a site wrote, and the folder where nothing else is in it.
fn remove_files(folder: &Path, is_of_site: impl Fn(&str) -> bool) -> Result<()> {
    let failed = |error: std::io::Error| {
        let what = format!("files of an earlier site in {} cannot be removed", folder.display());
        Failure::bad_input(what).caused_by(&error)
    };
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(failed(error)),
    };
    for entry in entries {
        let entry = entry.map_err(failed)?;
        let is_folder = entry.file_type().map_err(failed)?.is_dir();
        if !is_folder && is_of_site(&entry.file_name().to_string_lossy()) {
            fs::remove_file(entry.path()).map_err(failed)?;
        }
    }
    // Files of others keep their folder.
    fs::remove_dir(folder).ok();
    Ok(())
}

/// Name of a file once it is whole: that of a file which a killed run left half written ends in `extension` then.
fn whole_name(name: &str, extension: &str) -> String {
    name.split_once(".part-").map_or_else(|| name.to_owned(), |(stem, _)| format!("{stem}.{extension}"))
}

/// Refuses evaluations that are kept in the site's folder, whose parts are written anew.
fn check_evaluation(out: &Path, evaluation: Option<&Path>) -> Result<()> {
    let page = out.join(EVALUATION).join(EVALUATION_PAGE);
    if page.exists() {
        let what = format!(
            "{} is of an evaluation that 'kiln evaluate' wrote into the site's folder, which is written anew",
            page.display()
        );
        return Err(Failure::bad_input(what)
            .try_this("move it to a folder outside of the site, and show it with --evaluation DIR"));
    }
    let Some(evaluation) = evaluation else { return Ok(()) };
    // A folder that is not there has nothing in it; its reader names an evaluation that is not there.
    let (Ok(within), Ok(site)) = (evaluation.canonicalize(), out.canonicalize()) else { return Ok(()) };
    if !within.starts_with(site) {
        return Ok(());
    }
    let what = format!(
        "the evaluation {} lies in the site's folder {}, which is written anew",
        evaluation.display(),
        out.display()
    );
    Err(Failure::bad_input(what)
        .try_this("move it to a folder outside of the site, and name that with --evaluation DIR"))
}

/// Refuses a folder with anything in it that is no site, or no part of one.
fn check_is_ours(folder: &Path) -> Result<()> {
    let unread = |error: std::io::Error| {
        Failure::bad_input(format!("the folder {} cannot be read", folder.display())).caused_by(&error)
    };
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(unread(error)),
    };
    // Chunks come first and the page last.
    let is_site = folder.join(BAKE).join(CHUNKS_FOLDER).is_dir();
    for entry in entries {
        let name = entry.map_err(unread)?.file_name().to_string_lossy().into_owned();
        // A killed run leaves files half written.
        let is_part = [PAGE, CONTENTS, NO_JEKYLL].iter().any(|file| name.starts_with(&part_of(file)));
        if !is_site || !(PARTS.contains(&name.as_str()) || is_part || name.starts_with(".kiln-")) {
            let what = format!("the folder {} holds '{name}', which is no part of a site", folder.display());
            return Err(Failure::bad_input(what).try_this("another folder with --out DIR"));
        }
    }
    Ok(())
}

/// Beginning of the name of a file of that name before it is whole.
fn part_of(name: &str) -> String {
    format!(
        "{}.part-",
        name.rsplit_once('.').map_or(name, |(stem, _)| if stem.is_empty() { name } else { stem })
    )
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
        // A page alone may be anybody's.
        fs::write(folder.path().join(PAGE), b"mine").unwrap();
        assert!(check_is_ours(folder.path()).is_err());
        fs::create_dir_all(folder.path().join(BAKE).join(CHUNKS_FOLDER)).unwrap();
        fs::create_dir(folder.path().join(stills::FOLDER)).unwrap();
        for name in [".nojekyll", "CNAME", "site.json", "index.part-12", ".nojekyll.part-12", ".kiln-12"] {
            fs::write(folder.path().join(name), b"").unwrap();
        }
        check_is_ours(folder.path()).unwrap();
        remove_parts(folder.path()).unwrap();
        assert!(!folder.path().join(stills::FOLDER).exists() && folder.path().join("CNAME").exists());
        assert!(!folder.path().join(CONTENTS).exists());
        fs::write(folder.path().join("thesis.txt"), b"").unwrap();
        let problem = check_is_ours(folder.path()).unwrap_err().to_string();
        assert!(problem.contains("thesis.txt") && problem.contains("--out"), "{problem}");
    }

    #[test]
    fn parts_of_an_earlier_site_go_and_files_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let parts = [
            "site.json",
            "stills/1.png",
            "stills/2.part-12",
            "evaluation/evaluation.json",
            "evaluation/pictures.json",
            "evaluation/pictures.part-12",
            "evaluation/pictures/0-0.png",
            "evaluation/pictures/0-1.part-12",
        ];
        let others =
            ["stills/17.png", "stills/mine.png", "evaluation/notes.txt", "evaluation/pictures/Mine.PNG"];
        for name in parts.iter().chain(&others) {
            write(&at(name), b"").unwrap();
        }
        remove_parts(folder.path()).unwrap();
        let left = |names: &[&str]| names.iter().filter(|name| at(name).exists()).count();
        assert_eq!((left(&parts), left(&others)), (0, others.len()));
        others.iter().for_each(|name| fs::remove_file(at(name)).unwrap());
        remove_parts(folder.path()).unwrap();
        assert!(!at("stills").exists() && !at("evaluation").exists());
    }

    #[test]
    fn evaluations_in_the_folder_of_a_site_are_refused_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let site = at("site");
        check_evaluation(&site, Some(&at("evaluated"))).unwrap();
        for name in ["evaluated", "site/evaluation", "site-of-others"] {
            fs::create_dir_all(at(name)).unwrap();
        }
        check_evaluation(&site, None).unwrap();
        for name in ["evaluated", "site-of-others", "absent", "site/../evaluated"] {
            check_evaluation(&site, Some(&at(name))).unwrap();
        }
        for name in ["site/evaluation", "evaluated/../site/evaluation", "site"] {
            let told = check_evaluation(&site, Some(&at(name))).unwrap_err().to_string();
            assert!(told.contains("lies in the site's folder") && told.contains("outside"), "{told}");
        }
        // One that was written there is kept, whether it is named or not.
        fs::write(at("site/evaluation/evaluation.html"), b"").unwrap();
        for named in [None, Some(at("evaluated"))] {
            let told = check_evaluation(&site, named.as_deref()).unwrap_err().to_string();
            assert!(told.contains("evaluation.html") && told.contains("outside"), "{told}");
        }
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
