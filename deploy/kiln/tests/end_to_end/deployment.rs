//! Calls that the files of `deploy/` make, made to a server that runs.

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::cornell;
use super::processes::{Server, kiln, run};

fn text_of(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)).unwrap()
}

fn get(server: &Server, path: &str) -> String {
    let mut stream = TcpStream::connect(server.url.strip_prefix("http://").unwrap()).unwrap();
    write!(stream, "GET {path} HTTP/1.0\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.0 200"), "{answer}");
    answer
}

/// Names of figures in a text.
fn figures(text: &str) -> BTreeSet<&str> {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    words.filter(|word| word.starts_with("lightkiln_")).collect()
}

#[test]
fn figures_that_scaling_and_the_page_name_are_those_of_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path());
    run(kiln(folder.path()), &["submit", &cornell().display().to_string(), "--server", &server.url], 0);
    let told = get(&server, "/metrics");
    let mut checked = 0;
    for path in ["README.md", "kubernetes/scaling.yaml"] {
        for name in figures(&text_of(path)) {
            // A counter's type stands under its name without the ending.
            let family = format!("# TYPE {} ", name.strip_suffix("_total").unwrap_or(name));
            assert!(told.contains(&family), "{path} names {name}, a server tells:\n{told}");
            checked += 1;
        }
    }
    assert!(checked > 4, "{checked} figures are named: the walk is broken");
    let ready = |line: &&str| {
        line.starts_with("lightkiln_tasks{kind=\"scene.import\"")
            && line.contains("state=\"ready\"")
            && line.ends_with(" 1")
    };
    assert_eq!(told.lines().filter(ready).count(), 1, "what KEDA asks for:\n{told}");
}

#[test]
fn health_check_of_the_compose_file_knows_a_ready_server_from_none() {
    let compose: Value = serde_saphyr::from_str(&text_of("compose.yaml")).unwrap();
    let check = compose["services"]["server"]["healthcheck"]["test"].as_array().unwrap();
    let words: Vec<&str> = check.iter().map(|word| word.as_str().unwrap()).collect();
    assert_eq!(words[..3], ["CMD", "bash", "-c"]);
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path());
    let port = server.url.rsplit_once(':').unwrap().1.to_owned();
    let script = words[3].replace("/7410", &format!("/{port}"));
    let is_healthy = || Command::new("bash").args(["-c", &script]).output().unwrap().status.success();
    assert!(is_healthy(), "{script}");
    drop(server);
    assert!(!is_healthy(), "{script}");
}

#[test]
fn webhooks_without_a_good_secret_or_to_this_machine_are_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    for (secret, url, told) in [
        ("", "https://hooks.example/", "KILN_WEBHOOK_SECRET"),
        ("short", "https://hooks.example/", "16 bytes"),
        ("a secret that will do", "http://127.0.0.1:9/", "--webhook-allow-local"),
        ("a secret that will do", "hooks.example", "no URL"),
    ] {
        let mut command = kiln(folder.path());
        command.env("KILN_WEBHOOK_SECRET", secret);
        let refused = run(command, &["server", "--listen", "127.0.0.1:0", "--webhook", url], 2).stderr();
        assert!(refused.contains(told), "{url}: {refused}");
    }
}
