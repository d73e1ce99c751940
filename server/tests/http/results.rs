//! Results of a bake under way.

use std::time::Duration;

use lightkiln_proto::api::{BakeResult, BakeState, ResultPage};
use lightkiln_proto::jobs::MANIFEST_OUTPUT;
use lightkiln_proto::problem::ProblemCode;

use crate::bakes::{claim_one, commit, run, submit};
use crate::parts::kind::{FIRST, SECOND};
use crate::support::start;

fn told(results: &[BakeResult]) -> Vec<(u64, &str)> {
    results.iter().map(|result| (result.place, result.kind.as_str())).collect()
}

#[tokio::test]
async fn bake_under_way_tells_its_results_and_each_output_can_be_fetched() {
    let server = start().await;
    let bake = submit(&server).await;
    let path = format!("/v1/bakes/{}/results", bake.id);
    let page: ResultPage = server.get(&path).await.json(200);
    assert_eq!((page.results.len(), page.bake.state), (0, BakeState::Running));
    let first = claim_one(&server).await;
    commit(&server, &first, &[("scene", b"imported")]).await;
    let page: ResultPage = server.get(&path).await.json(200);
    assert_eq!((told(&page.results), page.bake.stages[0].done), (vec![(1, FIRST)], 1));
    let result = &page.results[0];
    assert_eq!((result.key, &result.label, result.outputs[0].bytes), (first.task.key, &first.task.label, 8));
    let chunk = server.get(&format!("/v1/chunks/{}", result.outputs[0].digest)).await;
    assert_eq!((chunk.status, &chunk.body[..]), (200, &b"imported"[..]));
    let second = claim_one(&server).await;
    commit(&server, &second, &[(MANIFEST_OUTPUT, b"{}")]).await;
    for (query, wanted) in [
        ("", &[(1, FIRST), (2, SECOND)][..]),
        ("?limit=1", &[(1, FIRST)]),
        ("?after=1", &[(2, SECOND)]),
        ("?kind=two.second", &[(2, SECOND)]),
        ("?kind=two.first&after=1", &[]),
        ("?kind=two.third", &[]),
        ("?after=9223372036854775807", &[]),
    ] {
        let page: ResultPage = server.get(&format!("{path}{query}")).await.json(200);
        assert_eq!((told(&page.results), page.bake.state), (wanted.to_vec(), BakeState::Done), "{query}");
    }
}

#[tokio::test]
async fn polling_waits_for_a_result_of_the_kind_asked_for() {
    let server = start().await;
    let bake = submit(&server).await;
    let waiting = format!("/v1/bakes/{}/results?kind={SECOND}&wait_secs=60", bake.id);
    let (page, ()) = futures::future::join(server.get(&waiting), run(&server)).await;
    let page: ResultPage = page.json(200);
    assert_eq!((told(&page.results), page.next_after), (vec![(2, SECOND)], 2));
    assert_eq!(page.results[0].outputs[0].name, MANIFEST_OUTPUT);
}

/// Less than the polls ask to wait for: nothing more will come of a bake that has ended.
const LIMIT: Duration = Duration::from_secs(50);

#[tokio::test]
async fn polling_ends_at_once_with_the_bake() {
    let server = start().await;
    let bake = submit(&server).await;
    let waiting = format!("/v1/bakes/{}/results?wait_secs=60", bake.id);
    let cancel = format!("/v1/bakes/{}/cancel", bake.id);
    let (page, _) = futures::future::join(server.get(&waiting), server.call("POST", &cancel, &[], b"")).await;
    let page: ResultPage = page.json(200);
    assert_eq!((page.results.len(), page.bake.state), (0, BakeState::Cancelled));
    let again =
        tokio::time::timeout(LIMIT, server.get(&waiting)).await.expect("an answer before the wait is over");
    assert_eq!(again.json::<ResultPage>(200), page);
}

#[tokio::test]
async fn results_of_an_unknown_bake_are_a_problem() {
    let server = start().await;
    server.get("/v1/bakes/none/results?wait_secs=60").await.problem(ProblemCode::NotFound);
    let kind = "x".repeat(401);
    let problem = server.get(&format!("/v1/bakes/none/results?kind={kind}")).await;
    assert!(problem.problem(ProblemCode::BadRequest).detail.contains("400 bytes"));
}
