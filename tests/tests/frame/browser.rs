//! Runs the page in Chromium, headless, on its software adapter: a small server gives it files and takes its answers.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Sender};
use std::time::Duration;

use glam::Vec4;
use lightkiln_client::web;
use serde_json::Value;

/// Longest wait for the page.
const PATIENCE: Duration = Duration::from_secs(240);
/// Longest answer.
const ANSWER_MAX: usize = 256 << 20;
/// Gives headless Chromium WebGPU on the processor.
const FLAGS: [&str; 7] = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu-watchdog",
    "--enable-unsafe-webgpu",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-angle=swiftshader",
];

/// What the page is given.
pub struct Page<'a> {
    /// Its job.
    pub job: Value,
    /// Folder of the bake.
    pub bundle: &'a Path,
}

/// What the page drew of one state.
pub struct Drawn {
    /// E_ind by slot.
    pub indirect: Vec<Vec4>,
    /// Radiance of pixels.
    pub radiance: Vec<Vec4>,
    /// The screen, four bytes a pixel.
    pub screen: Vec<u8>,
    /// Factor on radiance.
    pub exposure: f32,
    /// Bounces.
    pub bounces: u64,
    /// Whether they had converged.
    pub converged: bool,
}

/// What the page answered.
pub struct Answers {
    /// By name.
    pub states: BTreeMap<String, Drawn>,
    /// Things made on the device before the first state and after the last.
    pub created: [u64; 2],
    /// Errors that the device told of.
    pub errors: Vec<String>,
}

/// Opens the page and waits for its answers.
pub fn run(page: &Page<'_>) -> Answers {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let files = Files::new(page);
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let (files, sender) = (files.clone(), sender.clone());
            std::thread::spawn(move || stream.map(|stream| serve(stream, &files, &sender)));
        }
    });
    let profile = tempfile::tempdir().unwrap();
    let _browser = Browser::open(&format!("http://{address}/test/index.html"), profile.path());
    let mut parts = BTreeMap::new();
    loop {
        let (name, body) = receiver.recv_timeout(PATIENCE).expect("the page answers in time");
        match name.as_str() {
            "failed" => panic!("the page failed: {}", String::from_utf8_lossy(&body)),
            "done" => return answers(&serde_json::from_slice(&body).unwrap(), &mut parts),
            _ => parts.insert(name, body),
        };
    }
}

fn answers(done: &Value, parts: &mut BTreeMap<String, Vec<u8>>) -> Answers {
    let states = done["states"].as_object().unwrap().iter().map(|(name, told)| {
        let mut part = |of: &str| parts.remove(&format!("{name}/{of}")).unwrap();
        let drawn = Drawn {
            indirect: vectors(&part("indirect")),
            radiance: vectors(&part("radiance")),
            screen: part("screen"),
            exposure: told["exposure"].as_f64().unwrap() as f32,
            bounces: told["bounces"].as_u64().unwrap(),
            converged: told["converged"].as_bool().unwrap(),
        };
        (name.clone(), drawn)
    });
    let created = [0, 1].map(|at| done["created"][at].as_u64().unwrap());
    let errors = done["errors"].as_array().unwrap().iter().map(Value::to_string).collect();
    Answers { states: states.collect(), created, errors }
}

fn vectors(bytes: &[u8]) -> Vec<Vec4> {
    let number = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let vector = |of: &[u8]| Vec4::from_array([0, 4, 8, 12].map(|at| number(&of[at..])));
    bytes.chunks_exact(16).map(vector).collect()
}

/// A browser process, ended with the value.
struct Browser(Child);

impl Browser {
    fn open(url: &str, profile: &Path) -> Self {
        let browser = ["chromium", "chromium-browser", "google-chrome"].into_iter().find_map(|name| {
            let mut command = Command::new(name);
            command.args(FLAGS).arg(format!("--user-data-dir={}", profile.display())).arg(url);
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()
        });
        Self(browser.expect("Chromium is installed, as Debian's package chromium"))
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Files of the page by the beginnings of their paths.
#[derive(Clone)]
struct Files {
    job: Vec<u8>,
    folders: Vec<(&'static str, PathBuf)>,
}

impl Files {
    fn new(page: &Page<'_>) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let folders = vec![
            ("/bundle/", page.bundle.to_owned()),
            ("/test/", root.join("tests/frame")),
            ("/", root.join("../client/web")),
        ];
        Self { job: page.job.to_string().into_bytes(), folders }
    }

    fn read(&self, path: &str) -> Option<Vec<u8>> {
        if path == "/job.json" {
            return Some(self.job.clone());
        }
        if path == "/test/index.html" {
            return Some(b"<!doctype html><script type=\"module\" src=\"page.js\"></script>".to_vec());
        }
        if let Some(name) = path.strip_prefix("/shaders/").and_then(|file| file.strip_suffix(".wgsl")) {
            let shader = web::shaders().into_iter().find(|(own, _)| *own == name);
            return shader.map(|(_, text)| text.into_owned().into_bytes());
        }
        let (start, folder) = self.folders.iter().find(|(start, _)| path.starts_with(start))?;
        fs::read(folder.join(&path[start.len()..])).ok()
    }
}

/// Answers one request.
fn serve(stream: TcpStream, files: &Files, sender: &Sender<(String, Vec<u8>)>) -> std::io::Result<()> {
    let mut reader = BufReader::new(&stream);
    let mut line = String::new();
    reader.read_line(&mut line)?;
    let mut words = line.split_whitespace().map(str::to_owned);
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let mut length = 0;
    loop {
        line.clear();
        reader.read_line(&mut line)?;
        if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
        if line.trim().is_empty() {
            break;
        }
    }
    if let Some(name) = path.strip_prefix("/answer/").filter(|_| method == "POST" && length <= ANSWER_MAX) {
        let mut body = vec![0; length];
        reader.read_exact(&mut body)?;
        // Nobody listens once the page is done.
        let _ = sender.send((name.to_owned(), body));
        return respond(&stream, "204 No Content", "text/plain", &[]);
    }
    let kind = match path.rsplit('.').next() {
        Some("js") => "text/javascript",
        Some("html") => "text/html",
        _ => "application/octet-stream",
    };
    match files.read(&path) {
        Some(body) => respond(&stream, "200 OK", kind, &body),
        None => respond(&stream, "404 Not Found", "text/plain", &[]),
    }
}

fn respond(mut stream: &TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)
}
