//! Connections that say nothing, little, or little at a time.

use std::time::Duration;

use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;
use lightkiln_server::{Config, ConnectionConfig, LimitConfig};
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

use crate::bakes::request;
use crate::support::{Answer, Running, read_answer, start_config};

/// Longest that a test waits for one thing.
const LIMIT: Duration = Duration::from_secs(60);

async fn start(connections: ConnectionConfig, limits: LimitConfig) -> Running {
    start_config(tempfile::tempdir().unwrap(), |config| Config { connections, limits, ..config }).await
}

/// A connection that has sent so much of a request.
async fn begin(server: &Running, beginning: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    stream.write_all(beginning).await.unwrap();
    stream
}

/// Waits until the server has ended a connection.
async fn is_ended(stream: &mut TcpStream) {
    let end = async {
        let mut byte = [0];
        while matches!(stream.read(&mut byte).await, Ok(count) if count > 0) {}
    };
    tokio::time::timeout(LIMIT, end).await.expect("the connection is ended");
}

#[tokio::test]
async fn crowd_of_half_open_connections_keeps_nobody_out_and_no_call_is_cut_off() {
    let connections = ConnectionConfig { at_a_time: 60, of_address: 40, ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let claim = serde_json::to_vec(&request(60)).unwrap();
    let mut waiting =
        server.open("POST", "/v1/leases", &[("Content-Type", "application/json")], &claim).await;
    let mut crowd = Vec::new();
    for index in 0..300 {
        let beginning: &[u8] = if index % 2 == 0 { b"" } else { b"GET /healthz HTTP/1.1\r\nHost: " };
        crowd.push(begin(&server, beginning).await);
        if index % 50 == 49 {
            assert_eq!(server.get("/healthz").await.status, 200);
            assert_eq!(server.get("/v1/bakes").await.status, 200);
        }
    }
    is_ended(&mut crowd[0]).await;
    is_ended(&mut crowd[1]).await;
    let mut byte = [0];
    let heard = tokio::time::timeout(Duration::from_millis(100), waiting.read(&mut byte)).await;
    assert!(heard.is_err(), "the worker that waits for a task is not cut off: {heard:?}");
}

#[tokio::test]
async fn address_whose_connections_all_have_calls_gets_no_more_until_one_ends() {
    let connections = ConnectionConfig { at_a_time: 60, of_address: 3, ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let claim = serde_json::to_vec(&request(60)).unwrap();
    let json = [("Content-Type", "application/json")];
    let mut waiting = Vec::new();
    // A call that has not begun when the next connection comes makes room for it: another is made then.
    let refused = async {
        while is_served(&server).await {
            waiting.push(server.open("POST", "/v1/leases", &json, &claim).await);
        }
    };
    tokio::time::timeout(LIMIT, refused).await.expect("a fourth connection is refused");
    assert!(waiting.len() >= 3, "three have calls: {}", waiting.len());
    waiting.clear();
    let served = async { while !is_served(&server).await {} };
    tokio::time::timeout(LIMIT, served).await.expect("there is room again");
}

/// Whether a further connection is let in.
async fn is_served(server: &Running) -> bool {
    let request = b"GET /healthz HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n";
    let mut stream = begin(server, request).await;
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer).await;
    answer.starts_with(b"HTTP/1.1 200")
}

#[tokio::test]
async fn head_that_drips_and_connection_that_idles_are_ended() {
    let short = Duration::from_millis(300);
    let connections = ConnectionConfig { head_timeout: short, ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let mut silent = begin(&server, b"").await;
    is_ended(&mut silent).await;
    let mut drips = begin(&server, b"GET /").await;
    // Each byte comes well within the time, all of them do not.
    let drip = async {
        while drips.write_all(b"x").await.is_ok() {
            tokio::time::sleep(short / 10).await
        }
    };
    tokio::time::timeout(LIMIT, drip).await.expect("a head that drips is cut off");
    let connections = ConnectionConfig { idle_timeout: short, ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let mut idle = begin(&server, b"GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n").await;
    is_ended(&mut idle).await;
}

/// The answer to an upload that comes byte by byte.
async fn drip(server: &Running, method: &str, path: &str, kind: &str) -> Answer {
    let head = [("Content-Length", "1000000"), ("Content-Type", kind)];
    let stream = server.open(method, path, &head, b"{").await;
    let (read, mut write) = stream.into_inner().into_split();
    let drip = tokio::spawn(async move {
        while write.write_all(b" ").await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    let answer = tokio::time::timeout(LIMIT, read_answer(&mut BufReader::new(read), false)).await;
    drip.abort();
    answer.expect("an answer before the body's end")
}

#[tokio::test]
async fn body_that_drips_ends_with_408_and_a_steady_one_does_not() {
    let patience = Duration::from_millis(500);
    let limits =
        LimitConfig { body_bytes_per_sec: 10_000, body_patience: patience, ..LimitConfig::default() };
    let server = start(ConnectionConfig::default(), limits).await;
    let digest = Digest::of(b"never comes");
    for (method, path, kind) in [
        ("PUT", format!("/v1/chunks/{digest}"), "application/octet-stream"),
        ("POST", "/v1/leases".to_owned(), "application/json"),
        ("POST", format!("/v1/leases/{}/commit", "0".repeat(32)), "application/json"),
    ] {
        let answer = drip(&server, method, &path, kind).await;
        let detail = answer.problem(ProblemCode::BrokeOff).detail;
        assert_eq!(answer.status, 408, "{path}");
        assert!(detail.contains("bytes a second"), "{path}: {detail}");
    }
    // As long as the patience lasts, four times over, and ten times the rate.
    let bytes = vec![7; 200_000];
    let steady = Digest::of(&bytes);
    let path = format!("/v1/chunks/{steady}");
    let mut stream = server.open("PUT", &path, &[("Content-Length", "200000")], b"").await;
    for piece in bytes.chunks(10_000) {
        tokio::time::sleep(patience / 5).await;
        stream.get_mut().write_all(piece).await.unwrap();
    }
    assert_eq!(read_answer(&mut stream, false).await.status, 201);
}

/// A call by HTTP/2, without TLS, of a caller that takes no byte of an answer: the beginning of the protocol, SETTINGS with
/// INITIAL_WINDOW_SIZE = 0, and `GET /` in HEADERS.
const REFUSES_ANSWER: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\
    \x00\x00\x06\x04\x00\x00\x00\x00\x00\x00\x04\x00\x00\x00\x00\
    \x00\x00\x03\x01\x05\x00\x00\x00\x01\x82\x86\x84";

#[tokio::test]
async fn caller_that_takes_no_byte_of_an_answer_is_cut_off() {
    let connections =
        ConnectionConfig { stall_timeout: Duration::from_millis(300), ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let mut refuses = begin(&server, REFUSES_ANSWER).await;
    is_ended(&mut refuses).await;
}

#[tokio::test]
async fn server_that_stops_does_not_wait_for_half_sent_heads() {
    let hour = Duration::from_secs(3600);
    let connections = ConnectionConfig { head_timeout: hour, ..ConnectionConfig::default() };
    let server = start(connections, LimitConfig::default()).await;
    let _half = begin(&server, b"GET /healthz HTTP/1.1\r\nHost: ").await;
    assert_eq!(server.get("/healthz").await.status, 200, "the half-sent head has been taken in");
    tokio::time::timeout(LIMIT, server.stop()).await.expect("the server stops");
}
