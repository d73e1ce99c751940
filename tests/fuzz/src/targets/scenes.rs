//! Scenes that people upload: bundles as they are, and glTF whose JSON is changed while the file around it is whole.

use std::io::{Cursor, Write as _};

use lightkiln_worker::scene::{Bundle, ImportError, Limits, import};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::{Target, taken};

/// An upload: `.glb`, `.gltf` or `.zip`.
pub const BUNDLE: Target = Target {
    name: "bundle",
    read: |bytes| taken(&import_bytes(bytes.to_vec())),
    check: |bytes| check(bytes.to_vec()),
    seeds: bundles,
    memory_max,
};

/// The JSON of a glTF, then a zero byte, then the bytes of its buffer.
pub const GLTF: Target = Target {
    name: "gltf",
    read: |bytes| taken(&import_bytes(glb(bytes))),
    check: |bytes| check(glb(bytes)),
    seeds: || scenes().map(parts).to_vec(),
    memory_max,
};

/// Small bounds, so that what a file says of sizes shows where it is believed.
fn limits() -> Limits {
    Limits {
        bundle_bytes: 1 << 20,
        decompressed_bytes: 4 << 20,
        files: 64,
        json_bytes: 1 << 20,
        nodes: 10_000,
        instances: 10_000,
        triangles: 20_000,
        vertices: 60_000,
        sparse_elements: 60_000,
        path_bytes: 1 << 20,
        zero_elements: 60_000,
        decoded_bytes: 4 << 20,
        texture_pixels_each: 1 << 20,
        texture_pixels_total: 2 << 20,
        ..Limits::default()
    }
}

/// Memory that [`limits`] allow, with room: 60,000 vertices of some 100 bytes, two million pixels of up to 16 bytes, four MiB of
/// files, and a JSON tree of several hundred bytes for each byte.
fn memory_max(bytes: usize) -> u64 {
    (64 << 20) + 1000 * bytes as u64
}

fn import_bytes(bytes: Vec<u8>) -> Result<lightkiln_worker::scene::model::Imported, ImportError> {
    import(&Bundle::from_bytes(bytes, &limits())?, &limits())
}

fn check(bytes: Vec<u8>) {
    let Ok(imported) = import_bytes(bytes.clone()) else { return };
    for instance in &imported.scene.instances {
        let count = instance.positions_m.len();
        assert!(instance.triangles.as_flattened().iter().all(|&index| (index as usize) < count));
        assert!(instance.positions_m.iter().all(|position| position.is_finite()), "a position is no number");
    }
    assert!(imported.counts["triangles"] <= limits().triangles);
    assert_eq!(import_bytes(bytes).expect("the same bytes"), imported, "the same bytes, another scene");
}

fn scenes() -> [&'static [u8]; 5] {
    [
        include_bytes!("../../../scenes/furnace.glb"),
        include_bytes!("../../../scenes/cornell.glb"),
        include_bytes!("../../../scenes/sealed_box.glb"),
        // The first one, compressed by glTF Transform.
        include_bytes!("furnace-draco.glb"),
        include_bytes!("furnace-meshopt.glb"),
    ]
}

fn bundles() -> Vec<Vec<u8>> {
    let mut seeds: Vec<Vec<u8>> = scenes().map(<[u8]>::to_vec).to_vec();
    let text = br#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":36,"uri":"b.bin"}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"images":[{"uri":"i%20j.png"}],"textures":[{"source":0}],
        "materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"material":0}]}],
        "nodes":[{"mesh":0,"scale":[2,1,1]}],"scenes":[{"nodes":[0]}],"scene":0}"#;
    let corners: Vec<u8> =
        [0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    seeds.push(text.to_vec());
    seeds.push(zip(&[("scene.gltf", text), ("b.bin", &corners), ("i j.png", PNG)]));
    seeds.push(zip(&[("folder/scene.glb", scenes()[0])]));
    seeds
}

fn zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(*name, SimpleFileOptions::default()).expect("a zip in memory");
        writer.write_all(bytes).expect("a zip in memory");
    }
    writer.finish().expect("a zip in memory").into_inner()
}

/// JSON, a zero byte, the buffer.
fn parts(glb: &[u8]) -> Vec<u8> {
    let length = u32::from_le_bytes([glb[12], glb[13], glb[14], glb[15]]) as usize;
    let (json, rest) = glb[20..].split_at(length);
    [json, b"\0", rest.get(8..).unwrap_or_default()].concat()
}

/// A whole GLB of JSON, a zero byte and the buffer.
fn glb(parts: &[u8]) -> Vec<u8> {
    let end = parts.iter().position(|&byte| byte == 0).unwrap_or(parts.len());
    let (json, bin) = (&parts[..end], parts.get(end + 1..).unwrap_or_default());
    let padded = |bytes: &[u8], with: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), with);
        bytes
    };
    let (json, bin) = (padded(json, b' '), padded(bin, 0));
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend(((28 + json.len() + bin.len()) as u32).to_le_bytes());
    for (kind, bytes) in [(b"JSON", json), (b"BIN\0", bin)] {
        glb.extend((bytes.len() as u32).to_le_bytes());
        glb.extend_from_slice(kind);
        glb.extend(bytes);
    }
    glb
}

/// Four pixels.
const PNG: &[u8] = include_bytes!("four-pixels.png");
