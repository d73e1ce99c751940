//! `kiln bake` with server and worker inside it.

use std::fs;

use serde_json::Value;

use super::processes::{Running, kiln, run};
use super::{SMALL, bundle, cornell};

fn bake_arguments(out: &std::path::Path) -> Vec<String> {
    let mut arguments = vec!["bake".to_owned(), cornell().display().to_string()];
    arguments.extend(SMALL.map(str::to_owned));
    arguments.extend(["--out".to_owned(), out.display().to_string(), "--json".to_owned()]);
    arguments
}

#[test]
fn second_bake_of_the_same_scene_runs_no_task_and_gives_the_same_bundle() {
    let folder = tempfile::tempdir().unwrap();
    let (first_out, second_out) = (folder.path().join("first"), folder.path().join("second"));
    let first = run(kiln(folder.path()), &bake_arguments(&first_out), 0).json();
    assert!(first["tasks_run"].as_u64().unwrap() > 4, "{first}");
    assert!(first["rays_closest"].as_u64().unwrap() > 0, "{first}");
    let second = run(kiln(folder.path()), &bake_arguments(&second_out), 0);
    assert_eq!(second.json()["tasks_run"], 0, "{}", second.json());
    assert_eq!(second.json()["tasks_reused"], first["tasks_run"]);
    assert!(second.stderr().contains("nothing to do: all"), "{}", second.stderr());
    assert_eq!(bundle(&first_out), bundle(&second_out));
}

#[test]
fn json_has_the_agreed_keys_and_a_bundle_lies_at_its_out() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let summary = run(kiln(folder.path()), &bake_arguments(&out), 0).json();
    let Value::Object(keys) = &summary else { panic!("not an object: {summary}") };
    let mut wanted = [
        "bake",
        "scene",
        "out",
        "kind",
        "receivers",
        "patches",
        "clusters",
        "tasks_run",
        "tasks_reused",
        "mean_rank",
        "rank_max",
        "rays_closest",
        "rays_occlusion",
        "rays_linking",
        "uncovered_fraction",
        "clusters_above_rank_error",
        "truncation_error_max",
        "receivers_without_light",
        "warnings",
        "bytes_total",
        "bytes_per_receiver",
        "elapsed_secs",
        "stages",
    ];
    wanted.sort_unstable();
    assert_eq!(keys.keys().map(String::as_str).collect::<Vec<_>>(), wanted);
    assert_eq!(summary["out"], out.display().to_string());
    let stages: Vec<&String> = summary["stages"].as_object().unwrap().keys().collect();
    assert_eq!(
        stages,
        [
            "assemble",
            "colour",
            "draw",
            "frame",
            "import",
            "overview",
            "patches",
            "place",
            "plan",
            "transport",
            "unwrap"
        ]
    );
    let report: Value = serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(report["run"]["receivers"], summary["receivers"]);
}

#[test]
fn poor_bake_says_so_on_screen_and_in_json_with_the_setting_that_would_help() {
    let folder = tempfile::tempdir().unwrap();
    let mut poor = bake_arguments(&folder.path().join("out"));
    poor.extend(["--set", "rank_max=2"].map(str::to_owned));
    let baked = run(kiln(folder.path()), &poor, 0);
    let (summary, words) = (baked.json(), baked.stderr());
    let warnings = summary["warnings"].as_array().unwrap();
    let blurred = warnings.iter().find(|warning| warning["code"] == "rank-error-exceeded");
    assert_eq!(blurred.unwrap()["try_setting"], "rank_max=64", "{summary}");
    let line = words.lines().find(|line| line.starts_with("warning: light is blurred in")).unwrap();
    assert!(line.contains("try --set rank_max=64"), "{line}");
    let above = summary["clusters_above_rank_error"].as_u64().unwrap();
    assert!(above > 0 && words.contains(&format!("{above} clusters above rank_error")), "{words}");
    let good = run(kiln(folder.path()), &bake_arguments(&folder.path().join("good")), 0);
    assert_eq!(good.json()["clusters_above_rank_error"], 0, "{}", good.stderr());
    assert!(!good.stderr().contains("warning:"), "{}", good.stderr());
}

#[test]
fn chunks_of_an_earlier_bake_leave_the_bundle() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut coarse = bake_arguments(&out);
    coarse.extend(["--set".to_owned(), "sky_parts=16".to_owned()]);
    run(kiln(folder.path()), &coarse, 0);
    let earlier = bundle(&out);
    run(kiln(folder.path()), &bake_arguments(&out), 0);
    let fresh = folder.path().join("fresh");
    run(kiln(folder.path()), &bake_arguments(&fresh), 0);
    assert_eq!(bundle(&out), bundle(&fresh));
    assert_ne!(bundle(&out), earlier, "other settings give other chunks");
}

#[test]
fn interrupted_bake_exits_130_and_the_next_one_goes_on_from_what_was_done() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut slow = bake_arguments(&out);
    slow.extend(["--set".to_owned(), "transport_rays=512".to_owned()]);
    let mut command = kiln(folder.path());
    command.args(&slow);
    let bake = Running::start(command);
    bake.stderr_line(|line| (line.contains("relight") || line.contains("transport")).then_some(()));
    bake.signal("INT");
    assert_eq!(bake.wait(), Some(130));
    assert!(!out.join("manifest.json").exists(), "an interrupted bake has no manifest");
    let again = run(kiln(folder.path()), &slow, 0).json();
    assert!(again["tasks_reused"].as_u64().unwrap() >= 2, "import and prepare were done: {again}");
}

#[test]
fn bake_left_by_a_killed_process_is_cancelled_and_its_finished_tasks_stay() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut slow = bake_arguments(&out);
    slow.extend(["--set".to_owned(), "transport_rays=512".to_owned()]);
    let mut command = kiln(folder.path());
    command.args(&slow);
    let killed = Running::start(command);
    killed.stderr_line(|line| (line.contains("relight") || line.contains("transport")).then_some(()));
    killed.signal("KILL");
    assert_eq!(killed.wait(), None);

    let other = run(kiln(folder.path()), &bake_arguments(&out), 0).json();
    assert!(other["tasks_reused"].as_u64().unwrap() >= 1, "import was done: {other}");
    let mut command = kiln(folder.path());
    command.args(["server", "--listen", "127.0.0.1:0", "--state"]).arg(folder.path());
    let server = Running::start(command);
    let url = server.stdout_line(|line| line.strip_prefix("listening on ").map(str::to_owned));
    let listed = run(kiln(folder.path()), &["list", "--json", "--server", &url], 0).json();
    let states: Vec<_> = listed["bakes"].as_array().unwrap().iter().map(|bake| &bake["state"]).collect();
    assert_eq!(states, ["done", "cancelled"], "{listed}");
}
