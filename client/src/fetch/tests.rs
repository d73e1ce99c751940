//! Bundles and servers: chunks fetched and kept, broken ones refused, calls tried again.

mod layers;

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use lightkiln_http::{CallError, RetryPolicy};
use lightkiln_proto::api::NewBake;
use lightkiln_proto::kinds::{prt, sh};
use lightkiln_proto::problem::{Problem, ProblemCode};
use lightkiln_proto::relight::PatchTable;

use super::*;
use crate::bake::{ClientKinds, LoadedBake};
use crate::fixture;
use crate::kinds;
use crate::lightmap::LightmapLight;

#[test]
fn bundle_loads_into_the_bake_that_was_written() {
    let folder = tempfile::tempdir().unwrap();
    fixture::write_bundle(folder.path(), prt::NAME);
    let source = Source::bundle(folder.path()).unwrap();
    let loaded = LoadedBake::load(&source, &kinds::all()).unwrap();
    let (scene, made) = fixture::prt_light(&fixture::prt_contents());
    assert_eq!(loaded.scene.textures, scene.textures);
    assert_eq!(loaded.scene.draws.triangle_count(), scene.draws.triangle_count());
    let light: LightmapLight<PatchTable> = kinds::prt::load(&source, &scene_of(&source)).unwrap();
    assert_eq!(light.transport.receivers.len(), made.transport.receivers.len());
    // Stored by receivers, so that slots, which depend on the order of clusters, are only as many.
    assert_eq!(light.transport.columns.patches, made.transport.columns.patches);
    assert_eq!(light.transport.columns.slots.len(), made.transport.columns.slots.len());
}

#[test]
fn bundle_of_probes_loads_into_the_bake_that_was_written() {
    let folder = tempfile::tempdir().unwrap();
    fixture::write_bundle(folder.path(), sh::NAME);
    let source = Source::bundle(folder.path()).unwrap();
    let light = kinds::sh::load(&source, &scene_of(&source)).unwrap();
    let (_, made) = fixture::sh_light(&fixture::sh_contents());
    let [found, made] = [&light, &made].map(|light| &light.transport);
    assert_eq!(found.columns.hits.len(), made.columns.hits.len());
    assert!(found.columns.hits.iter().any(|hit| (*hit as usize) < found.receivers.len()));
}

#[test]
fn chunks_of_a_server_come_from_the_cache_where_they_are_there_and_whole() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = fixture::write_bundle(folder.path(), prt::NAME);
    let chunks = chunk_refs(&manifest);
    let kept = tempfile::tempdir().unwrap();
    let bundle = Source::bundle(folder.path()).unwrap();
    let open = || DiskCache::open(kept.path(), 1 << 20).unwrap();
    open().put(chunks[0].digest, &bundle.chunk(&chunks[0]).unwrap()).unwrap();
    // Nothing answers there.
    let client = ApiClient::new("http://127.0.0.1:9", None).unwrap();
    let client = client.with_retry(RetryPolicy::new().with_max_times(0));
    let server = Source::server(client, "bake").with_cache(open());
    assert_eq!(server.chunk(&chunks[0]).unwrap(), bundle.chunk(&chunks[0]).unwrap());
    assert!(matches!(server.chunk(&chunks[1]), Err(ClientError::Call(_))));
    // A bundle has no use for one.
    assert!(matches!(bundle.with_cache(open()), Source::Bundle(_)));
}

fn scene_of(source: &Source) -> crate::scene::LoadedScene {
    crate::scene::LoadedScene::load(source).unwrap()
}

#[test]
fn manifest_that_its_kind_refuses_ends_the_load_before_any_chunk_but_its_directory() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = fixture::write_bundle(folder.path(), prt::NAME);
    let pages = manifest.chunks(DIRECTORY);
    for chunk in chunk_refs(&manifest).iter().filter(|chunk| !pages.contains(chunk)) {
        fs::remove_file(chunk_path(folder.path(), chunk.digest)).unwrap();
    }
    let load =
        |kinds: ClientKinds| LoadedBake::load(&Source::bundle(folder.path()).unwrap(), &kinds).unwrap_err();
    assert!(matches!(load(kinds::all()), ClientError::File { .. }));
    let foreign = load(ClientKinds::new().with(kinds::sh::Sh)).to_string();
    assert!(foreign.contains("'prt'") && foreign.contains("sh"), "{foreign}");
    let file = folder.path().join(MANIFEST_FILE);
    let stored: serde_json::Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    for place in ["/body/totals/clusters", "/directory/0/clusters"] {
        let mut wrong = stored.clone();
        *wrong.pointer_mut(place).unwrap() = serde_json::json!(99);
        fs::write(&file, wrong.to_string()).unwrap();
        let contradiction = load(kinds::all());
        assert!(matches!(contradiction, ClientError::Manifest { .. }), "{place}: {contradiction}");
    }
    // A page that is lost is named as any chunk is.
    fs::write(&file, stored.to_string()).unwrap();
    fs::remove_file(chunk_path(folder.path(), pages[0].digest)).unwrap();
    assert!(matches!(load(kinds::all()), ClientError::File { .. }));
}

#[test]
fn download_is_whole_and_keeps_right_chunks() {
    let [from, to] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let manifest = fixture::write_bundle(from.path(), prt::NAME);
    let source = Source::bundle(from.path()).unwrap();
    let refs = chunk_refs(&manifest);
    assert!(refs.len() > 5);
    let all = refs.len() as u64;
    let (_, first) = download_bundle(&source, to.path()).unwrap();
    assert_eq!((first.fetched, first.kept), (all, 0));
    assert_eq!(first.fetched_bytes, refs.iter().map(|chunk| chunk.bytes).sum::<u64>());
    let broken = chunk_path(to.path(), refs[1].digest);
    fs::write(&broken, vec![7; refs[1].bytes as usize]).unwrap();
    fs::remove_file(to.path().join(MANIFEST_FILE)).unwrap();
    let (_, second) = download_bundle(&source, to.path()).unwrap();
    assert_eq!((second.fetched, second.kept), (1, all - 1));
    LoadedBake::load(&Source::bundle(to.path()).unwrap(), &kinds::all()).unwrap();
    let left = fs::read_dir(to.path().join(CHUNKS_FOLDER)).unwrap().count() as u64;
    assert_eq!(left, all, "temporary files are left");
}

#[test]
fn failed_download_leaves_no_manifest() {
    let [from, to] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let manifest = fixture::write_bundle(from.path(), prt::NAME);
    fs::remove_file(chunk_path(from.path(), manifest.chunks(prt::PATCHES)[0].digest)).unwrap();
    let error = download_bundle(&Source::bundle(from.path()).unwrap(), to.path()).unwrap_err();
    assert!(matches!(error, ClientError::File { .. }), "{error}");
    assert!(!to.path().join(MANIFEST_FILE).exists());
}

#[test]
fn wrong_bytes_and_wrong_lengths_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let manifest = fixture::write_bundle(folder.path(), prt::NAME);
    let source = Source::bundle(folder.path()).unwrap();
    let chunk = manifest.chunks(prt::PATCHES)[0].clone();
    let path = chunk_path(folder.path(), chunk.digest);
    let bytes = fs::read(&path).unwrap();
    let mut flipped = bytes.clone();
    flipped[10] ^= 1;
    fs::write(&path, &flipped).unwrap();
    assert!(matches!(source.chunk(&chunk).unwrap_err(), ClientError::WrongDigest { .. }));
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    assert!(matches!(source.chunk(&chunk).unwrap_err(), ClientError::WrongDigest { .. }));
    fs::write(&path, [&bytes[..], &[0]].concat()).unwrap();
    assert!(matches!(source.chunk(&chunk).unwrap_err(), ClientError::TooLarge { .. }));
    let huge = ChunkRef { bytes: u64::MAX, ..chunk };
    assert!(matches!(source.chunk(&huge).unwrap_err(), ClientError::TooLarge { .. }));
}

#[test]
fn manifest_of_another_format_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut manifest = fixture::manifest(prt::NAME);
    manifest.version = 99;
    fs::write(folder.path().join(MANIFEST_FILE), serde_json::to_vec(&manifest).unwrap()).unwrap();
    let error = Source::bundle(folder.path()).unwrap().manifest().unwrap_err();
    assert!(error.to_string().contains("cannot be used"), "{error}");
    let cause = std::error::Error::source(&error).unwrap().to_string();
    assert!(cause.contains("version 99"), "{cause}");
    assert!(Source::bundle(folder.path().join("nowhere")).is_err());
}

/// First line and body of a request.
type Asked = (String, Vec<u8>);

/// A server that gives prepared answers, one per connection, and notes requests' first lines and bodies.
struct Scripted {
    base: String,
    asked: Arc<Mutex<Vec<Asked>>>,
}

fn answer(status: u16, content_type: &str, body: &[u8]) -> Vec<u8> {
    let head = format!(
        "HTTP/1.1 {status} x\r\nContent-Type: {content_type}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    [head.as_bytes(), body].concat()
}

fn problem(code: ProblemCode, detail: &str) -> Vec<u8> {
    let body = serde_json::to_vec(&Problem::new(code, detail)).unwrap();
    answer(code.row().0, "application/problem+json", &body)
}

impl Scripted {
    fn start(answers: Vec<Vec<u8>>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        let asked = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&asked);
        std::thread::spawn(move || {
            let mut answers = VecDeque::from(answers);
            while let Some(next) = answers.pop_front() {
                let (stream, _) = listener.accept().unwrap();
                let mut reader = BufReader::new(stream);
                let (mut first, mut length) = (String::new(), 0);
                reader.read_line(&mut first).unwrap();
                loop {
                    let mut line = String::new();
                    reader.read_line(&mut line).unwrap();
                    if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                        length = value.trim().parse().unwrap();
                    }
                    if line.trim().is_empty() {
                        break;
                    }
                }
                let mut body = vec![0; length];
                reader.read_exact(&mut body).unwrap();
                noted.lock().unwrap().push((first.trim().to_owned(), body));
                reader.get_mut().write_all(&next).unwrap();
            }
        });
        Self { base, asked }
    }

    fn client(&self) -> ApiClient {
        let wait = Duration::from_millis(1);
        let retry = RetryPolicy::new().with_min_delay(wait).with_max_delay(wait).with_max_times(3);
        ApiClient::new(&self.base, None).unwrap().with_retry(retry)
    }

    fn asked(&self) -> Vec<String> {
        self.asked.lock().unwrap().iter().map(|(first, _)| first.clone()).collect()
    }
}

#[test]
fn calls_that_may_pass_later_are_tried_again() {
    let server = Scripted::start(vec![
        problem(ProblemCode::Unavailable, "the database is away"),
        answer(502, "text/html", b"<h1>bad gateway</h1>"),
        answer(200, "application/json", br#"{"workers":[]}"#),
    ]);
    assert!(server.client().workers().unwrap().workers.is_empty());
    assert_eq!(server.asked().len(), 3);
}

#[test]
fn problems_that_stay_are_shown_with_their_detail_at_once() {
    let server = Scripted::start(vec![problem(ProblemCode::BadSettings, "texel_m = -1 is out of range")]);
    let bake = NewBake {
        name: "n".to_owned(),
        scene: Digest::of(b""),
        kind: "prt".to_owned(),
        settings: serde_json::Value::Null,
        priority: 0,
        needs: lightkiln_proto::api::Needs::default(),
        attempt_limit_secs: None,
        limits: Default::default(),
        verify_share: 0.0,
    };
    let error = server.client().submit(&bake, "key-1").unwrap_err();
    assert!(error.to_string().contains("texel_m = -1 is out of range"), "{error}");
    assert_eq!(server.asked(), ["POST /v1/bakes HTTP/1.1"]);
    assert!(matches!(server.client().submit(&bake, "two words").unwrap_err(), ClientError::Argument { .. }));
}

#[test]
fn patience_ends() {
    let server = Scripted::start(vec![problem(ProblemCode::Unavailable, "away"); 4]);
    let error = server.client().bake("b").unwrap_err();
    assert!(matches!(&error, ClientError::Call(error) if error.status() == Some(503)), "{error}");
    assert_eq!(server.asked().len(), 4);
    let client = server.client();
    assert!(matches!(client.bake("b").unwrap_err(), ClientError::Call(CallError::Network { .. })));
}

#[test]
fn scene_that_the_server_has_is_not_uploaded() {
    let scene = Digest::of(b"bundle");
    let stored = format!(r#"{{"scene":"{scene}","bytes":6}}"#);
    let missing = format!(r#"{{"is_stored":false,"missing":["{scene}"]}}"#);
    let server = Scripted::start(vec![
        answer(200, "application/json", br#"{"is_stored":true,"missing":[]}"#),
        answer(200, "application/json", missing.as_bytes()),
        answer(201, "application/json", stored.as_bytes()),
    ]);
    let client = server.client();
    assert_eq!(client.upload_scene(b"bundle").unwrap().scene, scene);
    assert_eq!(client.upload_scene(b"bundle").unwrap().bytes, 6);
    let methods: Vec<String> = server.asked().iter().map(|line| line[..4].trim().to_owned()).collect();
    assert_eq!(methods, ["POST", "POST", "PUT"]);
    assert_eq!(server.asked.lock().unwrap()[2].1, b"bundle");
}

#[test]
fn chunk_from_a_server_is_verified_and_limited() {
    let digest = Digest::of(b"right");
    let server = Scripted::start(vec![
        answer(200, "application/octet-stream", b"right"),
        answer(200, "application/octet-stream", b"wrong"),
        answer(200, "application/octet-stream", b"right and more"),
    ]);
    let client = server.client();
    assert_eq!(client.chunk(digest, 5).unwrap(), b"right");
    assert!(matches!(client.chunk(digest, 5).unwrap_err(), ClientError::WrongDigest { .. }));
    assert!(matches!(client.chunk(digest, 5).unwrap_err(), ClientError::Call(CallError::TooLarge { .. })));
}

#[test]
fn texts_that_are_no_server_are_refused() {
    for text in ["", "localhost:8080", "ftp://x", "http://", "http://x/?a=b", "no url"] {
        assert!(ApiClient::new(text, None).is_err(), "{text}");
    }
    assert_eq!(ApiClient::new("http://x:1/base/", None).unwrap().base(), "http://x:1/base");
}
