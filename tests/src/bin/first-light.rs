//! Measures overviews of a bake, `tests/studies/first-light.md`:
//! `cargo run --release -p lightkiln-tests --bin first-light -- BUNDLE SCENE LEVEL,STRIDE,RANK_ERROR…`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use lightkiln_tests::studies::first_light::{Size, Whole};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bundle, scene, sizes @ ..] = &arguments[..] else {
        bail!("give a bundle, its scene, and sizes as LEVEL,STRIDE,RANK_ERROR, e.g. 3,4,0.05");
    };
    let sizes: Vec<Size> = sizes.iter().map(|size| parsed(size)).collect::<Result<_>>()?;
    let whole = Whole::read(Path::new(bundle), Path::new(scene))?;
    println!(
        "| level | stride | rank error | receivers | bytes | of all light | error | energy | by light |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for size in sizes {
        let found = whole.first_light(size)?;
        let energies = || found.lights.iter().map(|(_, _, energy)| *energy);
        let [low, high] = [energies().fold(f64::INFINITY, f64::min), energies().fold(0.0, f64::max)];
        let by_light: Vec<String> =
            found.lights.iter().map(|(name, error, _)| format!("{name} {:.0} %", 100.0 * error)).collect();
        println!(
            "| {} | {} | {} | {} | {} | {:.1} % | {:.0} % | {low:.2} to {high:.2} | {} |",
            size.level,
            size.stride,
            size.bounds.error_max,
            found.receivers,
            found.bytes,
            100.0 * found.share,
            100.0 * found.error(),
            by_light.join(", ")
        );
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
