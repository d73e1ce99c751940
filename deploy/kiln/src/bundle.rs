//! Writes a finished bake as a bundle: manifest, chunks and report, and nothing of an earlier bake.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::time::Instant;

use lightkiln_client::ClientError;
use lightkiln_client::fetch::{ApiClient, CHUNKS_FOLDER, Downloaded, Source, chunk_refs, download_bundle};
use lightkiln_proto::api::Bake;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::kinds::Kinds;
use lightkiln_proto::manifest::Manifest;
use serde_json::Value;

use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::summary::{Summary, import_warnings, write_report};

/// A folder with other things in it is not written over.
pub fn refuse_foreign_folder(out: &Path) -> Result<()> {
    let Ok(mut entries) = fs::read_dir(out) else {
        return if out.exists() {
            let what = format!("{} exists and is no folder", out.display());
            Err(Failure::bad_input(what).try_this("another place with --out DIR"))
        } else {
            Ok(())
        };
    };
    let is_bundle = out.join(CHUNKS_FOLDER).is_dir();
    if is_bundle || entries.next().is_none() {
        return Ok(());
    }
    let what = format!("{} holds other files than a bundle's", out.display());
    Err(Failure::bad_input(what).try_this("another folder with --out DIR"))
}

/// Writes the bundle of a bake that is done to `out`, and prints warnings of scene and bake on standard error. `scene` is
/// what the summary calls it; `started` is when the command did.
pub fn write_bundle(
    kinds: &Kinds,
    client: &ApiClient,
    bake: &Bake,
    scene: &str,
    out: &Path,
    started: Instant,
) -> Result<(Summary, Downloaded)> {
    refuse_foreign_folder(out)?;
    let source = Source::server(client.clone(), &bake.id);
    let report = report_of(client, &bake.id)?;
    let (manifest, downloaded) = download_bundle(&source, out)?;
    remove_left_over(out, &manifest)?;
    let mut summary = Summary::new(kinds, bake, &manifest, scene, out, started.elapsed())
        .map_err(|error| Failure::bad_input("the bake cannot be read").caused_by(&error))?;
    summary.warnings.splice(0..0, import_warnings(&report));
    for warning in &summary.warnings {
        say!("warning: {}", warning.line());
    }
    write_report(out, &report, &summary)?;
    Ok((summary, downloaded))
}

fn report_of(client: &ApiClient, id: &str) -> Result<Value> {
    let report = client.report(id)?;
    let place = || format!("the report of bake {id}");
    Ok(serde_json::from_slice(&report).map_err(|source| ClientError::Json { place: place(), source })?)
}

/// Removes chunks of an earlier bake and files that a killed process left half written: a bundle is a pure function of
/// scene and settings.
pub fn remove_left_over(out: &Path, manifest: &Manifest) -> Result<()> {
    let wanted: Vec<Digest> = chunk_refs(manifest).iter().map(|chunk| chunk.digest).collect();
    remove_files(out, |path| is_part(path) && matches!(stem(path), Some("manifest" | "report")))?;
    remove_files(&out.join(CHUNKS_FOLDER), |path| {
        let digest = stem(path).and_then(|stem| stem.parse::<Digest>().ok());
        digest.is_some_and(|digest| is_part(path) || wanted.binary_search(&digest).is_err())
    })
}

fn remove_files(folder: &Path, is_left_over: impl Fn(&Path) -> bool) -> Result<()> {
    let failed = |error: std::io::Error| {
        Failure::new(Exit::Failed, format!("cannot tidy {}", folder.display())).caused_by(&error)
    };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_file() && is_left_over(&path) {
            fs::remove_file(&path).map_err(failed)?;
        }
    }
    Ok(())
}

/// The name before the dot.
fn stem(path: &Path) -> Option<&str> {
    path.file_stem().and_then(OsStr::to_str)
}

/// Whether a file is one that `write_atomically` had not finished.
fn is_part(path: &Path) -> bool {
    path.extension().and_then(OsStr::to_str).is_some_and(|extension| extension.starts_with("part-"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_with_other_files_is_refused_and_an_empty_or_absent_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        assert!(refuse_foreign_folder(folder.path()).is_ok());
        assert!(refuse_foreign_folder(&folder.path().join("absent")).is_ok());
        let file = folder.path().join("diary.txt");
        fs::write(&file, "dear diary").unwrap();
        assert!(refuse_foreign_folder(folder.path()).is_err());
        assert!(refuse_foreign_folder(&file).is_err());
        fs::create_dir(folder.path().join(CHUNKS_FOLDER)).unwrap();
        assert!(refuse_foreign_folder(folder.path()).is_ok());
    }
}
