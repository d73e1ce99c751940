//! Uploads: formats, zips, packing from disk, and names that try to leave.

use std::fs;
use std::io::{Cursor, Write as _};

use base64::Engine as _;
use serde_json::json;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::document_builder::{Document, import_bytes};
use crate::scene::uri;
use crate::scene::{Bundle, ImportError, Limits};

fn zip_of(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in entries {
        writer.start_file(*name, SimpleFileOptions::default()).unwrap();
        writer.write_all(content).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// The triangle as JSON with its buffer under `uri`, and the buffer.
fn external(uri: &str) -> (Vec<u8>, Vec<u8>) {
    let mut document = Document::triangle();
    document.json["buffers"][0]["uri"] = json!(uri);
    let bin = super::document_builder::TRIANGLE.iter().flat_map(|value| value.to_le_bytes()).collect();
    (serde_json::to_vec(&document.json).unwrap(), bin)
}

/// Names of the files in a zip.
fn names_in(zip: &[u8]) -> Vec<String> {
    let archive = zip::ZipArchive::new(Cursor::new(zip)).unwrap();
    archive.file_names().map(|name| name.unwrap().into_owned()).collect()
}

#[test]
fn gltf_with_data_uris_needs_no_files() {
    let (_, bin) = external("");
    let encoded = base64::engine::general_purpose::STANDARD.encode(&bin);
    for uri in [
        format!("data:application/octet-stream;base64,{encoded}"),
        format!("DATA:;base64,{}", encoded.trim_end_matches('=')),
        format!("data:;base64,{}", encoded.replace('=', "%3D")),
    ] {
        let (json, _) = external(&uri);
        let with_mark = [b"\xEF\xBB\xBF\n".as_slice(), &json].concat();
        assert_eq!(import_bytes(with_mark).unwrap().counts["triangles"], 1);
    }
    let broken = external("data:;base64,@@@@").0;
    assert!(matches!(import_bytes(broken), Err(ImportError::DataUri { .. })));
}

#[test]
fn zip_with_files_beside_and_above_the_gltf_is_read() {
    for (uri, entry) in
        [("a%20b.bin", "scene/a b.bin"), ("./x/../c.bin", "scene/c.bin"), ("../d\\e.bin", "d/e.bin")]
    {
        let (json, bin) = external(uri);
        let zip = zip_of(&[(entry, &bin), ("scene/s.gltf", &json), ("__MACOSX/scene/._s.gltf", b"junk")]);
        assert_eq!(import_bytes(zip).unwrap().counts["triangles"], 1, "{uri}");
    }
}

#[test]
fn missing_files_are_named_with_a_hint_for_other_capitals() {
    let (json, bin) = external("Mesh.BIN");
    let message = import_bytes(zip_of(&[("s.gltf", &json), ("mesh.bin", &bin)])).unwrap_err().to_string();
    assert!(message.contains("Mesh.BIN") && message.contains("mesh.bin"), "{message}");
    assert!(matches!(import_bytes(json), Err(ImportError::MissingFile { .. })));
}

#[test]
fn zip_names_that_climb_out_are_refused() {
    let (json, _) = external("a.bin");
    for name in ["../a.bin", "/a.bin", "x/../../a.bin", "..\\a.bin", "C:\\a.bin", "x/../y.bin"] {
        let zip = zip_of(&[("s.gltf", &json), (name, b"x")]);
        let refused = Bundle::from_bytes(zip, &Limits::default());
        assert!(matches!(refused, Err(ImportError::UnsafeEntry { .. })), "{name}: {refused:?}");
    }
}

#[test]
fn symbolic_links_in_a_zip_are_refused() {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    writer.add_symlink("s.gltf", "/etc/passwd", SimpleFileOptions::default()).unwrap();
    let zip = writer.finish().unwrap().into_inner();
    assert!(matches!(Bundle::from_bytes(zip, &Limits::default()), Err(ImportError::UnsafeEntry { .. })));
}

#[test]
fn zip_bomb_stops_at_the_limit() {
    let json = br#"{"asset":{"version":"2.0"},"images":[{"uri":"bomb"}]}"#;
    let zip = zip_of(&[("s.gltf", json), ("bomb", &vec![0; 8 << 20])]);
    assert!(zip.len() < 1 << 20);
    let limits = Limits { decompressed_bytes: 1 << 20, ..Limits::default() };
    let refused = Bundle::from_bytes(zip, &limits).unwrap_err();
    let ImportError::LimitExceeded { found, limit, .. } = refused else { panic!("{refused}") };
    assert_eq!((found, limit), ((1 << 20) + 1, 1 << 20));
    let message = refused.to_string();
    assert!(message.contains("zip -0") && !message.contains("simplify the scene"), "{message}");
}

#[test]
fn small_zips_may_not_decompress_to_much_however_high_the_limit() {
    let json = br#"{"asset":{"version":"2.0"},"images":[{"uri":"bomb"}]}"#;
    let zip = zip_of(&[("s.gltf", json), ("bomb", &vec![0; 8 << 20])]);
    let limits = Limits { expansion_free_bytes: 1 << 20, ..Limits::default() };
    let most = (1 << 20) + 32 * zip.len() as u64;
    let Err(ImportError::LimitExceeded { found, .. }) = Bundle::from_bytes(zip.clone(), &limits) else {
        panic!("must be refused")
    };
    assert_eq!(found, most + 1);
    assert!(Bundle::from_bytes(zip, &Limits::default()).is_ok());
}

#[test]
fn files_that_the_gltf_does_not_name_and_bytes_that_it_does_not_read_stay_compressed() {
    let (json, mut bin) = external("a.bin");
    bin.resize(8 << 20, 0);
    let zip = zip_of(&[("s.gltf", &json), ("a.bin", &bin), ("bomb", &bin)]);
    let limits = Limits { decompressed_bytes: 1 << 20, ..Limits::default() };
    let bundle = Bundle::from_bytes(zip, &limits).unwrap();
    assert_eq!(crate::scene::import(&bundle, &limits).unwrap().counts["triangles"], 1);
}

#[test]
fn scenes_of_equal_bytes_are_packed_so_that_they_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    let (json, mut bin) = external("a.bin");
    bin.resize(8 << 20, 0);
    fs::write(folder.path().join("s.gltf"), json).unwrap();
    fs::write(folder.path().join("a.bin"), bin).unwrap();
    let limits = Limits { expansion_free_bytes: 1 << 10, ..Limits::default() };
    let packed = Bundle::pack_path(&folder.path().join("s.gltf"), &limits).unwrap();
    assert!(Bundle::from_bytes(packed, &limits).is_ok());
}

#[test]
fn zips_with_too_many_or_too_deep_files_are_refused() {
    let names: Vec<String> = (0..9).map(|i| format!("{i}.png")).collect();
    let entries: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), b"".as_slice())).collect();
    let limits = Limits { files: 8, ..Limits::default() };
    assert!(matches!(Bundle::from_bytes(zip_of(&entries), &limits), Err(ImportError::LimitExceeded { .. })));
    let deep = "a/".repeat(40) + "s.gltf";
    let refused = Bundle::from_bytes(zip_of(&[(&deep, b"{}")]), &Limits::default());
    assert!(matches!(refused, Err(ImportError::LimitExceeded { .. })));
}

#[test]
fn zip_must_hold_exactly_one_gltf() {
    for (entries, wanted) in [
        ([("a.txt", b"".as_slice()), ("b.txt", b"")], 0),
        ([("a.gltf", b"{}".as_slice()), ("b.glb", b"")], 2),
    ] {
        let Err(ImportError::RootCount { found, .. }) =
            Bundle::from_bytes(zip_of(&entries), &Limits::default())
        else {
            panic!("must be refused")
        };
        assert_eq!(found, wanted);
    }
}

#[test]
fn truncated_and_flipped_zips_never_panic() {
    let (json, bin) = external("a.bin");
    let zip = zip_of(&[("s.gltf", &json), ("a.bin", &bin)]);
    for length in 0..zip.len() {
        assert!(import_bytes(zip[..length].to_vec()).is_err());
    }
    for position in 0..zip.len() {
        let mut flipped = zip.clone();
        flipped[position] ^= 0xFF;
        let _ = import_bytes(flipped);
    }
}

#[test]
fn other_bytes_are_no_known_format() {
    for bytes in [b"".as_slice(), b"hello", b"\x89PNG", b"[1]"] {
        assert!(matches!(import_bytes(bytes.to_vec()), Err(ImportError::UnknownFormat)));
    }
}

#[test]
fn other_gltf_versions_are_refused() {
    let mut document = Document::triangle();
    document.json["asset"] = json!({"version": "1.0"});
    assert!(matches!(document.import(), Err(ImportError::Version { .. })));
    document.json["asset"] = json!({"version": "2.1", "minVersion": "2.1"});
    assert!(matches!(document.import(), Err(ImportError::Version { .. })));
    document.json["asset"] = json!({"version": "2.1"});
    assert!(document.import().is_ok());
}

#[test]
fn gltf_1_with_tables_for_lists_is_told_by_its_version_and_not_said_to_be_broken() {
    let tables =
        r#""meshes": {"m": {}}, "nodes": {"n": {}}, "scene": "s", "scenes": {"s": {"nodes": ["n"]}}"#;
    let number = format!(r#"{{"asset": {{"version": 1.0}}, {tables}}}"#);
    for json in [format!(r#"{{"asset": {{"version": "1.0"}}, {tables}}}"#), format!("{{{tables}}}"), number] {
        let refused = import_bytes(json.into_bytes()).unwrap_err();
        let message = refused.to_string();
        assert!(matches!(refused, ImportError::Version { .. }), "{message}");
        assert!(message.contains("1.0") && message.contains("gltf-pipeline"), "{message}");
    }
}

#[test]
fn json_that_is_no_gltf_is_told_from_json_that_is_broken() {
    let refused = |json: &str| import_bytes(json.as_bytes().to_vec()).unwrap_err();
    assert!(matches!(refused(r#"{"asset": {"version": "2.0"}, "#), ImportError::Json { .. }));
    assert!(matches!(refused(r#"{"scenes": []}"#), ImportError::NotGltf { .. }));
    assert!(matches!(refused(r#"{"asset": {"version": "2.0"}, "nodes": {}}"#), ImportError::NotGltf { .. }));
}

#[test]
fn scenes_may_leave_out_their_nodes() {
    for scenes in [r#"[{}]"#, r#"[ { "name": "a{\"nodes\"" }, {"nodes": [0]}, {}]"#] {
        let json =
            format!(r#"{{"asset": {{"version": "2.0"}}, "nodes": [{{}}], "scenes": {scenes}, "scene": 0}}"#);
        let imported = import_bytes(json.into_bytes()).unwrap();
        let why = &imported.warnings.last().unwrap().message;
        assert!(why.contains("no meshes"), "{why}");
    }
    let mut document = Document::triangle();
    document.json["scenes"] = json!([{"name": "empty"}, {"nodes": [0]}]);
    document.json["scene"] = json!(1);
    assert_eq!(document.import().unwrap().counts["triangles"], 1);
}

#[test]
fn scenes_without_triangles_say_why() {
    let mut document = Document::triangle();
    let why = |document: &Document| document.import().unwrap().warnings.pop().unwrap().message;
    document.json["nodes"][0]["scale"] = json!([0, 0, 0]);
    assert!(why(&document).contains("scaled to 0"));
    document.json["nodes"] = json!([{}]);
    assert!(why(&document).contains("no node places one"));
}

#[test]
fn packing_is_deterministic_and_takes_only_what_the_gltf_names() {
    let (json, bin) = external("parts/a%20b.bin");
    let pack = || {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("parts")).unwrap();
        fs::write(folder.path().join("s.gltf"), &json).unwrap();
        fs::write(folder.path().join("parts/a b.bin"), &bin).unwrap();
        fs::write(folder.path().join("secret.txt"), "x").unwrap();
        Bundle::pack_path(&folder.path().join("s.gltf"), &Limits::default()).unwrap()
    };
    let packed = pack();
    assert_eq!(packed, pack());
    assert_eq!(names_in(&packed), ["parts/a b.bin", "s.gltf"]);
    assert_eq!(import_bytes(packed).unwrap().counts["triangles"], 1);
}

#[test]
fn self_contained_files_are_packed_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let glb = Document::triangle().glb();
    let zip = zip_of(&[("s.glb", &glb)]);
    for (name, bytes) in [("s.glb", &glb), ("s.zip", &zip)] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        assert_eq!(&Bundle::pack_path(&path, &Limits::default()).unwrap(), bytes);
    }
}

#[test]
fn packing_refuses_files_outside_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("secret.bin"), [0; 36]).unwrap();
    let inside = folder.path().join("scene");
    fs::create_dir(&inside).unwrap();
    let absolute = folder.path().join("secret.bin").to_string_lossy().into_owned();
    let uris = ["../secret.bin", "%2E%2E/secret.bin", "x/../../secret.bin", "https://example.org/a.bin"];
    for uri in uris.into_iter().chain([absolute.as_str(), "file:///etc/passwd"]) {
        fs::write(inside.join("s.gltf"), external(uri).0).unwrap();
        let refused = Bundle::pack_path(&inside.join("s.gltf"), &Limits::default());
        assert!(matches!(refused, Err(ImportError::OutsidePath { .. })), "{uri}: {refused:?}");
    }
}

#[test]
fn files_above_the_scene_are_packed_from_a_root_that_holds_them() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("project");
    let levels = root.join("data/levels");
    fs::create_dir_all(&levels).unwrap();
    fs::create_dir(root.join("parts")).unwrap();
    let (json, bin) = external("../../parts/a%20b.bin");
    let path = levels.join("s.gltf");
    fs::write(&path, json).unwrap();
    fs::write(root.join("parts/a b.bin"), &bin).unwrap();
    let limits = Limits::default();
    let refused = Bundle::pack_path(&path, &limits).unwrap_err();
    assert!(refused.is_of_wider_folder(), "{refused}");
    assert!(Bundle::pack_path_in(&root.join("data"), &path, &limits).unwrap_err().is_of_wider_folder());
    let packed = Bundle::pack_path_in(&root, &path, &limits).unwrap();
    assert_eq!(names_in(&packed), ["data/levels/s.gltf", "parts/a b.bin"]);
    assert_eq!(import_bytes(packed).unwrap().counts["triangles"], 1);
    let elsewhere = Bundle::pack_path_in(&root.join("parts"), &path, &limits);
    assert!(matches!(elsewhere, Err(ImportError::OutsideRoot { .. })), "{elsewhere:?}");
    // A file above the root is as far away as ever.
    fs::write(folder.path().join("secret.bin"), bin).unwrap();
    fs::write(&path, external("../../../secret.bin").0).unwrap();
    assert!(matches!(Bundle::pack_path_in(&root, &path, &limits), Err(ImportError::OutsidePath { .. })));
}

#[cfg(unix)]
#[test]
fn packing_refuses_symbolic_links_out_of_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("secret.bin"), [0; 36]).unwrap();
    let inside = folder.path().join("scene");
    fs::create_dir(&inside).unwrap();
    std::os::unix::fs::symlink(folder.path().join("secret.bin"), inside.join("a.bin")).unwrap();
    fs::write(inside.join("s.gltf"), external("a.bin").0).unwrap();
    let refused = Bundle::pack_path(&inside.join("s.gltf"), &Limits::default());
    assert!(matches!(refused, Err(ImportError::OutsidePath { .. })));
}

#[test]
fn packing_names_missing_files() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("s.gltf"), external("gone.bin").0).unwrap();
    let message =
        Bundle::pack_path(&folder.path().join("s.gltf"), &Limits::default()).unwrap_err().to_string();
    assert!(message.contains("gone.bin"), "{message}");
    // Compressed views need no fallback.
    let mut stand_in: serde_json::Value = serde_json::from_slice(&external("gone.bin").0).unwrap();
    stand_in["buffers"][0]["extensions"] = serde_json::json!({"EXT_meshopt_compression": {"fallback": true}});
    let path = folder.path().join("fallback.gltf");
    fs::write(&path, stand_in.to_string()).unwrap();
    assert!(Bundle::pack_path(&path, &Limits::default()).is_ok());
    let nowhere = Bundle::pack_path(&folder.path().join("none.gltf"), &Limits::default());
    assert!(matches!(nowhere, Err(ImportError::Io { .. })));
}

#[test]
fn resolved_names_never_leave_their_folder() {
    assert_eq!(uri::resolve("a/b", "../c.bin").unwrap(), "a/c.bin");
    assert_eq!(uri::resolve("", "a:b").unwrap_err(), "is not a relative path");
    for path in ["", ".", "a/..", "..", "../a", "/a", "\\a", "a\0"] {
        assert!(uri::resolve("", path).is_err(), "{path:?}");
    }
}
