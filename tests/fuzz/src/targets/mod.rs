//! Everything that reads foreign bytes, each as one function: no panic, no more memory than such bytes may ask for,
//! and what is taken says the same when it is written again.

mod chunks;
mod container;
mod layers;
#[path = "../../../../server/tests/model/mod.rs"]
mod model;
mod scenes;
mod server;
mod texts;

/// A reader of foreign bytes.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, also that of the fuzz target.
    pub name: &'static str,
    /// Reads the bytes; whether they were taken. Errors must have words.
    pub read: fn(&[u8]) -> bool,
    /// Reads the bytes and holds what comes out against its rules.
    pub check: fn(&[u8]),
    /// Good input to start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Most bytes of memory that reading so many bytes may take at a time.
    pub memory_max: fn(usize) -> u64,
}

/// All of them.
pub const TARGETS: [Target; 18] = [
    chunks::CLUSTER,
    layers::LAYERS,
    chunks::PROBES,
    chunks::FIELD,
    chunks::TETRAHEDRA,
    chunks::VOXELS,
    chunks::TRANSFER,
    chunks::GEOMETRY,
    chunks::TEXTURE,
    chunks::PATCHES,
    chunks::DIRECTORY,
    texts::MANIFEST,
    texts::JOB,
    scenes::BUNDLE,
    scenes::GLTF,
    server::RANGE,
    server::CURSOR,
    server::PLACE,
];

/// Checks the bytes with the target of that name.
#[allow(dead_code, reason = "libFuzzer's programs call it; the ordinary tests walk the list")]
pub fn run(name: &str, bytes: &[u8]) {
    let target = TARGETS.iter().find(|target| target.name == name).expect("a target of that name");
    (target.check)(bytes);
}

/// Whether it was taken. An error says something, in a text of bearable length.
fn taken<T, E: std::fmt::Display>(result: &Result<T, E>) -> bool {
    if let Err(error) = result {
        let told = error.to_string();
        assert!((10..4000).contains(&told.len()), "an error of {} bytes: {told:.200}", told.len());
    }
    result.is_ok()
}
