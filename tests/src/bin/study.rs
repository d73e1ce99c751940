//! Runs measured studies and writes their pages:
//! `cargo build --release && cargo run --release -p lightkiln-tests --bin study -- [NAME…]`; all of them without a name.

use std::path::Path;

use anyhow::{Context, Result, bail};
use lightkiln_tests::studies::{Kiln, STUDIES, Study, write};

fn main() -> Result<()> {
    let names: Vec<String> = std::env::args().skip(1).collect();
    let chosen: Vec<&Study> = STUDIES
        .iter()
        .filter(|study| names.is_empty() || names.iter().any(|name| name == study.name))
        .collect();
    if let Some(unknown) = names.iter().find(|name| STUDIES.iter().all(|study| study.name != **name)) {
        let known: Vec<&str> = STUDIES.iter().map(|study| study.name).collect();
        bail!("there is no study '{unknown}'; there are {}", known.join(", "));
    }
    let here = std::env::current_exe().context("find this program")?;
    // Both programs are built into one folder.
    let kiln = Kiln::new(&here.with_file_name(format!("kiln{}", std::env::consts::EXE_SUFFIX)))?;
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("studies");
    for study in chosen {
        println!("{}: {}", study.name, study.question);
        let measured = kiln.run(study, |bake| {
            let (error, energy) = (100.0 * bake.evaluated("rel_rmse"), bake.evaluated("energy_ratio"));
            println!("  {} {}={}: {error:.1} %, energy {energy:.3}", bake.line, study.varied, bake.value);
        })?;
        write(study, &measured, &folder)?;
    }
    Ok(())
}
