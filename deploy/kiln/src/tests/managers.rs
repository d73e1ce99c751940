//! Templates for render managers: each is read as its manager would, and what it would run is what the program takes.

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

/// A folder with a `kiln` that prints its arguments, a line each, and fills its cache.
fn folder_with_talking_kiln() -> tempfile::TempDir {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("kiln");
    let script = "#!/bin/sh\nprintf '%s\\n' \"$@\"\n\
        while [ \"$1\" != --cache ]; do shift; done\nmkdir -p \"$2\" && touch \"$2/chunk\"\n";
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    folder
}

/// Arguments of the worker that the script for Slurm runs, with these variables of Slurm.
fn slurm(variables: &[(&str, &str)]) -> Vec<String> {
    let folder = folder_with_talking_kiln();
    let path = std::env::join_paths(
        [folder.path().to_owned()]
            .into_iter()
            .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let mut script = Command::new("bash");
    script.arg("deploy/managers/slurm.sbatch").env("PATH", path.unwrap()).env("SLURM_JOB_ID", "7");
    let disk = tempfile::tempdir().unwrap();
    script.envs(variables.iter().copied()).env("TMPDIR", disk.path());
    let arguments: Vec<String> = output(&mut script).lines().map(str::to_owned).collect();
    let is_on_disk = |word: &String| Path::new(word).starts_with(disk.path());
    assert!(arguments.iter().any(is_on_disk), "its cache is on the node's disk: {arguments:?}");
    assert_eq!(std::fs::read_dir(disk.path()).unwrap().count(), 0, "it leaves nothing on the node");
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
    let text = super::text_of("deploy/managers/slurm.sbatch");
    let grace = lightkiln_worker::runtime::WorkerConfig::new("http://farm", "w").drain_grace;
    let signal = text.lines().find_map(|line| line.strip_prefix("#SBATCH --signal=B:TERM@")).unwrap();
    assert!(
        signal.parse::<u64>().unwrap() > grace.as_secs() + 10,
        "a worker has time to give its tasks back"
    );
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

/// Runs a job type of Flamenco as its manager does, with the settings of `$2` and words for what it makes.
const FLAMENCO: &str = r#"
const text = require("fs").readFileSync("deploy/managers/flamenco.js", "utf8");
const tasks = [];
const author = {
    Task: (name, type) => ({ name, type, commands: [], addCommand(command) { this.commands.push(command); } }),
    Command: (name, parameters) => ({ name, parameters }),
};
const [jobType, compileJob] = new Function("author", text + "; return [JOB_TYPE, compileJob];")(author);
const settings = { scene: "a.glb" };
for (const { key, default: value } of jobType.settings) if (value !== undefined) settings[key] = value;
compileJob({ settings, addTask: task => tasks.push(task) });
console.log(JSON.stringify({ jobType, tasks }));
"#;

#[test]
#[ignore = "needs node, which tests/run installs"]
fn flamenco_compiles_a_job_that_runs_what_there_is() {
    let compiled = output(Command::new("node").args(["-e", FLAMENCO]));
    let compiled: Value = serde_json::from_str(&compiled).unwrap();
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

/// Makes the job of OpenCue with a stand-in for its library, and prints the layers.
const OPENCUE: &str = r#"
import json, shlex, sys, types
class Outline:
    def __init__(self, name, **more): self.layers = []
    def add_layer(self, layer): self.layers.append(layer)
outline, cuerun, modules, shell = (types.ModuleType(name) for name in
    ("outline", "outline.cuerun", "outline.modules", "outline.modules.shell"))
outline.Outline, outline.cuerun = Outline, cuerun
shell.Shell = lambda name, **parts: dict(parts, name=name)
for module in (outline, cuerun, modules, shell): sys.modules[module.__name__] = module
scope = {"__name__": "template"}
exec(open("deploy/managers/opencue_job.py").read(), scope)
layers = scope["job"]("my scene.glb", "http://farm:7410", 3).layers
print(json.dumps([dict(layer, command=shlex.split(layer["command"])) for layer in layers]))
"#;

#[test]
#[ignore = "needs python3, which tests/run asks for"]
fn opencue_has_layers_that_run_what_there_is() {
    let layers: Value = serde_json::from_str(&output(Command::new("python3").args(["-c", OPENCUE]))).unwrap();
    let layers = layers.as_array().unwrap();
    let runs: Vec<String> =
        layers.iter().map(|layer| assert_runs("opencue_job.py", &layer["command"])).collect();
    assert_eq!(runs, ["submit", "worker"]);
    assert_eq!(layers[0]["command"][2], "my scene.glb");
    assert_eq!((&layers[0]["range"], &layers[1]["range"]), (&"1".into(), &"1-3".into()));
}
