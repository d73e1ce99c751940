//! The window of `kiln view`, on a display that nobody looks at.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};
use super::{SMALL, cornell};

/// An X server; ended when it is dropped.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// Starts one on a free number, which it says when it takes windows.
    fn start() -> Self {
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "1024x768x24", "-nolisten", "tcp"]);
        let mut server = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        assert!(number.trim().parse::<u32>().is_ok(), "Xvfb said {number:?}");
        Self { server, name: format!(":{}", number.trim()) }
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        // One that has ended already is as good.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// `kiln` in a folder, on a display or on none.
fn within(folder: &Path, display: Option<&Display>) -> Command {
    let mut command = kiln(folder);
    command
        .current_dir(folder)
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET");
    if let Some(display) = display {
        command.env("DISPLAY", &display.name);
    }
    command
}

fn bake(folder: &Path) {
    let scene = cornell().display().to_string();
    run(within(folder, None), &[&["bake", &scene, "--out", "box"][..], &SMALL].concat(), 0);
}

const LOOK: [&str; 6] =
    ["--size", "200x150", "--light", "point pos=0.3,1.4,0.4 color=1,0.7,0.4 power=40", "--exposure", "0.5"];

fn pixels(folder: &Path, file: &str) -> image::RgbImage {
    image::open(folder.join(file)).unwrap().into_rgb8()
}

/// Mean difference of two pictures' channels, of 255.
fn difference(one: &image::RgbImage, other: &image::RgbImage) -> f64 {
    assert_eq!(one.dimensions(), other.dimensions());
    let sum: u64 = one.as_raw().iter().zip(other.as_raw()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.as_raw().len() as f64
}

#[test]
#[ignore = "needs a graphics adapter and Xvfb, a display that nobody looks at"]
fn window_on_a_display_shows_what_preview_draws() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    bake(folder);
    let drawn =
        [&["preview", "box", "--out", "wanted.png", "--backend", "gpu", "--json"][..], &LOOK].concat();
    let said = run(within(folder, None), &drawn, 0).json();
    let passes = said["passes"].as_array();
    // An adapter without a clock says so with null.
    assert!(passes.is_none_or(|passes| passes.iter().any(|row| row["pass"] == "shade")), "{said}");
    let display = Display::start();
    let shown = |file: &str, more: &[&str]| {
        let window = ["view", "box", "--frames", "60", "--screenshot", file];
        run(within(folder, Some(&display)), &[&window[..], &LOOK, more].concat(), 0);
        pixels(folder, file)
    };
    let wanted = pixels(folder, "wanted.png");
    let got = shown("got.png", &[]);
    assert_eq!(got.dimensions(), (200, 150));
    let off = difference(&got, &wanted);
    assert!(off < 1.0, "{off} of 255");
    let moved = shown("moved.png", &["--light", "sun dir=0.2,-0.6,-0.8 irradiance=3"]);
    assert!(difference(&moved, &wanted) > 3.0, "another light is another picture");
    let lights = r#"{"lights": [{"name": "own", "type": "emitters", "scale": 1}]}"#;
    std::fs::write(folder.join("lights.json"), lights).unwrap();
    let rough = ["--receivers", "40", "--rel-error", "0.3", "--pixels", "0", "--lights", "lights.json"];
    let dump = ["evaluate", "box", "--dump", "places.csv"];
    run(within(folder, None), &[&dump[..], &rough].concat(), 0);
    let errors = shown("errors.png", &["--errors", "places.csv"]);
    assert!([&wanted, &moved].iter().all(|other| difference(&errors, other) > 10.0), "errors are not seen");
}

/// The most memory of the adapter with which a picture has less light than all, within 4 KB.
fn too_little_memory(folder: &Path) -> String {
    let has_all = |bytes: u64| {
        let bytes = bytes.to_string();
        let picture = ["preview", "box", "--out", "x.png", "--backend", "gpu", "--adapter-memory", &bytes];
        let said = within(folder, None).args(picture).args(LOOK).arg("--json").output().unwrap();
        let said: Option<serde_json::Value> = serde_json::from_slice(&said.stdout).ok();
        said.is_some_and(|said| said["less_light"].is_null())
    };
    let (mut little, mut enough) = (1 << 20, 1 << 30);
    assert!(has_all(enough));
    while enough - little > 4096 {
        let middle = (little + enough) / 2;
        *if has_all(middle) { &mut enough } else { &mut little } = middle;
    }
    little.to_string()
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_without_room_for_all_light_draws_less_of_it_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    bake(folder);
    let whole = ["preview", "box", "--out", "whole.png", "--backend", "gpu"];
    run(within(folder, None), &[&whole[..], &LOOK].concat(), 0);
    let little = too_little_memory(folder);
    let memory = ["--adapter-memory", &little[..]];
    let less = ["preview", "box", "--out", "less.png", "--backend", "gpu", "--json"];
    let said = run(within(folder, None), &[&less[..], &LOOK, &memory].concat(), 0).json();
    assert!(said["less_light"].as_str().is_some_and(|why| why.contains("no room")), "{said}");
    assert!(said["light_bytes"].as_u64() < said["light_bytes_all"].as_u64(), "{said}");
    let wanted = pixels(folder, "whole.png");
    let off = difference(&pixels(folder, "less.png"), &wanted);
    assert!(off > 0.0 && off < 10.0, "{off} of 255");
    // The fixed part has no room either.
    let nothing = ["preview", "box", "--out", "none.png", "--backend", "gpu", "--adapter-memory", "1M"];
    let told = run(within(folder, None), &[&nothing[..], &LOOK].concat(), 1).stderr();
    assert!(told.contains("no room") && told.contains("--backend cpu"), "{told}");
    assert!(!folder.join("none.png").exists());
}

/// All of a server's light comes while the window is open.
#[test]
#[ignore = "needs a graphics adapter and Xvfb, a display that nobody looks at"]
fn window_on_a_display_gets_better_as_light_comes_from_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let server = Server::start(&folder.join("server"));
    let _worker = server.worker(folder, "a", 2);
    let bake = run(kiln(folder), &arguments("submit", &["--server", &server.url]), 0).stdout();
    let source = [bake.trim(), "--server", &server.url];
    run(kiln(folder), &[&["watch"][..], &source].concat(), 0);
    let drawn = [&["preview"][..], &source, &["--out", "wanted.png", "--backend", "gpu"], &LOOK].concat();
    run(within(folder, None), &drawn, 0);
    let display = Display::start();
    let window = [&["view"][..], &source, &["--frames", "60", "--screenshot", "got.png"], &LOOK].concat();
    run(within(folder, Some(&display)), &window, 0);
    let off = difference(&pixels(folder, "got.png"), &pixels(folder, "wanted.png"));
    assert!(off < 1.0, "{off} of 255");
}

/// The window is open before the first cell is baked, and counts pictures once all light is there.
#[test]
#[ignore = "needs a graphics adapter and Xvfb, a display that nobody looks at"]
fn window_on_a_display_opens_on_a_bake_under_way_and_ends_with_all_of_its_light() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let server = Server::start(&folder.join("server"));
    let bake = run(kiln(folder), &arguments("submit", &["--server", &server.url]), 0).stdout();
    let source = [bake.trim(), "--server", &server.url];
    let display = Display::start();
    let mut window = within(folder, Some(&display));
    window.args(["view"]).args(source).args(["--frames", "60", "--screenshot", "got.png"]).args(LOOK);
    let window = Running::start(window);
    window.stderr_line(|line| line.contains("the bake goes on").then_some(()));
    let _worker = server.worker(folder, "a", 2);
    let ended = window.finish();
    assert_eq!(ended.exit, Some(0), "{:#?}", ended.stderr);
    let drawn = [&["preview"][..], &source, &["--out", "wanted.png", "--backend", "gpu"], &LOOK].concat();
    run(within(folder, None), &drawn, 0);
    let off = difference(&pixels(folder, "got.png"), &pixels(folder, "wanted.png"));
    assert!(off < 1.0, "{off} of 255");
}

#[test]
#[cfg(target_os = "linux")]
fn without_a_display_it_says_how_to_draw_pictures() {
    let folder = tempfile::tempdir().unwrap();
    bake(folder.path());
    let said = run(within(folder.path(), None), &["view", "box"], 1).stderr();
    assert!(said.contains("no display") && said.contains("kiln preview"), "{said}");
    let missing = run(within(folder.path(), None), &["view", "nothing"], 2).stderr();
    assert!(missing.contains("manifest.json"), "{missing}");
    std::fs::write(folder.path().join("places.csv"), "light,x_m\n").unwrap();
    let errors = ["view", "box", "--errors", "places.csv"];
    let refused = run(within(folder.path(), None), &errors, 2).stderr();
    assert!(refused.contains("places.csv") && refused.contains("kiln evaluate"), "{refused}");
}
