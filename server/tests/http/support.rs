//! A server on a free port and a client that speaks just enough HTTP to be rude.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::{Problem, ProblemCode};
use lightkiln_server::{Config, LimitConfig, Server, ServerError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use crate::parts::kind::kinds;

pub struct Running {
    pub address: SocketAddr,
    pub folder: tempfile::TempDir,
    stop: oneshot::Sender<()>,
    served: JoinHandle<Result<(), ServerError>>,
}

/// An answer, body and all.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

pub async fn start() -> Running {
    start_in(tempfile::tempdir().unwrap()).await
}

pub async fn start_in(folder: tempfile::TempDir) -> Running {
    start_with(folder, LimitConfig::default()).await
}

pub async fn start_with(folder: tempfile::TempDir, limits: LimitConfig) -> Running {
    start_config(folder, |config| Config { limits, ..config }).await
}

pub async fn start_config(folder: tempfile::TempDir, change: impl FnOnce(Config) -> Config) -> Running {
    let config = change(Config { kinds: kinds(), ..Config::new(folder.path()) });
    let server = Server::open(config).await.unwrap();
    let listener = server.bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let (stop, stopped) = oneshot::channel();
    let served = tokio::spawn(server.serve(listener, async move {
        // A dropped test stops the server too.
        let _ = stopped.await;
    }));
    Running { address, folder, stop, served }
}

impl Running {
    /// Stops the server, which must end well, and gives its folder back.
    pub async fn stop(self) -> tempfile::TempDir {
        self.stop.send(()).unwrap();
        self.served.await.unwrap().unwrap();
        self.folder
    }

    /// Sends a request and reads the whole answer.
    pub async fn call(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        let mut stream = self.open(method, path, headers, body).await;
        read_answer(&mut stream, method == "HEAD").await
    }

    /// Sends a request; the answer is still to be read.
    pub async fn open(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> BufReader<TcpStream> {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        let mut head = format!("{method} {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n");
        if !headers.iter().any(|(name, _)| matches!(*name, "Content-Length" | "Transfer-Encoding")) {
            head += &format!("Content-Length: {}\r\n", body.len());
        }
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        head += "\r\n";
        stream.write_all(head.as_bytes()).await.unwrap();
        // A server that refuses a body closes before it has read all of it.
        let _ = stream.write_all(body).await;
        BufReader::new(stream)
    }

    pub async fn get(&self, path: &str) -> Answer {
        self.call("GET", path, &[], b"").await
    }

    pub async fn post<T: Serialize>(&self, path: &str, body: &T) -> Answer {
        let body = serde_json::to_vec(body).unwrap();
        self.call("POST", path, &[("Content-Type", "application/json")], &body).await
    }

    /// Stores bytes as a chunk.
    pub async fn put_chunk(&self, bytes: &[u8]) -> Digest {
        let digest = Digest::of(bytes);
        let answer = self.call("PUT", &format!("/v1/chunks/{digest}"), &[], bytes).await;
        assert!(matches!(answer.status, 200 | 201), "{answer:?}");
        digest
    }

    /// Where a chunk lies on the disk.
    pub fn chunk_file(&self, digest: Digest) -> std::path::PathBuf {
        let hex = digest.to_string();
        let shard = Path::new(self.folder.path()).join("chunks").join(&hex[..2]);
        let is_its = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with(&hex[2..]);
        let files = std::fs::read_dir(&shard).unwrap().map(|entry| entry.unwrap().path());
        files.into_iter().find(is_its).expect("a file of the chunk")
    }
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(known, _)| known.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.as_str())
    }

    /// The body as JSON, of an answer with that status.
    pub fn json<T: DeserializeOwned>(&self, status: u16) -> T {
        let body = String::from_utf8_lossy(&self.body);
        assert_eq!(self.status, status, "{body}");
        assert_eq!(self.header("content-type"), Some("application/json"));
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The body as a problem, which must have that code and be well formed.
    pub fn problem(&self, code: ProblemCode) -> Problem {
        let body = String::from_utf8_lossy(&self.body);
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{} {body}", self.status);
        let problem: Problem = serde_json::from_slice(&self.body).unwrap();
        assert_eq!((problem.code, problem.status), (code, self.status), "{body}");
        assert_eq!(problem, Problem::new(code, problem.detail.clone()));
        assert!(!problem.detail.is_empty());
        problem
    }
}

/// Reads the status line and the headers.
pub async fn read_head<S: AsyncRead + Unpin>(stream: &mut BufReader<S>) -> (u16, Vec<(String, String)>) {
    let mut lines = Vec::new();
    loop {
        let mut line = String::new();
        assert!(stream.read_line(&mut line).await.unwrap() > 0, "the answer ends in its head");
        if line.trim_end().is_empty() {
            break;
        }
        lines.push(line.trim_end().to_owned());
    }
    let status = lines[0].split(' ').nth(1).unwrap().parse().unwrap();
    let headers = lines[1..].iter().map(|line| {
        let (name, value) = line.split_once(": ").unwrap();
        (name.to_owned(), value.to_owned())
    });
    (status, headers.collect())
}

pub async fn read_answer<S: AsyncRead + Unpin>(stream: &mut BufReader<S>, is_head: bool) -> Answer {
    let (status, headers) = read_head(stream).await;
    let mut answer = Answer { status, headers, body: Vec::new() };
    if is_head {
        return answer;
    }
    if answer.header("transfer-encoding") == Some("chunked") {
        while let Some(piece) = read_piece(stream).await {
            answer.body.extend_from_slice(&piece);
        }
    } else if let Some(length) = answer.header("content-length") {
        answer.body = vec![0; length.parse().unwrap()];
        stream.read_exact(&mut answer.body).await.unwrap();
    } else {
        stream.read_to_end(&mut answer.body).await.unwrap();
    }
    answer
}

/// Reads one piece of a body that comes in pieces; nothing at its end.
pub async fn read_piece<S: AsyncRead + Unpin>(stream: &mut BufReader<S>) -> Option<Vec<u8>> {
    let mut size = String::new();
    stream.read_line(&mut size).await.unwrap();
    let size = usize::from_str_radix(size.trim_end(), 16).unwrap();
    let mut piece = vec![0; size + 2];
    stream.read_exact(&mut piece).await.unwrap();
    piece.truncate(size);
    (size > 0).then_some(piece)
}
