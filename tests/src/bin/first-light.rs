//! Measures overviews of a bake, `tests/studies/first-light.md`:
//! `cargo run --release -p lightkiln-tests --bin first-light -- BUNDLE SCENE LEVEL,STRIDE,RANK_ERROR…`, or light as a client has it
//! after shares of all bytes, in %: `… -- BUNDLE SCENE layers SHARE…`, or how long it takes over a line: `… -- BUNDLE line RTT_MS MBIT_PER_SEC`.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use lightkiln_client::fetch::Source;
use lightkiln_proto::chunk::LAYERS_MAX;
use lightkiln_tests::studies::first_light::{
    FirstOverLine, Line, OfLight, SHARES, Size, Stored, Streamed, Whole, first_over_line,
};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [bundle, word, rtt_ms, mbit] = &arguments[..]
        && word == "line"
    {
        return line(Path::new(bundle), rtt_ms, mbit);
    }
    let [bundle, scene, sizes @ ..] = &arguments[..] else {
        bail!("give a bundle, its scene, and sizes as LEVEL,STRIDE,RANK_ERROR, e.g. 3,4,0.05");
    };
    if let [word, shares @ ..] = sizes
        && word == "layers"
    {
        return layers(Path::new(bundle), Path::new(scene), shares);
    }
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

/// Time of first light over a line.
fn line(bundle: &Path, rtt_ms: &str, mbit: &str) -> Result<()> {
    let number = |text: &str| text.parse::<f64>().with_context(|| format!("'{text}' is no number"));
    let line = Line {
        rtt: Duration::from_secs_f64(number(rtt_ms)? / 1e3),
        bytes_per_sec: number(mbit)? * 1e6 / 8.0,
    };
    let FirstOverLine { requests, bytes, last_byte, ready } = first_over_line(bundle, line)?;
    let [last_byte, ready] = [last_byte, ready].map(|time| time.as_secs_f64());
    println!(
        "{requests} requests, {bytes} bytes: the last byte after {last_byte:.2} s, first light after {ready:.2} s"
    );
    Ok(())
}

/// Light by layers, and by whole clusters.
fn layers(bundle: &Path, scene: &Path, shares: &[String]) -> Result<()> {
    let share = |text: &String| -> Result<f64> {
        Ok(text.parse::<f64>().with_context(|| format!("'{text}' is no share in %"))? / 100.0)
    };
    let shares: Vec<f64> = shares.iter().map(share).collect::<Result<_>>()?;
    let whole = Whole::read(bundle, scene)?;
    let stored = Stored::read(&Source::bundle(bundle)?)?;
    let print = |title: &str, found: Vec<Streamed>| {
        println!("\n{title}\n\n| light | bytes | clusters | of them whole | energy | error |");
        println!("|---|---|---|---|---|---|");
        for Streamed { light, share, clusters: [some, all], energy, error } in found {
            let (share, error) = (100.0 * share, 100.0 * error);
            println!("| {light} | {share:.1} % | {some} | {all} | {energy:.3} | {error:.1} % |");
        }
    };
    print("by layers", whole.streamed(&stored, &shares, true)?);
    print("by whole clusters", whole.streamed(&stored, &shares, false)?);
    for layers in 1..LAYERS_MAX {
        print(&format!("{layers} layers of every cluster"), whole.of_layers(&stored, layers)?);
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
