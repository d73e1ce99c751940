//! A plain server of files on 127.0.0.1, as a bundle may lie behind one.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// A call.
pub struct Request {
    /// Path, from its first slash.
    pub path: String,
    /// Header `Range`.
    pub range: Option<String>,
}

/// An answer.
pub struct Answer {
    /// Status.
    pub status: u16,
    /// Content type.
    pub media_type: &'static str,
    /// Body.
    pub bytes: Vec<u8>,
}

impl Answer {
    /// Bytes that are there.
    pub fn of(bytes: Vec<u8>) -> Self {
        Self { status: 200, media_type: "application/octet-stream", bytes }
    }

    /// An answer without a body.
    pub fn empty(status: u16) -> Self {
        Self { status, media_type: "text/plain", bytes: Vec::new() }
    }
}

type Answers = dyn Fn(&Request) -> Option<Answer> + Send + Sync;

/// The server; its threads end with the process.
pub struct Files {
    port: u16,
    calls: Arc<Mutex<Vec<String>>>,
}

impl Files {
    /// Serves folders below their paths, and before them what `answer` gives.
    pub fn start(
        folders: Vec<(&'static str, PathBuf)>,
        answer: impl Fn(&Request) -> Option<Answer> + Send + Sync + 'static,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("an address").port();
        let (answer, folders): (Arc<Answers>, _) = (Arc::new(answer), Arc::new(folders));
        let calls: Arc<Mutex<Vec<String>>> = Arc::default();
        let seen = calls.clone();
        std::thread::spawn(move || {
            for connection in listener.incoming().map_while(Result::ok) {
                let (answer, folders, seen) = (answer.clone(), folders.clone(), seen.clone());
                // A browser that hangs up is no fault of a test.
                std::thread::spawn(move || serve(&connection, &folders, &*answer, &seen).ok());
            }
        });
        Self { port, calls }
    }

    /// URL of a path.
    pub fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.port)
    }

    /// Calls so far: the path, and behind a space the range if there is one.
    pub fn calls(&self) -> Vec<String> {
        self.calls.lock().expect("no thread panicked").clone()
    }
}

fn serve(
    connection: &TcpStream,
    folders: &[(&'static str, PathBuf)],
    answer: &Answers,
    calls: &Mutex<Vec<String>>,
) -> std::io::Result<()> {
    let mut lines = BufReader::new(connection).lines();
    let first = lines.next().transpose()?.unwrap_or_default();
    let path = first.split(' ').nth(1).unwrap_or("/").to_owned();
    let mut request = Request { path, range: None };
    for line in lines {
        let line = line?;
        match line.split_once(": ") {
            Some((name, value)) if name.eq_ignore_ascii_case("range") => {
                request.range = Some(value.to_owned())
            }
            Some(_) => (),
            None => break,
        }
    }
    let range = request.range.as_ref().map(|range| format!(" {range}")).unwrap_or_default();
    calls.lock().expect("no thread panicked").push(format!("{}{range}", request.path));
    let Answer { status, media_type, bytes } =
        answer(&request).unwrap_or_else(|| file(&request.path, folders));
    let mut connection = connection;
    write!(
        connection,
        "HTTP/1.1 {status} -\r\ncontent-type: {media_type}\r\ncontent-length: {}\r\nconnection: close\r\n\r\n",
        bytes.len()
    )?;
    connection.write_all(&bytes)
}

fn file(path: &str, folders: &[(&'static str, PathBuf)]) -> Answer {
    // The query is the page's own.
    let path = path.split_once('?').map_or(path, |(path, _)| path);
    let below = folders.iter().find_map(|(prefix, folder)| Some((folder, path.strip_prefix(prefix)?)));
    let Some((folder, rest)) = below.filter(|(_, rest)| !rest.contains("..")) else {
        return Answer::empty(404);
    };
    let media_type = match rest.rsplit('.').next() {
        Some("js") => "text/javascript",
        Some("html") => "text/html",
        Some("css") => "text/css",
        _ => "application/octet-stream",
    };
    match std::fs::read(folder.join(rest)) {
        Ok(bytes) => Answer { status: 200, media_type, bytes },
        Err(_) => Answer::empty(404),
    }
}
