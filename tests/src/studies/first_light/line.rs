//! First light over a line: a server of a bundle's files that is as far and as slow as one likes.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use lightkiln_client::fetch::{ApiClient, CHUNKS_FOLDER, MANIFEST_FILE, Source};
use lightkiln_client::kinds;
use lightkiln_client::preview::StreamedBake;
use lightkiln_client::stream::Budget;

/// Bytes that go over the line at a time.
const PIECE: usize = 4096;

/// A line.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Time from a question to the first byte of its answer; so long a connection takes, too.
    pub rtt: Duration,
    /// Bytes that all connections together bring in a second.
    pub bytes_per_sec: f64,
}

/// First light of a bundle that came over a line.
#[derive(Clone, Copy, Debug)]
pub struct FirstOverLine {
    /// Requests.
    pub requests: u64,
    /// Bytes of their bodies.
    pub bytes: u64,
    /// Time of the last byte.
    pub last_byte: Duration,
    /// Time when scene and light are in memory, ready to be drawn.
    pub ready: Duration,
}

/// Requests and bytes over a line so far.
#[derive(Debug)]
struct Traffic {
    /// When the line is free again.
    free: Instant,
    requests: u64,
    bytes: u64,
}

/// Fetches the first light of a bundle over a line.
pub fn first_over_line(bundle: &Path, line: Line) -> Result<FirstOverLine> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let base = format!("http://{}", listener.local_addr()?);
    let begun = Instant::now();
    let traffic = Arc::new(Mutex::new(Traffic { free: begun, requests: 0, bytes: 0 }));
    let (folder, noted) = (bundle.to_owned(), Arc::clone(&traffic));
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (folder, traffic) = (folder.clone(), Arc::clone(&noted));
            std::thread::spawn(move || {
                // A client that has gone ends its connection.
                let _ = serve(stream, &folder, line, &traffic);
            });
        }
    });
    let source = Source::server(ApiClient::new(&base, None)?, "bake");
    let streamed = StreamedBake::begin(&source, &kinds::all(), Budget::NONE)?;
    let ready = begun.elapsed();
    drop(streamed);
    let traffic = traffic.lock().unwrap_or_else(PoisonError::into_inner);
    let (requests, bytes) = (traffic.requests, traffic.bytes);
    Ok(FirstOverLine { requests, bytes, last_byte: traffic.free - begun, ready })
}

/// Answers the requests of one connection.
fn serve(stream: TcpStream, folder: &Path, line: Line, traffic: &Mutex<Traffic>) -> Result<()> {
    stream.set_nodelay(true)?;
    wait_until(Instant::now() + line.rtt);
    let mut reader = BufReader::new(stream);
    loop {
        let Some((path, range)) = request(&mut reader)? else { return Ok(()) };
        let bytes = std::fs::read(file_of(folder, &path))?;
        let part = range.unwrap_or(0..bytes.len());
        let (status, body) = match bytes.get(part.clone()) {
            Some(body) if body.len() < bytes.len() => ("206 Partial Content", body),
            _ => ("200 OK", &bytes[..]),
        };
        wait_until(Instant::now() + line.rtt);
        let range =
            format!("Content-Range: bytes {}-{}/{}\r\n", part.start, part.end.max(1) - 1, bytes.len());
        let range = if body.len() < bytes.len() { range } else { String::new() };
        let head = format!("HTTP/1.1 {status}\r\n{range}Content-Length: {}\r\n\r\n", body.len());
        reader.get_mut().write_all(head.as_bytes())?;
        traffic.lock().unwrap_or_else(PoisonError::into_inner).requests += 1;
        for piece in body.chunks(PIECE) {
            wait_until(sent(traffic, piece.len(), line));
            reader.get_mut().write_all(piece)?;
        }
    }
}

/// When so many bytes are over, after those before them.
fn sent(traffic: &Mutex<Traffic>, bytes: usize, line: Line) -> Instant {
    let mut traffic = traffic.lock().unwrap_or_else(PoisonError::into_inner);
    traffic.bytes += bytes as u64;
    traffic.free =
        traffic.free.max(Instant::now()) + Duration::from_secs_f64(bytes as f64 / line.bytes_per_sec);
    traffic.free
}

/// Waits; a thread that is woken too early waits on.
fn wait_until(time: Instant) {
    while let Some(left) = time.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
        std::thread::park_timeout(left);
    }
}

/// Path and range of the next request; `None` at the end of a connection.
fn request(reader: &mut BufReader<TcpStream>) -> Result<Option<(String, Option<std::ops::Range<usize>>)>> {
    let mut first = String::new();
    if reader.read_line(&mut first)? == 0 {
        return Ok(None);
    }
    let path = first.split(' ').nth(1).context("a request has a path")?.to_owned();
    let mut range = None;
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let line = line.trim().to_ascii_lowercase();
        if line.is_empty() {
            return Ok(Some((path, range)));
        }
        if let Some((first, last)) =
            line.strip_prefix("range: bytes=").and_then(|range| range.split_once('-'))
        {
            range = Some(first.parse()?..last.parse::<usize>()? + 1);
        }
    }
}

fn file_of(folder: &Path, path: &str) -> PathBuf {
    match path.strip_prefix("/v1/chunks/") {
        Some(digest) => folder.join(CHUNKS_FOLDER).join(digest.replace('/', "")),
        None => folder.join(MANIFEST_FILE),
    }
}
