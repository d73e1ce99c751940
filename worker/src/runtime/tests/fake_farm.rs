//! A server small enough to misbehave on command: speaks just enough HTTP/1.1 for one worker.

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use lightkiln_proto::api::{
    ClaimAnswer, ClaimRequest, CommitAnswer, CommitOutcome, CommitVerdict, Commits, CommitsAnswer, Failure,
    HeartbeatAnswer, Lease, TaskResult, Verdict,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_proto::problem::{Problem, ProblemCode};

/// Longest that a test waits for something to happen.
pub const LIMIT: Duration = Duration::from_secs(60);

/// Contents of the farm, and the calls that it has heard.
#[derive(Default)]
pub struct State {
    /// Leases to hand out.
    pub leases: VecDeque<Lease>,
    /// Stored artefacts.
    pub chunks: BTreeMap<Digest, Vec<u8>>,
    /// Answer to heartbeats; `Keep` unless set.
    pub verdict: Option<Verdict>,
    /// `METHOD path` of each call in order, digests cut short.
    pub calls: Vec<String>,
    /// Results handed in, by token.
    pub committed: BTreeMap<String, TaskResult>,
    /// Failures reported.
    pub failures: Vec<Failure>,
    /// Tokens of leases given back.
    pub released: Vec<String>,
    /// Calls whose text begins so are done, but the connection closes before the answer; each once.
    pub lose_answers: Vec<&'static str>,
    /// Calls whose text begins so are answered with 503 and not done; each once.
    pub refuse: Vec<&'static str>,
    /// The next call whose text begins so is done only when it is let go.
    pub hang: Option<&'static str>,
    /// Calls that hang may go on.
    pub is_let_go: bool,
    /// So often, the farm has forgotten stored bytes when a result comes.
    pub forgetful: u32,
    /// Artefacts are refused as too large.
    pub is_narrow: bool,
    /// Claims are refused for good.
    pub is_closed: bool,
    /// The next artefact fetched arrives with a bit flipped.
    pub damage_next: bool,
}

/// A farm on a port of its own.
#[derive(Clone)]
pub struct FakeFarm(Arc<Inner>);

struct Inner {
    url: String,
    state: Mutex<State>,
    changed: Condvar,
}

impl FakeFarm {
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let farm = Self(Arc::new(Inner { url, state: Mutex::default(), changed: Condvar::new() }));
        let accepting = farm.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let farm = accepting.clone();
                std::thread::spawn(move || farm.serve(stream));
            }
        });
        farm
    }

    pub fn url(&self) -> &str {
        &self.0.url
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap()
    }

    /// Queues a task that reads `inputs` (stored here) and is known by `token`.
    pub fn offer(&self, token: &str, inputs: &[&[u8]]) {
        let mut state = self.state();
        let artefacts = inputs.iter().enumerate().map(|(index, bytes)| {
            let digest = Digest::of(bytes);
            state.chunks.insert(digest, bytes.to_vec());
            Artefact { name: format!("input{index}"), digest, bytes: bytes.len() as u64 }
        });
        let inputs = artefacts.collect();
        let task = TaskSpec::new("test", 1, token, serde_json::json!(token), Vec::new(), 1);
        state.leases.push_back(Lease {
            token: token.into(),
            bake: "bake".into(),
            task,
            inputs,
            alike: Vec::new(),
            expires_ms: 0,
            traceparent: None,
        });
        self.0.changed.notify_all();
    }

    /// Waits until `done` holds.
    pub fn wait_for(&self, what: &str, done: impl Fn(&State) -> bool) {
        let (state, waited) =
            self.0.changed.wait_timeout_while(self.state(), LIMIT, |state| !done(state)).unwrap();
        assert!(!waited.timed_out(), "no {what} within {LIMIT:?}; calls: {:?}", state.calls);
    }

    /// Lets a call that hangs go on.
    pub fn let_go(&self) {
        self.state().is_let_go = true;
        self.0.changed.notify_all();
    }

    /// Waits, if this call is to hang.
    fn hang(&self, call: &str) {
        let mut state = self.state();
        if state.hang.take_if(|start| call.starts_with(*start)).is_some() {
            state.calls.push(call.to_owned());
            self.0.changed.notify_all();
            drop(self.0.changed.wait_while(state, |state| !state.is_let_go).unwrap());
        }
    }

    fn serve(&self, stream: TcpStream) {
        let mut reader = BufReader::new(stream.try_clone().unwrap());
        let mut writer = stream;
        while let Some((method, path, body)) = read_request(&mut reader) {
            self.hang(&format!("{method} {path}"));
            let answer = self.answer(&method, &path, &body);
            self.0.changed.notify_all();
            let Some((status, body)) = answer else { return };
            let head = format!("HTTP/1.1 {status} x\r\ncontent-length: {}\r\n\r\n", body.len());
            let body = if method == "HEAD" { Vec::new() } else { body };
            if writer.write_all(head.as_bytes()).and_then(|()| writer.write_all(&body)).is_err() {
                return;
            }
        }
    }

    /// `None` closes the connection instead.
    fn answer(&self, method: &str, path: &str, body: &[u8]) -> Option<(u16, Vec<u8>)> {
        let mut state = self.state();
        let call = format!("{method} {}", path.get(..24).filter(|_| path.contains("chunks")).unwrap_or(path));
        state.calls.push(call.clone());
        if let Some(index) = state.refuse.iter().position(|start| call.starts_with(start)) {
            state.refuse.remove(index);
            let problem = Problem::new(ProblemCode::Unavailable, "on purpose");
            return Some((503, serde_json::to_vec(&problem).unwrap()));
        }
        let parts: Vec<&str> = path.trim_start_matches("/v1/").split('/').collect();
        let answer = match (method, parts.as_slice()) {
            ("POST", ["leases"]) if state.is_closed => {
                (403, json(&Problem::new(ProblemCode::Forbidden, "closed, on purpose")))
            }
            ("POST", ["leases"]) => {
                // Answers at once with nothing: a worker must bear that, and no test then waits for a poll to end.
                let request: ClaimRequest = serde_json::from_slice(body).unwrap();
                let count = state.leases.len().min(request.max as usize);
                (200, json(&ClaimAnswer { leases: state.leases.drain(..count).collect() }))
            }
            ("POST", ["leases", "commit"]) => {
                let commits: Commits = serde_json::from_slice(body).unwrap();
                let answers = commits.commits.into_iter().map(|commit| {
                    match lease_call(&mut state, &commit.token, "commit", &json(&commit.result)) {
                        (200, answer) => {
                            let answer: CommitAnswer = serde_json::from_slice(&answer).unwrap();
                            CommitOutcome::Verdict(answer.verdict)
                        }
                        (_, problem) => CommitOutcome::Problem(serde_json::from_slice(&problem).unwrap()),
                    }
                });
                (200, json(&CommitsAnswer { answers: answers.collect() }))
            }
            ("POST", ["leases", token, verb]) => lease_call(&mut state, token, verb, body),
            (_, ["chunks", digest]) => chunk_call(&mut state, method, digest.parse().unwrap(), body),
            _ => (404, Vec::new()),
        };
        if let Some(index) = state.lose_answers.iter().position(|start| call.starts_with(start)) {
            state.lose_answers.remove(index);
            return None;
        }
        Some(answer)
    }
}

fn lease_call(state: &mut State, token: &str, verb: &str, body: &[u8]) -> (u16, Vec<u8>) {
    match verb {
        "heartbeat" => {
            let verdict = state.verdict.unwrap_or(Verdict::Keep);
            (200, json(&HeartbeatAnswer { verdict, expires_ms: 0 }))
        }
        "commit" => {
            let result: TaskResult = serde_json::from_slice(body).unwrap();
            if state.forgetful > 0 {
                state.forgetful -= 1;
                state.chunks.clear();
                let problem = Problem::new(ProblemCode::NotStored, "forgotten, on purpose");
                return (409, json(&problem));
            }
            let missing = result.outputs.iter().any(|output| !state.chunks.contains_key(&output.digest));
            assert!(!missing, "a result was handed in before its outputs were stored");
            let verdict = match state.committed.insert(token.to_owned(), result) {
                None => CommitVerdict::Committed,
                Some(_) => CommitVerdict::AlreadyCommitted,
            };
            (200, json(&CommitAnswer { verdict }))
        }
        "fail" => {
            state.failures.push(serde_json::from_slice(body).unwrap());
            (204, Vec::new())
        }
        "release" => {
            state.released.push(token.to_owned());
            (204, Vec::new())
        }
        _ => (404, Vec::new()),
    }
}

fn chunk_call(state: &mut State, method: &str, digest: Digest, body: &[u8]) -> (u16, Vec<u8>) {
    if method == "PUT" && state.is_narrow {
        return (413, json(&Problem::new(ProblemCode::TooLarge, "too large, on purpose")));
    }
    if method == "PUT" {
        state.chunks.insert(digest, body.to_vec());
        return (201, Vec::new());
    }
    let mut bytes = match state.chunks.get(&digest) {
        Some(bytes) => bytes.clone(),
        None => return (404, Vec::new()),
    };
    if method == "GET" && std::mem::take(&mut state.damage_next) {
        bytes[0] ^= 1;
    }
    (200, bytes)
}

fn json(answer: &impl serde::Serialize) -> Vec<u8> {
    serde_json::to_vec(answer).unwrap()
}

fn read_request(reader: &mut BufReader<TcpStream>) -> Option<(String, String, Vec<u8>)> {
    let mut line = String::new();
    reader.read_line(&mut line).ok().filter(|length| *length > 0)?;
    let mut words = line.split(' ');
    let (method, path) = (words.next()?.to_owned(), words.next()?.to_owned());
    let mut length = 0;
    loop {
        let mut header = String::new();
        reader.read_line(&mut header).ok()?;
        let header = header.trim().to_ascii_lowercase();
        if header.is_empty() {
            break;
        }
        if let Some(value) = header.strip_prefix("content-length:") {
            length = value.trim().parse().ok()?;
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    Some((method, path, body))
}
