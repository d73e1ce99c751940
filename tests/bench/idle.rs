//! A thousand workers that wait for work.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use crate::calls::Caller;
use crate::farm::Server;
use crate::parts::postgres::Postgres;
use crate::report::{quantiles, row};

/// Workers that wait.
const WORKERS: usize = 1_000;
/// Kind of task that they wait for.
const WAITED_FOR: &str = "bench.waited-for";
/// Longest that a claim may wait, in seconds.
const WAIT_SECS: u32 = 60;
/// How long they are looked at while they wait.
const LOOK: Duration = Duration::from_secs(15);
/// Tasks that a worker runs beside them.
const TASKS: u32 = 100;
/// Time between two looks at memory.
const BETWEEN_LOOKS: Duration = Duration::from_millis(200);

/// Measures both databases.
pub fn measure() {
    measure_on("SQLite", None);
    let postgres = Postgres::start_with("");
    measure_on("PostgreSQL", Some(&postgres.url(None)));
}

fn measure_on(name: &str, database: Option<&str>) {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), database);
    let address = server.url.strip_prefix("http://").unwrap();
    let before = server.process.memory();
    let mut waiting: Vec<TcpStream> = (0..WORKERS).map(|index| claim(address, index)).collect();
    let (share, memory) = look(&server, &mut waiting[0]);
    let beside = run_beside(&server, "before");
    waiting.iter_mut().for_each(|stream| assert_nothing_comes(stream, Duration::from_nanos(1)));
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let figure = format!(
        "{:.0} MiB ({:.0} MiB before, {:.0} KiB a worker), {:.1} % of one processor",
        mib(memory),
        mib(before),
        (memory - before) as f64 / WORKERS as f64 / 1024.0,
        100.0 * share
    );
    row(&format!("server with {WORKERS} idle workers"), name, &figure);
    row(&format!("claim, upload and commit beside {WORKERS} idle workers"), name, &beside);

    // One that they know, for workers with a label that none of them has.
    Caller::new(&server.url).fill_for(&["nobody"], WAITED_FOR, b"a scene for nobody", 1);
    let (share, _) = look(&server, &mut waiting[0]);
    let figure = format!("{:.1} % of one processor", 100.0 * share);
    row(&format!("server with {WORKERS} idle workers and a task that none may take"), name, &figure);
    let beside = run_beside(&server, "after");
    waiting.iter_mut().for_each(|stream| assert_nothing_comes(stream, Duration::from_nanos(1)));
    row(&format!("claim, upload and commit beside {WORKERS} idle workers and that task"), name, &beside);
}

/// Share of a processor that the server takes while they wait, and the most memory.
fn look(server: &Server, waiting: &mut TcpStream) -> (f64, u64) {
    let (cpu, started, mut memory) = (server.process.cpu(), Instant::now(), 0);
    while started.elapsed() < LOOK {
        memory = memory.max(server.process.memory());
        assert_nothing_comes(waiting, BETWEEN_LOOKS);
    }
    ((server.process.cpu() - cpu).as_secs_f64() / started.elapsed().as_secs_f64(), memory)
}

/// How long tasks of another kind take that one worker runs meanwhile; the others hear of each commit.
fn run_beside(server: &Server, round: &str) -> String {
    let caller = Caller::new(&server.url);
    let (kind, scene) = (format!("bench.{round}"), format!("a scene for {round}"));
    caller.fill_for(&[], &kind, scene.as_bytes(), TASKS as usize);
    let mut rounds: Vec<Duration> = (0..TASKS)
        .map(|index| {
            let started = Instant::now();
            let token = caller.claim("busy", &[&kind]).unwrap();
            caller.commit(&token, &index.to_le_bytes(), serde_json::json!([]));
            started.elapsed()
        })
        .collect();
    quantiles(&mut rounds)
}

/// Waits for an answer that must not come yet.
fn assert_nothing_comes(stream: &mut TcpStream, wait: Duration) {
    stream.set_read_timeout(Some(wait)).unwrap();
    let nothing = stream.read(&mut [0; 16]).expect_err("a claim was answered: nobody waited");
    assert_eq!(nothing.kind(), std::io::ErrorKind::WouldBlock, "a claim was answered: nobody waited");
}

fn claim(address: &str, index: usize) -> TcpStream {
    let claim = serde_json::json!({
        "worker": format!("worker {index}"), "kinds": [WAITED_FOR], "threads": 4, "max": 1, "ttl_secs": 60,
        "wait_secs": WAIT_SECS,
    });
    let body = claim.to_string();
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "POST /v1/leases HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(format!("{head}{body}").as_bytes()).unwrap();
    stream
}
