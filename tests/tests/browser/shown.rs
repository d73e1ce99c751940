//! A finished bake as a farm's page shows it: the program's own server with its pages and their policy, a worker, and the picture.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::driver::Browser;
use super::files::Files;
use super::root;

/// Longest that all light may take.
const LIMIT: Duration = Duration::from_secs(600);
/// Words over the picture when it is done; they are hidden then.
const DONE: &str = "all light is here";

/// A process that is killed with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn program(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_kiln-ambient"));
    command.current_dir(folder).env("KILN_STATE", folder.join("state")).env_remove("KILN_TOKEN");
    command
}

/// A farm of one server and one worker; its address.
fn farm(folder: &Path) -> ([Running; 2], String) {
    let mut server = program(folder);
    server.args(["server", "--listen", "127.0.0.1:0", "--state", "farm"]).stdout(Stdio::piped());
    let mut server = Running(server.spawn().expect("a server"));
    let mut line = String::new();
    let told = server.0.stdout.take().expect("its words");
    BufReader::new(told).read_line(&mut line).expect("a line");
    let url = line.trim().strip_prefix("listening on ").expect("an address").to_owned();
    let mut worker = program(folder);
    let worker = Running(worker.args(["worker", "--server", &url]).spawn().expect("a worker"));
    ([server, worker], url)
}

/// Bakes Cornell on the farm; the bake's id.
fn bake(folder: &Path, url: &str) -> String {
    let scene = root().join("tests/scenes/cornell.glb");
    let mut bake = program(folder);
    bake.arg("bake").arg(scene).args(["--server", url, "--preset", "draft", "--out", "out", "--json"]);
    bake.args(["--set", "receivers_target=400", "--set", "transport_rays=64"]);
    let output = bake.output().expect("a bake");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let listed = program(folder).args(["list", "--server", url, "--json"]).output().expect("a list");
    let listed: Value = serde_json::from_slice(&listed.stdout).expect("JSON");
    let bakes = listed.as_array().or_else(|| listed["bakes"].as_array()).expect("bakes");
    bakes[0]["id"].as_str().expect("an id").to_owned()
}

#[test]
#[ignore = "needs chromium"]
fn chromium_shows_a_finished_bake_of_a_farm_as_its_server_hands_it_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_farm, url) = farm(folder.path());
    let id = bake(folder.path(), &url);
    let browser = Browser::start();
    browser.open(&format!("{url}/#/bakes/{id}"));
    wait_for_all_light(&browser);
    let shown = "const text = document.querySelector('main').innerText;
        const canvas = document.querySelector('canvas');
        return [text.includes('Report'), text.includes('Lamp brightness'), canvas.width > 0 && canvas.height > 0,
            performance.getEntriesByType('resource').every(({ name }) => name.startsWith(location.origin)),
            performance.getEntriesByType('resource').some(({ name }) => name.endsWith('/relight/worker.js'))]";
    assert_eq!(browser.script(shown, json!([])), json!([true, true, true, true, true]));
    wait_for(&browser, &format!("kiln evaluate {id} --server {url} --out DIR --attach"), 0);
    // An evaluation that is attached is on the page, its pictures too.
    evaluate(folder.path(), &id, &url);
    browser.open(&format!("{url}/web/icon.svg"));
    browser.open(&format!("{url}/#/bakes/{id}"));
    let text = wait_for(&browser, "all lights", 0);
    assert!(
        text.contains("Evaluation") && text.contains("Cornell's lamp") && !text.contains("--attach"),
        "{text}"
    );
    browser.script("document.querySelector('.pictures').scrollIntoView()", json!([]));
    wait_for(&browser, "all lights", 2);
    // The same bake as a site of plain files.
    let arguments = ["site", "out", "--out", "site", "--stills", "2", "--evaluation", "evaluated"];
    let site = program(folder.path()).args(arguments).output().expect("a site");
    assert!(site.status.success(), "{}", String::from_utf8_lossy(&site.stderr));
    let files = Files::start(vec![("/any/place/", folder.path().join("site"))], |_| None);
    browser.open(&files.url("/any/place/index.html"));
    wait_for_all_light(&browser);
    let calls = files.calls();
    assert!(calls.iter().all(|call| call.starts_with("/any/place/")), "{calls:?}");
    assert!(calls.iter().any(|call| call == "/any/place/web/relight/worker.js"), "{calls:?}");
    assert!(!calls.iter().any(|call| call.contains("stills/")), "a canvas needs no pictures: {calls:?}");
    let text = wait_for(&browser, "all lights", 2);
    assert!(text.contains("Evaluation") && text.contains("Cornell's lamp"), "{text}");
    // Without WebGPU either page says so, and the site has pictures.
    browser.before_pages("Object.defineProperty(Navigator.prototype, 'gpu', { get: () => undefined })");
    browser.open(&format!("{url}/#/bakes/{id}"));
    let text = wait_for(&browser, "drawn before", 1);
    assert!(text.contains("no WebGPU"), "{text}");
    let still = "const image = document.querySelector('main img');
        return [new URL(image.src).protocol, image.naturalWidth, image.naturalHeight]";
    assert_eq!(browser.script(still, json!([])), json!(["blob:", 960, 540]));
    browser.open(&files.url("/any/place/index.html"));
    let text = wait_for(&browser, "no WebGPU", 3);
    assert!(text.contains("drawn before"), "{text}");
    let stills = "const image = document.querySelector('main img'); return [image.src, image.naturalWidth, image.naturalHeight]";
    let wanted = json!([files.url("/any/place/stills/1.png"), 960, 540]);
    // The picture itself comes after its place in the page.
    let start = Instant::now();
    while browser.script(stills, json!([])) != wanted {
        assert!(start.elapsed() < LIMIT, "{}", browser.script(stills, json!([])));
    }
    // Without its list it has none, and a list that says nothing is told of.
    let list = folder.path().join("site/site.json");
    for (words, is_told) in [(None, false), (Some("null"), true), (Some("{\"stills\""), true)] {
        match words {
            Some(words) => std::fs::write(&list, words).expect("a file"),
            None => std::fs::remove_file(&list).expect("no file"),
        }
        browser.open(&files.url("/any/place/index.html"));
        let text = wait_for(&browser, "kiln preview", 0);
        assert!(text.contains("no WebGPU"), "{text}");
        let told = "Pictures and evaluation of this site";
        let text = if is_told { wait_for(&browser, told, 0) } else { text };
        assert!(text.contains(told) == is_told && !text.contains("all lights"), "{text}");
    }
}

/// Evaluates a bake of a farm, roughly, against the scene that the farm has, and attaches that to it.
fn evaluate(folder: &Path, id: &str, url: &str) {
    let lights = r#"{"lights": [
        {"name": "Cornell's lamp", "type": "point", "position_m": [0, 1, 0.5], "strength": [10, 9, 8]}
    ]}"#;
    std::fs::write(folder.join("lights.json"), lights).expect("a file");
    let mut evaluate = program(folder);
    evaluate.args(["evaluate", id, "--server", url, "--out", "evaluated", "--attach"]);
    evaluate.args(["--lights", "lights.json", "--size", "48x32"]);
    evaluate.args(["--receivers", "30", "--rel-error", "0.3", "--pixels", "0"]);
    let output = evaluate.output().expect("an evaluation");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Waits until the page says `words` and has so many pictures loaded; gives its text.
fn wait_for(browser: &Browser, words: &str, pictures: u64) -> String {
    let look = "const isLoaded = ({ complete, naturalWidth }) => complete && naturalWidth > 0;
        const images = [...document.querySelectorAll('main img')];
        return [document.querySelector('main')?.innerText ?? '', images.filter(isLoaded).length]";
    let start = Instant::now();
    loop {
        let found = browser.script(look, json!([]));
        let text = found[0].as_str().unwrap_or_default();
        if text.contains(words) && found[1].as_u64() >= Some(pictures) {
            return text.to_owned();
        }
        assert!(start.elapsed() < LIMIT, "never '{words}' and {pictures} pictures: {found}");
    }
}

fn wait_for_all_light(browser: &Browser) {
    let words =
        "return document.querySelector('.over')?.textContent ?? document.querySelector('main').innerText";
    let start = Instant::now();
    loop {
        let found = browser.script(words, json!([]));
        let found = found.as_str().unwrap_or_default();
        if found == DONE {
            break;
        }
        assert!(start.elapsed() < LIMIT, "the picture is never done: {found}");
    }
}
