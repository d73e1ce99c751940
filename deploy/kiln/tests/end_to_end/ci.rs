//! The contract with CI systems: one bake for one commit, exit codes, the JSON object, the JUnit report.

use std::path::{Path, PathBuf};

use super::farm::arguments;
use super::processes::{Finished, Server, kiln, run};

/// A scene that can be sent but not imported.
fn broken_scene(folder: &Path) -> PathBuf {
    let path = folder.join("broken.gltf");
    std::fs::write(&path, r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[7]}],"scene":0}"#).unwrap();
    path
}

/// How often the element is in the report.
fn count(junit: &Path, element: &str) -> usize {
    let text = std::fs::read_to_string(junit).unwrap();
    text.matches(&format!("<{element} ")).count()
}

#[test]
fn job_that_runs_twice_for_a_commit_waits_for_one_bake() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let _worker = server.worker(folder.path(), "worker", 2);
    let junit = folder.path().join("out/junit.xml");
    let report = junit.display().to_string();
    let submit = |commit: &str| -> Finished {
        let more = ["--server", &server.url, "--wait", "--json", "--junit", &report, "--commit", commit];
        run(kiln(folder.path()), &arguments("submit", &more), 0)
    };
    let [first, again, other] = ["c0ffee", "c0ffee", "decaf"].map(|commit| submit(commit).json());
    assert_eq!(first["bake"], again["bake"]);
    assert_ne!(first["bake"], other["bake"]);
    assert_eq!((&first["state"], &first["failure"]), (&"done".into(), &serde_json::Value::Null));
    assert!(first["tasks_run"].as_u64().unwrap() > 3 && other["tasks_run"] == 0, "{first} {other}");
    let stages = first["stages"].as_object().unwrap();
    assert_eq!(count(&junit, "testcase"), stages.len() + 1, "{stages:?}");
    for element in ["failure", "error", "skipped"] {
        assert_eq!(count(&junit, element), 0, "{element}");
    }
    // Other settings are another bake of the same commit.
    let more = ["--server", &server.url, "--json", "--commit", "c0ffee", "--set", "rank_max=9"];
    let draft = run(kiln(folder.path()), &arguments("submit", &more), 0).json();
    assert_ne!(draft["bake"], first["bake"]);
}

#[test]
fn bake_that_fails_is_told_in_the_object_the_report_and_the_exit_code_and_is_tried_anew() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let _worker = server.worker(folder.path(), "worker", 2);
    let scene = broken_scene(folder.path()).display().to_string();
    let junit = folder.path().join("junit.xml");
    let report = junit.display().to_string();
    let submit = || {
        let more = ["--wait", "--json", "--junit", &report, "--commit", "c0ffee"];
        let finished =
            run(kiln(folder.path()), &[&["submit", &scene, "--server", &server.url], &more[..]].concat(), 2);
        assert_eq!((count(&junit, "failure"), count(&junit, "error")), (2, 0), "the stage and the whole");
        let told = finished.json();
        assert_eq!(told["state"], "failed");
        let failure = told["failure"].as_str().unwrap();
        assert!(finished.stderr().contains(failure), "{failure}");
        told["bake"].as_str().unwrap().to_owned()
    };
    let [first, second] = [submit(), submit()];
    assert_ne!(first, second);
}

#[test]
fn bake_that_was_cancelled_and_server_that_is_away_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let junit = folder.path().join("junit.xml");
    let report = junit.display().to_string();
    let commit = ["--server", &server.url, "--commit", "c0ffee"];
    let submitted = run(kiln(folder.path()), &arguments("submit", &commit), 0);
    let bake = submitted.stdout().trim().to_owned();
    let waiting = {
        let mut command = kiln(folder.path());
        command.args(arguments("submit", &commit)).args(["--wait", "--json", "--junit", &report]);
        super::processes::Running::start(command)
    };
    waiting.stderr_line(|line| line.strip_prefix("bake ").filter(|id| *id == bake).map(drop));
    run(kiln(folder.path()), &["cancel", &bake, "--server", &server.url], 0);
    let told: serde_json::Value = waiting.stdout_line(|line| serde_json::from_str(line).ok());
    assert_eq!((&told["bake"], &told["state"]), (&bake.as_str().into(), &"cancelled".into()));
    assert_eq!(waiting.wait(), Some(130));
    assert_eq!(count(&junit, "failure"), 1);
    assert!(count(&junit, "skipped") >= 1, "stages that never ended");
    let url = server.url.clone();
    drop(server);
    let away = ["--server", &url, "--patience", "0", "--wait", "--json", "--junit", &report];
    let finished = run(kiln(folder.path()), &arguments("submit", &away), 3);
    assert_eq!((finished.stdout().as_str(), count(&junit, "error")), ("", 1));
}

#[test]
fn report_without_waiting_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = run(kiln(folder.path()), &arguments("submit", &["--junit", "junit.xml"]), 2);
    assert!(refused.stderr().contains("--wait"), "{}", refused.stderr());
}

#[test]
fn evaluation_of_a_farms_bake_is_in_the_object_the_report_and_the_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let _worker = server.worker(folder.path(), "worker", 2);
    let lights = folder.path().join("lights.json");
    let lamp = r#"{"lights": [{"name": "lamp", "type": "point", "position_m": [0.5, 4, -2], "strength": [10, 9, 8]}]}"#;
    std::fs::write(&lights, lamp).unwrap();
    let (lights, junit) = (lights.display().to_string(), folder.path().join("junit.xml"));
    let report = junit.display().to_string();
    let submit = |limit: &str, exit: i32| {
        let mut more =
            vec!["--server", &server.url, "--wait", "--json", "--junit", &report, "--fail-if", limit];
        more.extend(["--receivers", "60", "--rel-error", "0.2", "--lights", &lights, "--evaluate"]);
        run(kiln(folder.path()), &arguments("submit", &more), exit)
    };
    let met = submit("rel_rmse>50", 0).json();
    assert_eq!((&met["state"], &met["evaluation"]["lights"][0]["name"]), (&"done".into(), &"lamp".into()));
    assert!(met["evaluation"]["energy_ratio"].as_f64().unwrap() > 0.5, "{met}");
    assert_eq!((count(&junit, "failure"), count(&junit, "error")), (0, 0));
    let broken = submit("lamp.rel_rmse>0.00001", 4);
    assert!(broken.json()["evaluation"]["rel_rmse"].is_f64(), "the object is there all the same");
    assert!(broken.stderr().contains("fails by --fail-if"), "{}", broken.stderr());
    assert_eq!((count(&junit, "failure"), count(&junit, "error")), (1, 0), "the evaluation alone");
    assert!(std::fs::read_to_string(&junit).unwrap().contains("name=\"evaluation\""));
    // A light that was not measured is a slip of the caller, told once the lights are known; the bake is done.
    let slip = submit("sun.rel_rmse>1", 2);
    assert_eq!(slip.json()["state"], "done");
    assert_eq!((count(&junit, "failure"), count(&junit, "error")), (0, 1));
    // What can be told before the bake is.
    for (wrong, told) in [
        (&["--fail-if", "rel_rmse>1"][..], "--evaluate"),
        (&["--evaluate"], "--wait"),
        (&["--wait", "--evaluate", "--fail-if", "beauty<1"], "rel_rmse"),
    ] {
        let refused =
            run(kiln(folder.path()), &arguments("submit", &[wrong, &["--server", &server.url]].concat()), 2);
        assert!(refused.stderr().contains(told), "{wrong:?}: {}", refused.stderr());
    }
}
