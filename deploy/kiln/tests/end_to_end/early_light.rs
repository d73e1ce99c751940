//! Pictures of a bake that goes on, and at its end those of its bundle.

use std::path::Path;
use std::process::Command;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::StageCount;
use lightkiln_proto::kinds::Kinds;
use serde_json::Value;

use super::cornell;
use super::processes::{Finished, LIMIT, Server, kiln, run};

/// A bake of a dozen cells, each of which takes a while.
const SLOW: [&str; 8] = [
    "--preset",
    "draft",
    "--set",
    "receivers_target=3000",
    "--set",
    "cluster_receivers=256",
    "--set",
    "transport_rays=1024",
];
const LOOK: [&str; 6] =
    ["--size", "96x72", "--backend", "cpu", "--light", "point pos=0.3,1.4,0.4 color=1,0.7,0.4 power=40"];

fn within(folder: &Path) -> Command {
    let mut command = kiln(folder);
    command.current_dir(folder);
    command
}

/// Draws a bake of a server, or a bundle.
fn drawn(folder: &Path, source: &[&str], file: &str, exit: i32) -> Finished {
    run(within(folder), &[&["preview", "--json", "--out", file][..], source, &LOOK].concat(), exit)
}

fn submitted(folder: &Path, server: &Server, scene: &str) -> String {
    let submit = [&["submit", scene, "--server", &server.url][..], &SLOW].concat();
    run(within(folder), &submit, 0).stdout().trim().to_owned()
}

/// Waits until some cells are baked, and holds the others back.
fn hold_amid(folder: &Path, server: &Server, bake: &str) {
    let client = ApiClient::new(&server.url, None).unwrap();
    let cells = Kinds::new().default_kind().under_way().unwrap().clusters;
    let deadline = std::time::Instant::now() + LIMIT;
    let mut seen = 0;
    loop {
        let page = client.events(bake, seen, 1).unwrap();
        seen = page.events.last().map_or(seen, |event| event.seq);
        if page.bake.stages.iter().any(|stage: &StageCount| stage.kind == cells && stage.done > 1) {
            break;
        }
        assert!(std::time::Instant::now() < deadline, "no cell within {LIMIT:?}: {:?}", page.bake);
    }
    run(within(folder), &["pause", bake, "--server", &server.url], 0);
}

#[test]
fn bake_under_way_is_drawn_with_the_light_that_is_baked_and_at_its_end_as_its_bundle() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let server = Server::start(&folder.join("server"));
    let scene = cornell().display().to_string();
    let bake = submitted(folder, &server, &scene);
    let source = [&bake[..], "--server", &server.url];

    let early = drawn(folder, &source, "early.png", 2).stderr();
    assert!(early.contains("no scene to draw yet") && early.contains("--wait"), "{early}");
    assert!(!folder.join("early.png").exists());

    let worker = server.worker(folder, "one", 1);
    hold_amid(folder, &server, &bake);
    let part = drawn(folder, &source, "part.png", 0);
    let cells = |said: &Value, name: &str| said["under_way"][name].as_u64().unwrap();
    let told = part.json();
    assert!((2..cells(&told, "cells_all")).contains(&cells(&told, "cells")), "{told}");
    let said = part.stderr();
    let words = format!("{} of {} cells are baked", cells(&told, "cells"), cells(&told, "cells_all"));
    assert!(said.contains("the bake goes on") && said.contains(&words), "{said}");

    run(within(folder), &["resume", &bake, "--server", &server.url], 0);
    let whole = drawn(folder, &[&source[..], &["--wait"]].concat(), "whole.png", 0).json();
    assert!(whole["under_way"].is_null(), "{whole}");
    // Light is missing amid the bake, so that it wants a longer exposure.
    assert!(told["exposure"].as_f64() > whole["exposure"].as_f64(), "{told} {whole}");
    run(within(folder), &[&["fetch"][..], &source, &["--out", "fetched"]].concat(), 0);
    drawn(folder, &["fetched"], "fetched.png", 0);
    let file = |name: &str| std::fs::read(folder.join(name)).unwrap();
    assert_eq!(file("whole.png"), file("fetched.png"));
    assert_ne!(file("part.png"), file("whole.png"));

    // Bakes that end without their light, and kinds that give none before, say so.
    drop(worker);
    let other = run(
        within(folder),
        &["submit", &scene, "--server", &server.url, "--kind", "sh", "--preset", "draft"],
        0,
    );
    let other = other.stdout().trim().to_owned();
    let source = [&other[..], "--server", &server.url];
    let unseen = drawn(folder, &source, "no.png", 2).stderr();
    assert!(unseen.contains("kind sh") && unseen.contains("kiln watch"), "{unseen}");
    run(within(folder), &["cancel", &other, "--server", &server.url], 0);
    let cancelled = drawn(folder, &source, "no.png", 130).stderr();
    assert!(cancelled.contains("was cancelled"), "{cancelled}");
    let nowhere = drawn(folder, &["fetched", "--wait"], "no.png", 2).stderr();
    assert!(nowhere.contains("--server"), "{nowhere}");
    assert!(!folder.join("no.png").exists());
}
