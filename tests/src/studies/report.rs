//! The page of a study: question, command, table, plot, answer.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result};

use super::plot::{Line, svg};
use super::{Axis, BASE, EVALUATION, Measured, Study};

/// Writes `NAME.md` and `NAME.svg` into a folder.
pub fn write(study: &Study, measured: &[Measured], folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("create {}", folder.display()))?;
    let store = |name: String, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).with_context(|| format!("write {}", path.display()))
    };
    if let Some(plot) = plot(study, measured) {
        store(format!("{}.svg", study.name), plot)?;
    }
    store(format!("{}.md", study.name), page(study, measured))
}

fn plot(study: &Study, measured: &[Measured]) -> Option<String> {
    let mut lines: Vec<Line> = Vec::new();
    for bake in measured {
        let point = [bake.along(study.axis), 100.0 * bake.evaluated("rel_rmse")];
        match lines.last_mut().filter(|line| line.label == bake.line) {
            Some(line) => line.points.push(point),
            None => lines.push(Line { label: bake.line.clone(), points: vec![point] }),
        }
    }
    svg(study.question, &study.axis.words(study.varied), "relative RMSE of E_ind in %", &lines)
}

fn page(study: &Study, measured: &[Measured]) -> String {
    let mut out = format!("# {}\n\n{}\n\n", study.name, study.question);
    let _ = writeln!(out, "![relative RMSE]({}.svg)\n", study.name);
    let _ = writeln!(
        out,
        "`cargo build --release && cargo run --release -p lightkiln-tests --bin study -- {}`, with `{}` in every bake and\n\
         `kiln evaluate {}`:\n",
        study.name,
        [BASE, study.fixed].concat().join(" "),
        EVALUATION.join(" ")
    );
    let _ = writeln!(
        out,
        "| bake | {} | rel. RMSE | energy | p99 | transport | factors | uncovered | probes | receivers | bytes a receiver | Mrays |",
        study.varied
    );
    let _ = writeln!(out, "|---{}|", "|---".repeat(11));
    for bake in measured {
        let share = |value: f64| format!("{:.1} %", 100.0 * value);
        let _ = writeln!(
            out,
            "| {} | {} | {} | {:.3} | {} | {} | {} | {} | {} | {} | {:.0} | {:.0} |",
            bake.line,
            bake.value,
            share(bake.evaluated("rel_rmse")),
            bake.evaluated("energy_ratio"),
            share(bake.evaluated("p99")),
            share(bake.class("transport")),
            share(bake.class("factorisation")),
            share(bake.baked("uncovered_fraction")),
            bake.baked("probes"),
            bake.baked("receivers"),
            bake.baked("bytes_per_receiver"),
            bake.along(Axis::Megarays),
        );
    }
    let _ = write!(out, "\n{}\n", study.answer);
    out
}
