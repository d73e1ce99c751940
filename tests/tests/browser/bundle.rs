//! Bakes as bundles in a folder.

use std::fs;
use std::path::Path;

use lightkiln_tests::harness::{Recipe, bake};
use lightkiln_tests::scenes::{Flat, flat, lone_triangle};
use serde_json::json;
use tempfile::TempDir;

/// A bake in a folder that goes with it.
pub struct Bundle(TempDir);

impl Bundle {
    /// A draft of the stored Cornell box.
    pub fn cornell() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.glb");
        Self::bake(fs::read(path).unwrap(), 0)
    }

    /// A draft of a flat with glass, a texture and two lamps, some of whose receivers have near hits.
    pub fn flat() -> Self {
        Self::bake(flat(&Flat::default()), 16)
    }

    /// A draft of a single triangle.
    pub fn triangle() -> Self {
        Self::bake(lone_triangle(), 0)
    }

    fn bake(scene: Vec<u8>, near_hits: u32) -> Self {
        let settings = json!({
            "preset": "draft", "transport_rays": 128, "near_hits": near_hits, "near_texels": 4.0,
        });
        let bake = bake(scene, &Recipe { kind: "prt", settings }).unwrap();
        let folder = tempfile::tempdir().unwrap();
        bake.write(folder.path()).unwrap();
        Self(folder)
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.0.path()
    }
}
