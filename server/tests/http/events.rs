//! Events: polled and streamed.

use lightkiln_proto::api::{BakeEvent, BakeState, EventKind, EventPage};
use lightkiln_proto::problem::ProblemCode;
use tokio::io::BufReader;
use tokio::net::TcpStream;

use crate::bakes::{run, submit};
use crate::support::{Running, read_head, read_piece, start};

async fn open_stream(server: &Running, bake: &str, headers: &[(&str, &str)]) -> BufReader<TcpStream> {
    let mut all = vec![("Accept", "text/event-stream")];
    all.extend(headers);
    let mut stream = server.open("GET", &format!("/v1/bakes/{bake}/events"), &all, b"").await;
    let (status, headers) = read_head(&mut stream).await;
    assert_eq!(status, 200);
    assert!(headers.contains(&("content-type".into(), "text/event-stream".into())), "{headers:?}");
    stream
}

/// Reads a stream to its end: the events, whose `id` must be their `seq`.
async fn read_events(stream: &mut BufReader<TcpStream>) -> Vec<BakeEvent> {
    let mut text = String::new();
    while let Some(piece) = read_piece(stream).await {
        text += std::str::from_utf8(&piece).unwrap();
    }
    let mut events = Vec::new();
    for block in text.split("\n\n").filter(|block| block.contains("data:")) {
        let field = |name: &str| {
            let line = block.lines().find(|line| line.starts_with(name)).unwrap();
            line[name.len()..].trim_start_matches(": ").to_owned()
        };
        let event: BakeEvent = serde_json::from_str(&field("data")).unwrap();
        assert_eq!(field("id"), event.seq.to_string());
        events.push(event);
    }
    events
}

#[tokio::test]
async fn stream_follows_a_bake_to_its_end() {
    let server = start().await;
    let bake = submit(&server).await;
    let mut stream = open_stream(&server, &bake.id, &[]).await;
    let (events, ()) = futures::future::join(read_events(&mut stream), run(&server)).await;
    let seqs: Vec<u64> = events.iter().map(|event| event.seq).collect();
    assert_eq!(seqs, [1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(events[6].event, EventKind::State { state: BakeState::Done });
    let page: EventPage = server.get(&format!("/v1/bakes/{}/events", bake.id)).await.json(200);
    assert_eq!(page.events, events);
}

#[tokio::test]
async fn stream_goes_on_after_the_last_event_seen() {
    let server = start().await;
    let bake = submit(&server).await;
    run(&server).await;
    for (last, wanted) in [("5", &[6_u64, 7][..]), ("7", &[]), ("99", &[])] {
        let mut stream = open_stream(&server, &bake.id, &[("Last-Event-ID", last)]).await;
        let seqs: Vec<u64> = read_events(&mut stream).await.iter().map(|event| event.seq).collect();
        assert_eq!(seqs, wanted);
    }
}

#[tokio::test]
async fn stream_ends_when_the_server_stops() {
    let server = start().await;
    let bake = submit(&server).await;
    let mut stream = open_stream(&server, &bake.id, &[]).await;
    let (events, _) = futures::future::join(read_events(&mut stream), server.stop()).await;
    assert_eq!(events.len(), 2);
}

#[tokio::test]
async fn polling_waits_for_an_event() {
    let server = start().await;
    let bake = submit(&server).await;
    let path = format!("/v1/bakes/{}/events?after=2", bake.id);
    let page: EventPage = server.get(&path).await.json(200);
    assert!(page.events.is_empty());
    let pause = format!("/v1/bakes/{}/pause", bake.id);
    let waiting = format!("{path}&wait_secs=60");
    let (page, _) = futures::future::join(server.get(&waiting), server.call("POST", &pause, &[], b"")).await;
    let page: EventPage = page.json(200);
    assert_eq!(page.events[0].event, EventKind::State { state: BakeState::Paused });
}

#[tokio::test]
async fn events_of_an_unknown_bake_are_a_problem_not_a_stream() {
    let server = start().await;
    let accept = [("Accept", "text/event-stream")];
    server.call("GET", "/v1/bakes/none/events", &accept, b"").await.problem(ProblemCode::NotFound);
    let bake = submit(&server).await;
    let path = format!("/v1/bakes/{}/events", bake.id);
    let wrong = [("Last-Event-ID", "x")];
    server.call("GET", &path, &wrong, b"").await.problem(ProblemCode::BadRequest);
    server.get(&format!("{path}?wait_secs=61")).await.problem(ProblemCode::BadRequest);
}
