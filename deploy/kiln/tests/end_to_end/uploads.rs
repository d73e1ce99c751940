//! Uploads of big scenes over connections that are cut.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::SCENE_PART_BYTES;
use lightkiln_proto::ids::Digest;

use super::processes::{Server, kiln, run};

/// Stands between callers and a server, and cuts every connection once callers have sent so many bytes.
struct Cutter {
    url: String,
    sent: Arc<AtomicU64>,
    limit: Arc<AtomicU64>,
}

impl Cutter {
    fn before(server_url: &str, limit: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let server = server_url.strip_prefix("http://").unwrap().to_owned();
        let (sent, limit) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(limit)));
        let (counted, held) = (sent.clone(), limit.clone());
        std::thread::spawn(move || {
            for caller in listener.incoming().map_while(Result::ok) {
                let callee = TcpStream::connect(&server).unwrap();
                let (back_from, back_to) = (callee.try_clone().unwrap(), caller.try_clone().unwrap());
                std::thread::spawn(move || carry(back_from, back_to, |_| true));
                let (counted, held) = (counted.clone(), held.clone());
                let count = move |length| {
                    counted.fetch_add(length, Ordering::SeqCst) + length <= held.load(Ordering::SeqCst)
                };
                std::thread::spawn(move || carry(caller, callee, count));
            }
        });
        Self { url, sent, limit }
    }
}

/// Passes bytes on while `may` lets it, then cuts both ways.
fn carry(mut from: TcpStream, mut to: TcpStream, may: impl Fn(u64) -> bool) {
    let mut bytes = vec![0; 64 << 10];
    while let Ok(length @ 1..) = from.read(&mut bytes) {
        if !may(length as u64) || to.write_all(&bytes[..length]).is_err() {
            break;
        }
    }
    // Either may be closed already.
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}

/// A scene of that many bytes that nothing can compress; only a worker would look into it.
fn big_scene(length: usize) -> Vec<u8> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut scene = b"PK\x03\x04".to_vec();
    while scene.len() < length {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        scene.extend(state.to_le_bytes());
    }
    scene
}

#[test]
fn upload_that_was_cut_goes_on_with_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let scene = big_scene(5 * SCENE_PART_BYTES);
    let path = folder.path().join("big.zip");
    std::fs::write(&path, &scene).unwrap();
    let part = SCENE_PART_BYTES as u64;
    // Two parts pass, and half of the third.
    let cutter = Cutter::before(&server.url, 2 * part + part / 2);
    let submit = ["submit", &path.display().to_string(), "--server", &cutter.url, "--patience", "0"];
    let cut = run(kiln(folder.path()), &submit, 3);
    assert!(cut.stderr().contains("the upload goes on where it was"), "{}", cut.stderr());
    cutter.limit.store(u64::MAX, Ordering::SeqCst);
    cutter.sent.store(0, Ordering::SeqCst);
    let id = run(kiln(folder.path()), &submit, 0).stdout().trim().to_owned();
    let sent = cutter.sent.load(Ordering::SeqCst);
    assert!((3 * part..3 * part + part / 2).contains(&sent), "{sent} bytes for the last three parts");
    let client = ApiClient::new(&server.url, None).unwrap();
    assert_eq!(client.bake(&id).unwrap().scene, Digest::of(&scene));
    assert_eq!(client.chunk(Digest::of(&scene), scene.len() as u64).unwrap(), scene);
    // A changed scene sends what changed.
    let mut changed = scene;
    changed[SCENE_PART_BYTES + 5] ^= 1;
    std::fs::write(&path, &changed).unwrap();
    cutter.sent.store(0, Ordering::SeqCst);
    run(kiln(folder.path()), &submit, 0);
    let sent = cutter.sent.load(Ordering::SeqCst);
    assert!((part..part + part / 2).contains(&sent), "{sent} bytes for the part that changed");
}
