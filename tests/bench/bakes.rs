//! Where a bake's time, memory and bytes go, and how right it is: by stage, kind of ray and section of chunks.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

use lightkiln_proto::chunk::container::{Container, kind_of};
use lightkiln_proto::kinds::Kinds;
use serde_json::Value;

use crate::farm::{Usage, kiln};
use crate::report::row;
use crate::scenes::scenes;

const PRESET: &str = "medium";
/// Places and precision of the evaluation: an interval of some tenths of the error.
const EVALUATION: [&str; 4] = ["--receivers", "300", "--rel-error", "0.1"];
/// Pause between two looks at a bake.
const LOOK: Duration = Duration::from_millis(50);

/// Bakes every scene on one thread and on all.
pub fn measure() {
    let all = std::thread::available_parallelism().unwrap().get();
    for path in scenes() {
        let place = path.file_stem().unwrap().to_string_lossy().into_owned();
        let folder = tempfile::tempdir().unwrap();
        // One row where there is one processor.
        for threads in BTreeSet::from([1, all]) {
            let out = folder.path().join(format!("{threads}.kiln"));
            let (summary, usage) = baked(&path, &out, threads);
            let word = if threads == 1 { "one thread".to_owned() } else { format!("{threads} threads") };
            let peak_mib = usage.peak_memory >> 20;
            let cpu = usage.cpu.as_secs_f64();
            row(
                &format!("{PRESET} bake, {word}"),
                &place,
                &format!(
                    "{:.1} s, {cpu:.1} s of processors, {peak_mib} MiB at most",
                    seconds(&summary["elapsed_secs"])
                ),
            );
            row(&format!("its stages, {word}"), &place, &stages(&summary["stages"]));
        }
        let out = folder.path().join(format!("{all}.kiln"));
        let manifest = |bundle: &Path| fs::read(bundle.join("manifest.json")).unwrap();
        assert_eq!(manifest(&out), manifest(&folder.path().join("1.kiln")), "bytes differ by threads");
        let (summary, _) = baked(&path, &out, all);
        assert_eq!(summary["tasks_run"], 0, "a bake again runs no task");
        row("error, energy", &place, &evaluated(&path, &out));
        row("bytes a receiver by section", &place, &sections(&out, seconds(&summary["receivers"])));
    }
}

fn seconds(number: &Value) -> f64 {
    number.as_f64().unwrap()
}

/// Bakes into `out`, with a state folder beside it; the summary, and the process's usage.
fn baked(scene: &Path, out: &Path, threads: usize) -> (Value, Usage) {
    let mut command = kiln(&out.with_extension("state"));
    command.arg("bake").arg(scene).args(["--preset", PRESET, "--json", "--threads", &threads.to_string()]);
    let mut child = command.arg("--out").arg(out).stdout(Stdio::piped()).spawn().unwrap();
    let usage = watched(&mut child);
    (answer(child), usage)
}

/// Usage of a process until it ended.
fn watched(child: &mut Child) -> Usage {
    let mut usage = Usage::default();
    while child.try_wait().unwrap().is_none() {
        usage = Usage::of(child.id()).unwrap_or(usage);
        std::thread::sleep(LOOK);
    }
    usage
}

/// The object that a command ends with.
fn answer(mut child: Child) -> Value {
    let mut text = String::new();
    child.stdout.take().unwrap().read_to_string(&mut text).unwrap();
    assert!(child.wait().unwrap().success(), "{text}");
    serde_json::from_str(&text).unwrap()
}

/// Stages from the longest on.
fn stages(stages: &Value) -> String {
    let mut stages: Vec<(&String, f64)> =
        stages.as_object().unwrap().iter().map(|(stage, time)| (stage, seconds(time))).collect();
    stages.sort_by(|a, b| b.1.total_cmp(&a.1));
    stages.iter().map(|(stage, time)| format!("{stage} {time:.1} s")).collect::<Vec<_>>().join(", ")
}

/// Error and energy with their intervals.
fn evaluated(scene: &Path, out: &Path) -> String {
    let mut command = kiln(&out.with_extension("state"));
    command.arg("evaluate").arg(out).arg("--scene").arg(scene).args(EVALUATION).arg("--json");
    let found = answer(command.stdout(Stdio::piped()).spawn().unwrap());
    let interval = |name: &str| {
        let ends = &found["interval_95"][name];
        format!("{:.4} ({:.4} to {:.4})", seconds(&found[name]), seconds(&ends[0]), seconds(&ends[1]))
    };
    format!("error {}, energy {}", interval("rel_rmse"), interval("energy_ratio"))
}

/// Stored bytes of each section of the bundle's chunks over the receivers, heads and tables as one.
fn sections(out: &Path, receivers: f64) -> String {
    let rows: Vec<_> = Kinds::new().chunks().collect();
    let mut bytes: BTreeMap<String, u64> = BTreeMap::new();
    for file in fs::read_dir(out.join("chunks")).unwrap() {
        let chunk = fs::read(file.unwrap().path()).unwrap();
        let kind = kind_of(&chunk).unwrap();
        let known = rows.iter().find(|row| row.kind == kind).unwrap();
        let container = Container::whole(kind, &chunk).unwrap();
        let mut left = chunk.len() as u64;
        for (index, entry) in container.entries.iter().enumerate() {
            let stored = container.stored(index).unwrap().len() as u64;
            let (_, section) = known.sections.iter().find(|(tag, _)| *tag == entry.id.tag).unwrap();
            *bytes.entry(format!("{} {section}", known.name)).or_default() += stored;
            left -= stored;
        }
        *bytes.entry(format!("{} head", known.name)).or_default() += left;
    }
    let mut bytes: Vec<(String, u64)> = bytes.into_iter().collect();
    bytes.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
    let each = bytes.iter().map(|(section, bytes)| format!("{section} {:.1}", *bytes as f64 / receivers));
    each.collect::<Vec<_>>().join(", ")
}
