//! How much sooner a bake is done with two workers of one thread each than with one.

use std::path::Path;
use std::time::{Duration, Instant};

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::BakeState;

use crate::farm::{Server, kiln, worker};
use crate::report::row;

/// Pairs of bakes, in turns, so that both meet the same load of others.
const PAIRS: usize = 3;
/// A bake of about four seconds on one thread.
const SETTINGS: [&str; 6] =
    ["--preset", "draft", "--set", "receivers_target=40000", "--set", "transport_rays=512"];
/// Longest that a bake may take.
const LIMIT: Duration = Duration::from_secs(900);

/// Measures pairs of bakes.
pub fn measure() {
    let (mut whole, mut spread) = (Vec::new(), Vec::new());
    for _ in 0..PAIRS {
        let [one, two] = [1, 2].map(baked);
        whole.push(one.0.as_secs_f64() / two.0.as_secs_f64() / 2.0);
        spread.push(one.1.as_secs_f64() / two.1.as_secs_f64() / 2.0);
        eprintln!(
            "one worker {:.1?} (costliest stage {:.1?}), two {:.1?} ({:.1?})",
            one.0, one.1, two.0, two.1
        );
    }
    for (what, shares) in [("the whole bake", &mut whole), ("its costliest stage", &mut spread)] {
        shares.sort_by(f64::total_cmp);
        let percent: Vec<String> = shares.iter().map(|share| format!("{:.0} %", 100.0 * share)).collect();
        let what = format!("efficiency of 2 workers against 1, {what}");
        row(&what, "u_corridor, one thread a worker", &percent.join(", "));
    }
}

/// How long a bake took with so many workers, from submission to end, and its costliest stage from first claim to last
/// commit.
fn baked(workers: usize) -> (Duration, Duration) {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"), None);
    let _workers: Vec<_> =
        (0..workers).map(|index| worker(folder.path(), &server.url, &format!("worker-{index}"))).collect();
    let client = ApiClient::new(&server.url, None).unwrap();
    let deadline = Instant::now() + LIMIT;
    while client.workers().unwrap().workers.len() < workers {
        assert!(Instant::now() < deadline, "a worker was not heard of");
    }
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/u_corridor.glb");
    let started = Instant::now();
    let submit =
        kiln(folder.path()).arg("submit").arg(scene).args(SETTINGS).args(["--server", &server.url]).output();
    let bake = String::from_utf8(submit.unwrap().stdout).unwrap().trim().to_owned();
    let mut seen = 0;
    loop {
        // Waits for news, so that the end is not met late and the server is not kept busy by questions.
        let page = client.events(&bake, seen, 10).unwrap();
        seen = page.events.last().map_or(seen, |event| event.seq);
        let shown = page.bake;
        if shown.state.is_final() {
            assert_eq!(shown.state, BakeState::Done, "{:?}", shown.failure);
            let costliest = shown.stages.iter().max_by_key(|stage| stage.cost_total).unwrap();
            assert!(costliest.total > 8, "too few tasks to share: {costliest:?}");
            return (started.elapsed(), Duration::from_millis(costliest.elapsed_ms));
        }
        assert!(Instant::now() < deadline, "the bake did not end");
    }
}
