//! Scenes that rays and bakes are measured in.

use std::env;
use std::path::{Path, PathBuf};

/// Scenes of the tests; `KILN_BENCH_SCENES` names files of others, with colons between them.
const SCENES: [&str; 3] = ["cornell.glb", "u_corridor.glb", "atrium.glb"];

/// Paths of all of them.
pub fn scenes() -> Vec<PathBuf> {
    let named = env::var("KILN_BENCH_SCENES").unwrap_or_default();
    let own = SCENES.iter().map(|name| Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name));
    own.chain(named.split(':').filter(|name| !name.is_empty()).map(PathBuf::from)).collect()
}
