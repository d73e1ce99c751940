//! Measures overviews of a bake, `tests/studies/first-light.md`:
//! `cargo run --release -p lightkiln-tests --bin first-light -- BUNDLE SCENE LEVEL,STRIDE,RANK_ERROR…`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use lightkiln_tests::studies::first_light::{OfLight, SHARES, Size, Whole};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bundle, scene, sizes @ ..] = &arguments[..] else {
        bail!("give a bundle, its scene, and sizes as LEVEL,STRIDE,RANK_ERROR, e.g. 3,4,0.05");
    };
    let sizes: Vec<Size> = sizes.iter().map(|size| parsed(size)).collect::<Result<_>>()?;
    let whole = Whole::read(Path::new(bundle), Path::new(scene))?;
    for size in sizes {
        let found = whole.first_light(size)?;
        println!(
            "\nlevel {}, stride {}, rank error {}: {} receivers, {} bytes, {:.1} % of all light, error {:.0} %\n",
            size.level,
            size.stride,
            size.bounds.error_max,
            found.receivers,
            found.bytes,
            100.0 * found.share,
            100.0 * found.error(),
        );
        let shares: Vec<String> = SHARES.iter().map(|share| format!("+ {:.0} %", 100.0 * share)).collect();
        println!("| light | energy | {} | best overview |", shares.join(" | "));
        println!("|---|---|{}---|", "---|".repeat(SHARES.len()));
        for OfLight { name, energy, by_need, by_error, best } in &found.lights {
            let errors = by_need.iter().zip(by_error);
            let errors: Vec<String> =
                errors.map(|(need, error)| format!("{:.0} ({:.0})", 100.0 * need, 100.0 * error)).collect();
            println!("| {name} | {energy:.2} | {} | {:.0} |", errors.join(" | "), 100.0 * best);
        }
    }
    Ok(())
}

fn parsed(text: &str) -> Result<Size> {
    let numbers: Vec<&str> = text.split(',').collect();
    let [level, stride, error] = numbers[..] else { bail!("'{text}' is not LEVEL,STRIDE,RANK_ERROR") };
    let stride: u16 = stride.parse().with_context(|| format!("'{stride}' is no stride"))?;
    if stride == 0 {
        bail!("a stride is at least 1");
    }
    let level = level.parse().with_context(|| format!("'{level}' is no level"))?;
    let error = error.parse().with_context(|| format!("'{error}' is no error"))?;
    Ok(Size::new(level, stride, error))
}
