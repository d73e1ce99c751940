//! Whose task a worker gets: shares of bakes, abilities, locality, blocked workers, limits of attempts.

use lightkiln_proto::api::{Bake, BakeState, Blame, BlockedWorker, CommitVerdict, Needs, Verdict};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::store::{BACKOFF_MAX_MS, FailVerdict, MAX_ATTEMPTS, MAX_GRACES};

use crate::support::{TTL_MS, World, chunk, request, submission, task};

fn tasks(bake: &str, count: usize) -> Vec<TaskSpec> {
    (0..count).map(|number| task(&format!("{bake} {number}"), &[])).collect()
}

/// Names of the bakes whose tasks a worker is given, in order.
async fn claim_bakes(world: &World, worker: &str, max: u32) -> Vec<String> {
    let labels = world.claim_labels(worker, max).await;
    labels.iter().map(|label| label.split(' ').next().unwrap().to_owned()).collect()
}

async fn submit_needing(world: &World, name: &str, needs: Needs) -> Bake {
    let mut submission = submission(name, &tasks(name, 2));
    submission.bake.needs = needs;
    world.store.submit(&submission).await.unwrap().bake
}

pub async fn bakes_of_one_priority_share_the_workers(world: World) {
    world.submit("big", &tasks("big", 50)).await;
    let small = world.submit("small", &tasks("small", 3)).await;
    world.submit_at("urgent", 1, &tasks("urgent", 1)).await;
    let mut order = Vec::new();
    for worker in 0..8 {
        order.extend(claim_bakes(&world, &format!("w{worker}"), 1).await);
    }
    assert_eq!(order, ["urgent", "big", "small", "big", "small", "big", "small", "big"]);
    // One claim for many shares alike.
    let other = world.submit("other", &tasks("other", 3)).await;
    assert_eq!(claim_bakes(&world, "w8", 4).await, ["other", "other", "other", "big"]);
    // A paused bake has no share, and its tasks are back with it.
    world.store.pause(&other.id).await.unwrap();
    world.store.cancel(&small.id).await.unwrap();
    assert_eq!(claim_bakes(&world, "w9", 2).await, ["big", "big"]);
}

pub async fn worker_keeps_to_the_scene_that_it_has(world: World) {
    let scene = Digest::of(b"another scene");
    world.store.keep_chunk(chunk(scene, 1), None, None).await.unwrap();
    world.submit("first", &tasks("first", 9)).await;
    let mut second = submission("second", &tasks("second", 9));
    second.bake.scene = scene;
    world.store.submit(&second).await.unwrap();
    assert_eq!(claim_bakes(&world, "w", 1).await, ["first"]);
    assert_eq!(claim_bakes(&world, "v", 1).await, ["second"]);
    // Each has its scene, and goes on with it while the shares are not too uneven.
    assert_eq!(claim_bakes(&world, "w", 1).await, ["first"]);
    assert_eq!(claim_bakes(&world, "v", 1).await, ["second"]);
    assert_eq!(claim_bakes(&world, "w", 1).await, ["first"]);
    assert_eq!(claim_bakes(&world, "w", 1).await, ["first"]);
    assert_eq!(claim_bakes(&world, "w", 1).await, ["first"]);
    assert_eq!(claim_bakes(&world, "w", 1).await, ["second"], "it is three ahead");
}

pub async fn bakes_wait_for_workers_that_have_what_they_need(world: World) {
    let labels = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let needs = [
        Needs { memory_mib: 4096, ..Needs::default() },
        Needs { threads: 8, ..Needs::default() },
        Needs { labels: labels(&["gpu", "quiet"]), ..Needs::default() },
    ];
    for (name, needs) in ["memory", "threads", "labels"].iter().zip(needs.clone()) {
        assert_eq!(submit_needing(&world, name, needs.clone()).await.needs, needs);
    }
    let plain = request("plain", 9);
    assert!(world.store.claim(&plain).await.unwrap().is_empty());
    let mut able = [request("big", 9), request("wide", 9), request("labelled", 9)];
    able[0].memory_mib = 4096;
    able[1].threads = 8;
    able[2].labels = labels(&["gpu"]);
    let mut given = Vec::new();
    for request in &able {
        let leases = world.store.claim(request).await.unwrap();
        given.extend(leases.into_iter().map(|lease| lease.task.label[..3].to_owned()));
    }
    given.sort();
    assert_eq!(given, ["mem", "mem", "thr", "thr"], "one label of two is not enough");
    able[2].labels = labels(&["quiet", "other", "gpu"]);
    assert_eq!(world.store.claim(&able[2]).await.unwrap().len(), 2);
    let shown = world.store.workers().await.unwrap();
    let labelled = shown.iter().find(|worker| worker.name == "labelled").unwrap();
    assert_eq!((labelled.labels.len(), labelled.memory_mib), (3, 0));
}

/// A worker is not spared a task for one that could never take it.
pub async fn task_is_not_left_to_a_worker_that_cannot_do_it(world: World) {
    let bake = submit_needing(&world, "bake", Needs { threads: 8, ..Needs::default() }).await;
    let mut able = request("able", 1);
    able.threads = 8;
    world.claim("weak", 1).await;
    for _ in 0..2 {
        let lease = world.store.claim(&able).await.unwrap().remove(0);
        let failed = world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
        assert_eq!(failed, FailVerdict::Retry);
        world.clock.advance_ms(10_000);
        world.claim("weak", 1).await;
    }
    assert_eq!(world.store.claim(&able).await.unwrap().len(), 1);
    assert_eq!(world.state(&bake).await, BakeState::Running);
}

pub async fn worker_that_fails_again_and_again_is_blocked_until_it_is_cleared(world: World) {
    let bake = world.submit("bake", &tasks("bake", 20)).await;
    world.submit("other", &tasks("other", 20)).await;
    assert_eq!(world.store.blocklist(&bake.id).await.unwrap().workers, []);
    let mut failed = 0;
    while failed < 3 {
        for lease in world.claim("bad", 2).await {
            if lease.bake == bake.id && failed < 3 {
                world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
                failed += 1;
            }
        }
    }
    let entry = |tasks, is_blocked| BlockedWorker { worker: "bad".into(), tasks, is_blocked };
    assert_eq!(world.store.blocklist(&bake.id).await.unwrap().workers, [entry(3, true)]);
    assert!(claim_bakes(&world, "bad", 4).await.contains(&"bake".to_owned()), "nobody else is there");
    world.claim("good", 0).await;
    let given = claim_bakes(&world, "bad", 4).await;
    assert!(given.len() == 4 && given.iter().all(|bake| bake == "other"), "{given:?}");
    assert!(claim_bakes(&world, "good", 4).await.contains(&"bake".to_owned()));
    let left = world.store.clear_blocklist(&bake.id, Some("good")).await.unwrap();
    assert_eq!(left.workers, [entry(3, true)]);
    let left = world.store.clear_blocklist(&bake.id, Some("bad")).await.unwrap();
    assert_eq!(left.workers, []);
    assert!(claim_bakes(&world, "bad", 4).await.contains(&"bake".to_owned()));
    assert!(world.store.blocklist("none").await.is_err());
}

/// A worker that is alive but stuck: it is heard from all the time.
pub async fn attempt_that_takes_too_long_is_ended_although_its_worker_is_heard(world: World) {
    let mut limited = submission("bake", &[task("a", &[])]);
    limited.bake.attempt_limit_secs = Some(100);
    let bake = world.store.submit(&limited).await.unwrap().bake;
    let lease = world.claim_one("stuck").await;
    for _ in 0..9 {
        world.clock.advance_ms(10_000);
        assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
        assert_eq!(world.store.reap().await.unwrap().expired, 0);
    }
    // Not even a restart of the server gives it more.
    world.store.extend_leases().await.unwrap();
    world.clock.advance_ms(10_000);
    assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Lost);
    assert_eq!(world.store.reap().await.unwrap().expired, 1);
    assert_eq!(world.commit(&lease).await, CommitVerdict::Stale);
    let list = world.store.blocklist(&bake.id).await.unwrap();
    assert_eq!((list.workers[0].worker.as_str(), list.workers[0].tasks), ("stuck", 1));
    world.clock.advance_ms(BACKOFF_MAX_MS);
    world.begin_one("stuck").await;
    world.clock.advance_ms(100_000);
    world.store.reap().await.unwrap();
    let bake = world.show(&bake).await;
    assert_eq!((bake.attempts_failed, bake.attempts_lost), (1, 1), "the second lease ended before the limit");
}

pub async fn bake_that_always_takes_too_long_says_so(world: World) {
    let mut limited = submission("bake", &[task("a", &[])]);
    limited.bake.attempt_limit_secs = Some(5);
    let bake = world.store.submit(&limited).await.unwrap().bake;
    for _ in 0..MAX_ATTEMPTS {
        world.begin_one("slow").await;
        world.clock.advance_ms(5_000);
        assert_eq!(world.store.reap().await.unwrap().expired, 1);
        world.clock.advance_ms(BACKOFF_MAX_MS);
    }
    let failure = world.show(&bake).await.failure.unwrap();
    assert!(failure.contains("took longer than one attempt may take"), "{failure}");
}

pub async fn leases_run_on_after_the_farm_could_not_hear_anybody(world: World) {
    world.submit("bake", &tasks("bake", 2)).await;
    let leases = world.claim("w", 2).await;
    world.clock.advance_ms(TTL_MS * 20);
    // The server starts again: before it looks for leases that ran out, it gives their holders time to be heard.
    assert_eq!(world.store.extend_leases().await.unwrap(), 2);
    assert_eq!(world.store.extend_leases().await.unwrap(), 0);
    assert_eq!(world.store.reap().await.unwrap().expired, 0);
    assert_eq!(world.store.heartbeat(&leases[0].token, 0.5).await.unwrap().verdict, Verdict::Keep);
    world.clock.advance_ms(TTL_MS - 1);
    assert_eq!(world.commit(&leases[1]).await, CommitVerdict::Committed);
    assert_eq!(world.commit(&leases[0]).await, CommitVerdict::Committed);
}

/// A server that starts again and again, faster than leases run out, keeps no dead worker's task for ever.
pub async fn lease_is_extended_so_often_until_its_worker_is_heard_again(world: World) {
    world.submit("bake", &[task("a", &[])]).await;
    let lease = world.begin_one("w").await;
    for _ in 0..3 {
        for _ in 0..MAX_GRACES {
            world.clock.advance_ms(TTL_MS / 2);
            assert_eq!(world.store.extend_leases().await.unwrap(), 1);
        }
        assert_eq!(world.store.heartbeat(&lease.token, 0.5).await.unwrap().verdict, Verdict::Keep);
    }
    for _ in 0..MAX_GRACES {
        world.clock.advance_ms(TTL_MS / 2);
        world.store.extend_leases().await.unwrap();
    }
    world.clock.advance_ms(TTL_MS / 2);
    assert_eq!(world.store.extend_leases().await.unwrap(), 0);
    assert_eq!(world.store.reap().await.unwrap().expired, 0);
    world.clock.advance_ms(TTL_MS / 2);
    assert_eq!(world.store.extend_leases().await.unwrap(), 0);
    assert_eq!(world.store.reap().await.unwrap().expired, 1);
    world.clock.advance_ms(BACKOFF_MAX_MS);
    assert_eq!(world.begin_one("other").await.task.key, lease.task.key);
}

pub async fn hundred_bakes_are_all_served(world: World) {
    for number in 0..100 {
        world.submit_at(&format!("{number}"), number % 3, &tasks(&format!("bake{number}"), 1)).await;
    }
    let mut given: Vec<String> = Vec::new();
    while let Some(label) = world.claim_labels("w", 1).await.pop() {
        given.push(label);
    }
    assert_eq!(given.len(), 100);
    assert_eq!((given[0].as_str(), given[99].as_str()), ("bake2 0", "bake99 0"));
}
