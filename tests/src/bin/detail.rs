//! Measures levels of detail of a bake, `tests/studies/lod.md`:
//! `cargo run --release -p lightkiln-tests --bin detail -- pictures|frames|walks BUNDLE CAMERA LIGHTS "NAME: words"…`, lights with semicolons
//! between them, words as of `kiln preview --lod`; `walks` of every so manieth pixel takes none. `KILN_KEEP_PICTURES` names a folder for pictures and their differences.

use std::env;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lightkiln_tests::studies::detail::{Found, Moved, Setup, Stage, Walked, moved, walked};

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [what, bundle, camera, lights, setups @ ..] = &arguments[..] else {
        bail!(
            "give pictures, frames or walks, a bundle, a camera, lights with ; between them, and setups as \"NAME: words\""
        );
    };
    let setups: Vec<Setup> = setups.iter().map(|setup| Setup::parse(setup)).collect::<Result<_>>()?;
    let mut stage = Stage::open(Path::new(bundle))?;
    let lights: Vec<String> = lights.split(';').map(|light| light.trim().to_owned()).collect();
    let view = stage.view(camera, &lights)?;
    println!("{}\n", stage.adapter());
    if let Some([with, all]) = stage.stand_ins() {
        let share = 100.0 * with as f64 / all.max(1) as f64;
        println!("{with} of {all} receivers have stand-ins ({share:.1} %)\n");
    }
    let folder = env::var_os("KILN_KEEP_PICTURES").map(PathBuf::from);
    match what.as_str() {
        "pictures" => {
            print(&stage.measured(&view, &setups, folder.as_deref())?);
        }
        "frames" => print_moved(&moved(&mut stage, &view, &setups)?),
        "walks" => print_walked(&walked(&stage, &view, folder.as_deref())?),
        other => bail!("'{other}' is neither pictures, frames nor walks"),
    }
    Ok(())
}

fn print(found: &[Found]) {
    println!(
        "| | receivers computed | numbers read | a bounce | of the processor | speed-up | SSIM | error of E_ind | energy |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let cost_ms = |row: &Found| row.processor_ms.unwrap_or(row.bounce_ms);
    let all_ms = found.first().map_or(0.0, cost_ms);
    for row in found {
        let Found { name, bounce_ms, error, energy, ssim, .. } = row;
        let receivers = row.receivers().map_or("all".to_owned(), |[computed, _]| computed.to_string());
        let numbers = row.numbers().map_or("all".to_owned(), |share| format!("{:.1} %", 100.0 * share));
        let processor = row.processor_ms.map_or("-".to_owned(), |ms| format!("{ms:.1} ms"));
        println!(
            "| {name} | {receivers} | {numbers} | {bounce_ms:.1} ms | {processor} | {:.2} | {ssim:.4} | {:.2} % | {energy:.3} |",
            all_ms / cost_ms(row),
            100.0 * error
        );
    }
}

fn print_walked(found: &[Walked]) {
    println!("| walks of every … pixel along a side | a frame | SSIM, of several samples | of one sample |");
    println!("|---|---|---|---|");
    for Walked { step, frame_ms, ssim, ssim_of_one } in found {
        println!("| {step} | {frame_ms:.1} ms | {ssim:.4} | {ssim_of_one:.4} |");
    }
}

fn print_moved(found: &[Moved]) {
    println!(
        "| | pixels change from frame to frame | over that with all detail | largest | E_ind changes | over that with all detail | largest |"
    );
    println!("|---|---|---|---|---|---|---|");
    let [all, all_indirect] = found.first().map_or([1.0; 2], |all| [all.change, all.indirect]);
    for Moved { name, change, change_max, indirect, indirect_max } in found {
        println!(
            "| {name} | {:.4} % | {:.4} | {:.3} % | {:.4} % | {:.4} | {:.3} % |",
            100.0 * change,
            change / all,
            100.0 * change_max,
            100.0 * indirect,
            indirect / all_indirect,
            100.0 * indirect_max
        );
    }
}
