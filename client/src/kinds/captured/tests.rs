//! Bundles of captured light, whole and contradicting themselves.

use std::path::Path;

use lightkiln_proto::kinds::field;
use lightkiln_proto::manifest::{ChunkRef, Manifest};
use serde_json::{Value, json};

use super::*;
use crate::bake::LoadedBake;
use crate::fixture::{self, rewrite_manifest, write_captured};
use crate::kinds;

fn opened(folder: &Path) -> Result<LoadedBake> {
    LoadedBake::load(&Source::bundle(folder)?, &kinds::all())
}

/// Words for a bundle whose manifest was changed.
fn refused(is_lattice: bool, change: impl FnOnce(&Path, &mut Manifest)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut manifest = write_captured(folder.path(), is_lattice);
    change(folder.path(), &mut manifest);
    rewrite_manifest(folder.path(), manifest);
    match opened(folder.path()) {
        Ok(_) => "nothing".to_owned(),
        Err(error) => format!("{error}: {:?}", std::error::Error::source(&error).map(ToString::to_string)),
    }
}

fn of_field(manifest: &mut Manifest) -> &mut Vec<ChunkRef> {
    manifest.chunks.get_mut(FIELD).unwrap()
}

fn totals(manifest: &mut Manifest) -> &mut Value {
    &mut manifest.body["field"]
}

#[test]
fn bundles_load() {
    for is_lattice in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        write_captured(folder.path(), is_lattice);
        let loaded = opened(folder.path()).unwrap();
        let other = fixture::captured_bake(is_lattice);
        assert_eq!(loaded.scene.manifest.kind, other.scene.manifest.kind);
    }
}

#[test]
fn contradictions_are_named() {
    let with_lightmap = |_: &Path, manifest: &mut Manifest| {
        manifest.lightmap = fixture::manifest("prt").lightmap;
    };
    let cases = [
        ("has a lightmap", refused(true, with_lightmap)),
        ("the manifest says 7", refused(true, |_, manifest| totals(manifest)["probes"] = json!(7))),
        (
            "chunks hold 0 probes, the manifest says 18",
            refused(true, |_, manifest| of_field(manifest).clear()),
        ),
        ("spacing", refused(true, |_, manifest| totals(manifest)["spacing_m"] = json!(1e39))),
        ("its body is not one of kind", refused(true, |_, manifest| totals(manifest)["rank"] = json!(1))),
        ("body is not one of", refused(true, |_, manifest| manifest.body = json!({}))),
        (
            "0 sets of tetrahedra, wanted 1",
            refused(false, |_, manifest| drop(manifest.chunks.remove(TETRAHEDRA))),
        ),
        (
            "1 sets of tetrahedra, wanted 0",
            refused(false, |_, manifest| manifest.settings["field_structure"] = json!(0)),
        ),
        (
            "2 sets of tetrahedra",
            refused(false, |_, manifest| {
                let sets = manifest.chunks.get_mut(TETRAHEDRA).unwrap();
                sets.push(sets[0].clone());
            }),
        ),
        (
            "a second probe at",
            refused(true, |_, manifest| {
                let parts = of_field(manifest);
                parts.push(parts[0].clone());
            }),
        ),
        ("light from emitter 1", refused(true, named_otherwise)),
    ];
    for (wanted, said) in cases {
        assert!(said.contains(wanted), "'{wanted}' is not in '{said}'");
    }
}

/// The chunk's light is that of a second emitter.
fn named_otherwise(folder: &Path, manifest: &mut Manifest) {
    let source = Source::bundle(folder).unwrap();
    let bytes = source.chunk(&manifest.chunks(FIELD)[0]).unwrap();
    let mut part = decode_field(&bytes).unwrap();
    part.emitters[0].emitter = 1;
    let chunk = fixture::write_chunk(folder, &field::encode_field(&part, 0.01).unwrap().bytes);
    *of_field(manifest) = vec![chunk];
}
