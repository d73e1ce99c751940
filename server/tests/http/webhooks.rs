//! Ends of bakes, told to a receiver of this test's.

use std::time::Duration;

use lightkiln_proto::api::Bake;
use lightkiln_server::{Config, WebhookConfig};
use serde_json::Value;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};

use crate::bakes::{request, submit};
use crate::support::{Running, start_config};

/// Longest that anything here may take.
const LIMIT: Duration = Duration::from_secs(60);
const SECRET: &str = "a secret of this test";

struct Receiver {
    listener: TcpListener,
}

/// One request as it came.
#[derive(Debug)]
struct Told {
    headers: Vec<(String, String)>,
    body: Vec<u8>,
}

impl Told {
    fn header(&self, name: &str) -> &str {
        let found = self.headers.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        &found.unwrap_or_else(|| panic!("no {name} in {:?}", self.headers)).1
    }

    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }
}

impl Receiver {
    async fn listen() -> Self {
        Self { listener: TcpListener::bind("127.0.0.1:0").await.unwrap() }
    }

    fn port(&self) -> u16 {
        self.listener.local_addr().unwrap().port()
    }

    /// The next request, answered with a status.
    async fn next(&self, status: &str) -> Told {
        let next = async {
            let (stream, _) = self.listener.accept().await.unwrap();
            let mut stream = BufReader::new(stream);
            let headers = head_of(&mut stream).await;
            let mut told = Told { headers, body: Vec::new() };
            told.body = vec![0; told.header("content-length").parse().unwrap()];
            stream.read_exact(&mut told.body).await.unwrap();
            let answer = format!("HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
            stream.write_all(answer.as_bytes()).await.unwrap();
            told
        };
        tokio::time::timeout(LIMIT, next).await.expect("a webhook comes")
    }

    /// Whether somebody connects within the time.
    async fn is_called_within(&self, time: Duration) -> bool {
        tokio::time::timeout(time, self.listener.accept()).await.is_ok()
    }
}

/// The headers of a request.
async fn head_of(stream: &mut BufReader<TcpStream>) -> Vec<(String, String)> {
    let mut headers = Vec::new();
    loop {
        let mut line = String::new();
        assert!(stream.read_line(&mut line).await.unwrap() > 0, "the request ends in its head");
        match line.trim_end().split_once(": ") {
            Some((name, value)) => headers.push((name.to_owned(), value.to_owned())),
            None if line.trim_end().is_empty() => return headers,
            None => assert!(line.starts_with("POST "), "{line}"),
        }
    }
}

fn config(urls: &[String], allow_local: bool) -> WebhookConfig {
    let config = WebhookConfig::new(urls, SECRET, allow_local).unwrap();
    let short = Duration::from_millis(50);
    WebhookConfig { interval: short, first_wait: short, ..config }
}

async fn server_in(folder: tempfile::TempDir, webhooks: WebhookConfig) -> Running {
    start_config(folder, |config: Config| Config { webhooks: Some(webhooks), ..config }).await
}

async fn server(webhooks: WebhookConfig) -> Running {
    server_in(tempfile::tempdir().unwrap(), webhooks).await
}

async fn cancelled_bake(server: &Running) -> Bake {
    let bake = submit(server).await;
    server.call("POST", &format!("/v1/bakes/{}/cancel", bake.id), &[], b"").await.json(200)
}

/// The check of deploy/README.md.
fn is_signed(told: &Told) -> bool {
    let page = include_str!("../../../deploy/README.md");
    let (_, rest) = page.split_once("```python\n").expect("the page has the check");
    let (script, _) = rest.split_once("```").unwrap();
    let call = format!(
        "{script}\nimport sys\nbody = sys.stdin.buffer.read()\nassert is_signed({SECRET:?}.encode(), {:?}, body)\n\
         assert not is_signed(b'another secret', {:?}, body)\nassert not is_signed({SECRET:?}.encode(), {:?}, body + b' ')\n",
        told.header("lightkiln-signature"),
        told.header("lightkiln-signature"),
        told.header("lightkiln-signature"),
    );
    let mut python = std::process::Command::new("python3")
        .args(["-c", &call])
        .stdin(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    std::io::Write::write_all(&mut python.stdin.take().unwrap(), &told.body).unwrap();
    python.wait().unwrap().success()
}

#[tokio::test]
async fn end_of_a_bake_is_told_signed_and_again_until_it_is_taken() {
    let receiver = Receiver::listen().await;
    let url = format!("http://127.0.0.1:{}/hook?key=1", receiver.port());
    let server = server(config(&[url], true)).await;
    let bake = cancelled_bake(&server).await;
    let first = receiver.next("500 Internal Server Error").await;
    let again = receiver.next("302 Found\r\nLocation: /elsewhere").await;
    let taken = receiver.next("204 No Content").await;
    for told in [&first, &again, &taken] {
        assert_eq!(told.header("lightkiln-delivery"), format!("{}.cancelled", bake.id));
        assert_eq!(told.body, first.body);
        assert!(is_signed(told), "{told:?}");
    }
    let told = taken.json();
    assert_eq!((&told["type"], &told["bake"]["id"]), (&"bake.cancelled".into(), &bake.id.as_str().into()));
    assert_eq!(told["id"], taken.header("lightkiln-delivery"));
    assert_eq!(told["at_ms"], bake.finished_ms.unwrap());
    assert!(!receiver.is_called_within(Duration::from_millis(500)).await, "what was taken is not told again");
    // The next end is told, and only that.
    let next = cancelled_bake(&server).await;
    assert_eq!(receiver.next("200 OK").await.json()["bake"]["id"], next.id.as_str());
}

#[tokio::test]
async fn server_that_starts_tells_what_ended_lately_under_the_same_id() {
    let receiver = Receiver::listen().await;
    let url = format!("http://127.0.0.1:{}/", receiver.port());
    let first = server(config(&[], true)).await;
    let bake = cancelled_bake(&first).await;
    let running = submit(&first).await;
    let folder = first.stop().await;
    let second = server_in(folder, config(&[url], true)).await;
    assert_eq!(receiver.next("200 OK").await.header("lightkiln-delivery"), format!("{}.cancelled", bake.id));
    // One that went on over the restart is told when it ends.
    let _: Bake = second.call("POST", &format!("/v1/bakes/{}/cancel", running.id), &[], b"").await.json(200);
    assert_eq!(receiver.next("200 OK").await.json()["bake"]["id"], running.id.as_str());
}

#[tokio::test]
async fn receiver_that_never_answers_holds_nothing_up() {
    let [stuck, well] = [Receiver::listen().await, Receiver::listen().await];
    let urls = [&stuck, &well].map(|receiver| format!("http://127.0.0.1:{}/", receiver.port()));
    let server = server(config(&urls, true)).await;
    for _ in 0..20 {
        let bake = cancelled_bake(&server).await;
        assert_eq!(well.next("200 OK").await.json()["bake"]["id"], bake.id.as_str());
    }
    assert_eq!(server.post("/v1/leases", &request(0)).await.status, 200);
}

#[tokio::test]
async fn name_that_leads_to_this_machine_is_not_called() {
    let receiver = Receiver::listen().await;
    let url = format!("http://localhost:{}/", receiver.port());
    let refused = server(config(std::slice::from_ref(&url), false)).await;
    cancelled_bake(&refused).await;
    assert!(!receiver.is_called_within(Duration::from_secs(2)).await);
    let allowed = server(config(&[url], true)).await;
    let bake = cancelled_bake(&allowed).await;
    assert_eq!(receiver.next("200 OK").await.json()["bake"]["id"], bake.id.as_str());
    assert!(WebhookConfig::new(&[format!("http://127.0.0.1:{}/", receiver.port())], SECRET, false).is_err());
    assert!(WebhookConfig::new(&[], "short", false).is_err());
}
