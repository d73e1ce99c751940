//! Writes every test scene to `tests/scenes`: `cargo run -p lightkiln-tests --bin generate-scenes`.

use std::path::Path;

use anyhow::Context;
use lightkiln_tests::scenes;

fn main() -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    std::fs::create_dir_all(&folder).with_context(|| format!("create {}", folder.display()))?;
    for (name, bytes) in scenes::all() {
        let path = folder.join(name).with_extension("glb");
        std::fs::write(&path, &bytes).with_context(|| format!("write {}", path.display()))?;
        println!("{:>9} bytes  {}", bytes.len(), path.display());
    }
    Ok(())
}
