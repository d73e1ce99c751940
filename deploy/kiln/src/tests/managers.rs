//! Templates for render managers: each is read as its manager would, and what it would run is what the program takes.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::commands::assert_taken;
use super::{documents, root, texts};

/// The arguments of `kiln` in a JSON list of texts, which begins with its name.
fn assert_runs(place: &str, words: &Value) -> String {
    let words = texts(words);
    assert_eq!(words[0], "kiln", "{place}: {words:?}");
    let arguments: Vec<String> = words[1..].iter().map(|word| (*word).to_owned()).collect();
    assert_taken(place, &arguments);
    arguments[0].clone()
}

/// Standard output of a program that must end well.
fn output(command: &mut Command) -> String {
    let output = command.current_dir(root()).output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// A `kiln` that prints its arguments, a line each, and fills its cache.
const TALKING: &str = r#"#!/bin/sh
printf '%s\n' "$@"
while [ "$1" != --cache ]; do shift; done
mkdir -p "$2" && touch "$2/chunk"
"#;

/// A `kiln` that says when it works and each time that it is told to end, and ends with 7 a second after the first time.
const DRAINING: &str = r#"#!/bin/bash
(trap '' TERM && exec sleep 60) & work=$!
trap 'echo told; { sleep 1; kill -KILL $work; } 2>/dev/null &' TERM
echo works
while kill -0 $work 2>/dev/null; do wait $work; done
exit 7
"#;

/// The script for Slurm, which finds this `kiln` in the folder and has a disk for its cache there.
fn sbatch(kiln: &str, folder: &Path) -> Command {
    use std::os::unix::fs::PermissionsExt as _;
    let program = folder.join("kiln");
    std::fs::write(&program, kiln).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let disk = folder.join("disk");
    std::fs::create_dir(&disk).unwrap();
    let others = std::env::var_os("PATH").unwrap();
    let path = [folder.to_owned()].into_iter().chain(std::env::split_paths(&others));
    let mut script = Command::new("bash");
    script.arg(root().join("deploy/managers/slurm.sbatch")).env("PATH", std::env::join_paths(path).unwrap());
    script.env("SLURM_JOB_ID", "7").env("TMPDIR", disk);
    script
}

fn is_empty(folder: &Path) -> bool {
    std::fs::read_dir(folder).unwrap().next().is_none()
}

/// Arguments of the worker that the script for Slurm runs, with these variables of Slurm.
fn slurm(variables: &[(&str, &str)]) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let mut script = sbatch(TALKING, folder.path());
    script.envs(variables.iter().copied());
    let arguments: Vec<String> = output(&mut script).lines().map(str::to_owned).collect();
    let disk = folder.path().join("disk");
    let is_on_disk = |word: &String| Path::new(word).starts_with(&disk);
    assert!(arguments.iter().any(is_on_disk), "its cache is on the node's disk: {arguments:?}");
    assert!(is_empty(&disk), "it leaves nothing on the node");
    arguments
}

#[test]
fn array_of_slurm_runs_workers_of_the_size_that_it_was_given() {
    let of_array = slurm(&[
        ("SLURM_ARRAY_JOB_ID", "70"),
        ("SLURM_ARRAY_TASK_ID", "3"),
        ("SLURM_CPUS_PER_TASK", "12"),
        ("SLURM_MEM_PER_NODE", "32768"),
    ]);
    let alone = slurm(&[]);
    for arguments in [&of_array, &alone] {
        assert_taken("slurm.sbatch", arguments);
        assert_eq!(arguments[0], "worker");
        assert!(arguments.contains(&"--exit-when-idle".to_owned()), "{arguments:?}");
    }
    let value = |name: &str| of_array[of_array.iter().position(|word| word == name).unwrap() + 1].as_str();
    assert_eq!((value("--name"), value("--threads"), value("--memory-mib")), ("slurm-70-3", "12", "16384"));
    assert_eq!(value("--memory-limit-mib"), "32768", "the job's, whether or not the node holds it to that");
    assert!(!alone.iter().any(|word| word.starts_with("--memory")), "a job with all of its node: {alone:?}");
    let text = super::text_of("deploy/managers/slurm.sbatch");
    let grace = lightkiln_worker::runtime::WorkerConfig::new("http://farm", "w").drain_grace;
    let signal = text.lines().find_map(|line| line.strip_prefix("#SBATCH --signal=B:USR1@")).unwrap();
    assert!(
        signal.parse::<u64>().unwrap() > grace.as_secs() + 10,
        "a worker has time to give its tasks back"
    );
}

/// Slurm tells the script alone that its time is over soon, but every process of the job when it ends it: a worker that was told
/// twice would end at once and keep its tasks.
#[test]
fn worker_of_slurm_is_told_once_and_its_exit_code_is_the_jobs() {
    for (signal, whom_it_reaches) in [("USR1", "the script"), ("TERM", "every process")] {
        let folder = tempfile::tempdir().unwrap();
        let mut script = sbatch(DRAINING, folder.path());
        script.stdout(std::process::Stdio::piped());
        std::os::unix::process::CommandExt::process_group(&mut script, 0);
        let mut job = script.spawn().unwrap();
        let mut told = BufReader::new(job.stdout.take().unwrap()).lines().map(|line| line.unwrap());
        assert_eq!(told.next().as_deref(), Some("works"));
        let group = if signal == "TERM" { "-" } else { "" };
        let whom = format!("{group}{}", job.id());
        output(Command::new("bash").args(["-c", "kill -s $0 -- $1", signal, &whom]));
        let status = job.wait().unwrap();
        assert_eq!(told.collect::<Vec<_>>(), ["told"], "{signal} to {whom_it_reaches}");
        assert_eq!(status.code(), Some(7), "{signal} to {whom_it_reaches}");
        assert!(is_empty(&folder.path().join("disk")), "it leaves nothing on the node");
    }
}

#[test]
fn open_job_description_runs_what_there_is() {
    let template = &documents("deploy/managers/openjd.yaml")[0];
    let mut runs = Vec::new();
    for step in template["steps"].as_array().unwrap() {
        let action = &step["script"]["actions"]["onRun"];
        let words = [&[action["command"].as_str().unwrap()][..], &texts(&action["args"])].concat();
        let fill = |word: &str| match word {
            "{{Param.Preset}}" => "draft".to_owned(),
            word => word.replace("{{", "").replace("}}", ""),
        };
        let words: Vec<String> = words.into_iter().map(fill).collect();
        runs.push(assert_runs("openjd.yaml", &serde_json::json!(words)));
    }
    assert_eq!(runs, ["submit", "worker"]);
}

#[test]
#[ignore = "needs openjd, which tests/run installs"]
fn openjd_itself_takes_the_template() {
    let openjd = std::env::var_os("KILN_TEST_OPENJD").expect("KILN_TEST_OPENJD is the path of openjd");
    let check = |file: &Path| Command::new(&openjd).arg("check").arg(file).output().unwrap();
    let template = root().join("deploy/managers/openjd.yaml");
    let checked = check(&template);
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("broken.yaml");
    let text = std::fs::read_to_string(template).unwrap();
    std::fs::write(&broken, text.replace("Param.Workers", "Param.Nobody")).unwrap();
    assert!(!check(&broken).status.success(), "a parameter that there is not is found");
}

/// Runs a job type of Flamenco as its manager does: as a script that sees nothing but what Flamenco gives, with the defaults that
/// Flamenco's submitters send.
const FLAMENCO: &str = r#"
const vm = require("vm");
const text = require("fs").readFileSync("deploy/managers/flamenco.js", "utf8");
const named = (name, what) => { if (typeof name !== "string" || !name.trim()) throw new Error(`${what} is required`); };
const author = {
    Task(name, type) {
        named(name, "a task's name"), named(type, "a task's type");
        return { name, type, commands: [], addCommand(command) { this.commands.push(command); } };
    },
    Command(name, parameters) { named(name, "a command's name"); return { name, parameters }; },
};
const context = vm.createContext({ author });
vm.runInContext(text, context);
const [jobType, compileJob] = vm.runInContext("[JOB_TYPE, compileJob]", context);
const tasks = [], settings = { scene: "a.glb" };
for (const { key, default: value } of jobType.settings) if (value !== undefined) settings[key] = value;
compileJob({ settings, addTask: task => tasks.push(task) });
console.log(JSON.stringify({ jobType, tasks }));
"#;

/// Whether an object has no other keys than these.
fn has_only(object: &Value, keys: &[&str]) -> bool {
    object.as_object().unwrap().keys().all(|key| keys.contains(&key.as_str()))
}

/// As Flamenco's own description of its API names them, in AvailableJobType and AvailableJobSetting.
fn assert_is_job_type(job_type: &Value) {
    assert!(
        has_only(job_type, &["label", "description", "settings"]) && job_type["label"].is_string(),
        "{job_type}"
    );
    let keys = [
        "key",
        "type",
        "subtype",
        "choices",
        "propargs",
        "description",
        "default",
        "eval",
        "evalInfo",
        "visible",
        "required",
        "editable",
    ];
    for setting in job_type["settings"].as_array().unwrap() {
        assert!(has_only(setting, &keys) && setting["key"].is_string(), "{setting}");
        let kind = setting["type"].as_str().unwrap();
        assert!(["string", "int32", "float", "bool"].contains(&kind), "{setting}");
        let subtype = setting["subtype"].as_str();
        assert!(
            subtype.is_none_or(|of| ["file_path", "dir_path", "file_name", "hashed_file_path"].contains(&of)),
            "{setting}"
        );
        let is_text = kind == "string";
        assert!(is_text || subtype.is_none() && setting["choices"].is_null(), "{setting}");
        let (choices, default) = (&setting["choices"], &setting["default"]);
        assert!(default.is_null() || default.is_string() == is_text, "{setting}");
        assert!(choices.is_null() || choices.as_array().unwrap().contains(default), "{setting}");
    }
}

#[test]
#[ignore = "needs node, which tests/run installs"]
fn flamenco_compiles_a_job_that_runs_what_there_is() {
    let compiled = output(Command::new("node").args(["-e", FLAMENCO]));
    let compiled: Value = serde_json::from_str(&compiled).unwrap();
    assert_is_job_type(&compiled["jobType"]);
    let mut runs = Vec::new();
    for task in compiled["tasks"].as_array().unwrap() {
        let command = &task["commands"][0];
        assert_eq!((&command["name"], &task["type"]), (&"exec".into(), &"misc".into()), "{task}");
        let mut words = vec![command["parameters"]["exe"].clone()];
        words.extend(command["parameters"]["args"].as_array().unwrap().iter().cloned());
        runs.push(assert_runs("flamenco.js", &Value::Array(words)));
    }
    assert_eq!(
        runs,
        ["submit", "worker", "worker", "worker", "worker"],
        "one bake, and the default of workers"
    );
}

/// Makes the job of OpenCue with its own library, and prints the layers of the description that OpenCue's server would get.
const OPENCUE: &str = r#"
import json, shlex, sys
from xml.etree import ElementTree
sys.path.insert(0, "deploy/managers")
import opencue_job, outline.cuerun
made = opencue_job.job("my scene.glb", "http://farm:7410", 3)
spec = ElementTree.fromstring(outline.cuerun.OutlineLauncher(made).serialize(use_pycuerun=False))
part = lambda layer, name: layer.findtext(name)
print(json.dumps([{
    "command": shlex.split(part(layer, "cmd")), "range": part(layer, "range"), "cores": part(layer, "cores"),
    "memory": part(layer, "memory"),
} for layer in spec.iter("layer")]))
"#;

#[test]
#[ignore = "needs PyOutline, which tests/run installs"]
fn opencue_itself_has_layers_that_run_what_there_is() {
    let python = std::env::var_os("KILN_TEST_OPENCUE").expect("KILN_TEST_OPENCUE is a Python with PyOutline");
    let home = tempfile::tempdir().unwrap();
    // Its sessions go to the home folder.
    let layers = output(Command::new(python).args(["-B", "-c", OPENCUE]).env("HOME", home.path()));
    let layers: Value = serde_json::from_str(&layers).unwrap();
    let layers = layers.as_array().unwrap();
    let runs: Vec<String> =
        layers.iter().map(|layer| assert_runs("opencue_job.py", &layer["command"])).collect();
    assert_eq!(runs, ["submit", "worker"]);
    assert_eq!(layers[0]["command"][2], "my scene.glb");
    assert_eq!((&layers[0]["range"], &layers[1]["range"]), (&"1".into(), &"1-3".into()));
    let (threads, cores) = (&layers[1]["command"][5], &layers[1]["cores"]);
    assert_eq!(format!("{}.0", threads.as_str().unwrap()), *cores, "a worker has the cores of its frame");
    assert_eq!(layers[1]["memory"], "16g");
}
