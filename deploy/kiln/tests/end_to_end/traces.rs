//! One trace from the submission of a bake to its chunks, over three processes, as a collector receives it.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex};

use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use prost::Message as _;

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};

/// A span as it was exported.
#[derive(Clone, Debug)]
struct Exported {
    service: String,
    name: String,
    trace: Vec<u8>,
    id: Vec<u8>,
    parent: Vec<u8>,
}

/// Takes in what is exported to it, over OTLP/HTTP in protobuf.
struct Collector {
    url: String,
    spans: Arc<Mutex<Vec<Exported>>>,
}

impl Collector {
    fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let spans = Arc::new(Mutex::new(Vec::new()));
        let kept = spans.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().map_while(Result::ok) {
                let kept = kept.clone();
                std::thread::spawn(move || serve(stream, &kept));
            }
        });
        Self { url, spans }
    }

    /// A command whose traces come here.
    fn traced(&self, state: &Path) -> Command {
        let mut command = kiln(state);
        command.env("OTEL_EXPORTER_OTLP_ENDPOINT", &self.url).env_remove("OTEL_SERVICE_NAME");
        command
    }
}

/// Answers every export on a connection.
fn serve(stream: TcpStream, spans: &Mutex<Vec<Exported>>) {
    let mut answers = stream.try_clone().unwrap();
    let mut requests = BufReader::new(stream);
    loop {
        let (mut line, mut length) = (String::new(), 0);
        if requests.read_line(&mut line).unwrap_or(0) == 0 {
            return;
        }
        assert_eq!(line.trim_end(), "POST /v1/traces HTTP/1.1");
        while !line.trim_end().is_empty() {
            line.clear();
            requests.read_line(&mut line).unwrap();
            if let Some((name, value)) = line.split_once(':')
                && name.eq_ignore_ascii_case("content-length")
            {
                length = value.trim().parse().unwrap();
            }
        }
        let mut body = vec![0; length];
        requests.read_exact(&mut body).unwrap();
        spans.lock().unwrap().extend(exported(&body));
        answers
            .write_all(
                b"HTTP/1.1 200 OK\r\nContent-Type: application/x-protobuf\r\nContent-Length: 0\r\n\r\n",
            )
            .unwrap();
    }
}

fn exported(body: &[u8]) -> Vec<Exported> {
    let request = ExportTraceServiceRequest::decode(body).unwrap();
    let mut spans = Vec::new();
    for group in request.resource_spans {
        let attributes = group.resource.unwrap().attributes;
        let service = attributes.into_iter().find(|attribute| attribute.key == "service.name").unwrap();
        let Some(Value::StringValue(service)) = service.value.unwrap().value else {
            panic!("no service.name")
        };
        for span in group.scope_spans.into_iter().flat_map(|scope| scope.spans) {
            let (name, trace, id, parent) = (span.name, span.trace_id, span.span_id, span.parent_span_id);
            spans.push(Exported { service: service.clone(), name, trace, id, parent });
        }
    }
    spans
}

/// Services and names from a span up to the root of its trace.
fn ancestry(spans: &BTreeMap<Vec<u8>, Exported>, from: &Exported) -> Vec<String> {
    let mut line = vec![format!("{} {}", from.service, from.name)];
    let mut span = from;
    while !span.parent.is_empty() {
        span = spans.get(&span.parent).unwrap_or_else(|| panic!("the parent of {span:?} was not exported"));
        line.push(format!("{} {}", span.service, span.name));
    }
    line
}

#[test]
fn one_trace_leads_from_the_submission_to_the_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let collector = Collector::start();
    let server = Server::start_with(collector.traced(&folder.path().join("server")), &[]);
    let mut command = collector.traced(&folder.path().join("worker"));
    command.args(["worker", "--server", &server.url, "--name", "oven", "--threads", "2"]);
    let worker = Running::start(command);
    let wait = ["--server", &server.url, "--wait", "--json"];
    let ended = run(collector.traced(folder.path()), &arguments("submit", &wait), 0).json();
    // Spans that are not exported yet are when a process ends.
    worker.signal("TERM");
    assert_eq!(worker.wait(), Some(0));
    assert_eq!(server.stop(), Some(0));
    let spans = std::mem::take(&mut *collector.spans.lock().unwrap());
    let root = spans.iter().find(|span| span.name == "kiln submit").expect("the command's span");
    assert_eq!((root.service.as_str(), root.parent.len()), ("kiln-submit", 0));
    assert!(spans.iter().all(|span| span.trace == root.trace), "one trace: {spans:#?}");
    let by_id: BTreeMap<Vec<u8>, Exported> =
        spans.iter().map(|span| (span.id.clone(), span.clone())).collect();
    let lines: Vec<Vec<String>> = spans.iter().map(|span| ancestry(&by_id, span)).collect();
    let submitted = ["kiln-server POST /v1/bakes", "kiln-submit submit", "kiln-submit kiln submit"];
    let of_task = |kind: &str, steps: &[&str]| -> Vec<String> {
        let task = format!("kiln-worker task {kind}");
        [steps, &[task.as_str()], &submitted].concat().iter().map(|step| (*step).to_owned()).collect()
    };
    for wanted in [
        of_task("prt.transport", &["kiln-worker run"]),
        // Later tasks find what they read in the worker's cache.
        of_task(
            "scene.import",
            &["kiln-server GET /v1/chunks/{digest}", "kiln-worker fetch", "kiln-worker run"],
        ),
        of_task("prt.transport", &["kiln-server PUT /v1/chunks/{digest}", "kiln-worker upload"]),
        of_task("scene.import", &["kiln-server POST /v1/leases/{token}/commit", "kiln-worker commit"]),
    ] {
        assert!(lines.contains(&wanted), "{wanted:?} is not among {lines:#?}");
    }
    // Tasks that end together are handed in together, by the call of one of them.
    let handed_in = ["/v1/leases/{token}/commit", "/v1/leases/commit"]
        .map(|path| of_task("prt.transport", &[&format!("kiln-server POST {path}"), "kiln-worker commit"]));
    assert!(
        handed_in.iter().any(|wanted| lines.contains(wanted)),
        "none of {handed_in:?} is among {lines:#?}"
    );
    let count = |begins: &dyn Fn(&[String]) -> bool| lines.iter().filter(|line| begins(line)).count() as u64;
    let tasks = ended["tasks_run"].as_u64().unwrap();
    assert_eq!(count(&|line| line[0].starts_with("kiln-worker task ")), tasks);
    let is_of_task =
        |line: &[String]| line[0] == "kiln-worker commit" && line[1].starts_with("kiln-worker task ");
    assert_eq!(count(&is_of_task), tasks, "{lines:#?}");
}
