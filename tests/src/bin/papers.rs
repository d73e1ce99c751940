//! Makes the figures of the papers on probes again, and writes `tests/studies/papers.md`:
//! `cargo run --release -p lightkiln-tests --bin papers`. With names of tables it prints these and writes nothing.

use std::path::Path;

use anyhow::{Context, Result, bail};
use lightkiln_tests::studies::papers::TABLES;

const HEAD: &str = "# Figures of the papers on probes\n\nThe figures of [Sukys2014] and [Luo2022], made again with kind `captured` at draft on scenes of this repository \
                    (`cargo run --release -p lightkiln-tests --bin papers` writes this page). Their scenes are not published, so shapes are compared, not values.\n";

fn main() -> Result<()> {
    let names: Vec<String> = std::env::args().skip(1).collect();
    if let Some(unknown) = names.iter().find(|name| TABLES.iter().all(|(known, _)| known != name)) {
        bail!("there is no table '{unknown}'; there are {}", TABLES.map(|(name, _)| name).join(", "));
    }
    let mut page = HEAD.to_owned();
    for (name, make) in TABLES {
        if names.is_empty() || names.iter().any(|wanted| wanted == name) {
            let text = make()?.markdown();
            println!("{text}");
            page += &format!("\n{text}");
        }
    }
    if !names.is_empty() {
        return Ok(());
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies/papers.md");
    std::fs::write(&path, page).with_context(|| format!("write {}", path.display()))
}
