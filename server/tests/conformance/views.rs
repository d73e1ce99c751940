//! Views for callers: events, pages, counts, workers.

use std::slice::from_ref;

use lightkiln_proto::api::{BakeFilter, BakeState, Blame, EventKind};
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT, TaskResult};
use lightkiln_server::store::{TaskCount, TaskState};

use crate::support::{TTL_MS, World, output, request, task, task_of};

pub async fn events_have_no_gaps_and_tell_the_story(world: World) {
    let planner = task("plan", &[]);
    let bake = world.submit("bake", from_ref(&planner)).await;
    let lease = world.claim_one("w").await;
    world.clock.advance_ms(250);
    world.commit_plan(&lease, &[task("planned", &[])]).await;
    world.store.pause(&bake.id).await.unwrap();
    world.store.resume(&bake.id).await.unwrap();
    world.drain("w").await;
    let events = world.events(&bake).await;
    let seqs: Vec<u64> = events.iter().map(|event| event.seq).collect();
    assert_eq!(seqs, (1..=10).collect::<Vec<_>>());
    let kinds: Vec<_> = events.into_iter().map(|event| event.event).collect();
    assert_eq!(kinds[0], EventKind::Submitted);
    assert_eq!(kinds[1], EventKind::Planned { tasks: 1, reused: 0 });
    let (key, kind, label, worker) = (planner.key, "work".to_owned(), "plan".to_owned(), "w".to_owned());
    let started = EventKind::TaskStarted {
        key,
        kind: kind.clone(),
        label: label.clone(),
        worker: worker.clone(),
        attempt: 1,
    };
    assert_eq!(kinds[2], started);
    let note = String::new();
    assert_eq!(kinds[3], EventKind::TaskDone { key, kind, label, worker, attempt: 1, elapsed_ms: 250, note });
    assert_eq!(kinds[4], EventKind::Planned { tasks: 1, reused: 0 });
    assert_eq!(kinds[5], EventKind::State { state: BakeState::Paused });
    assert_eq!(kinds[6], EventKind::State { state: BakeState::Running });
    assert!(matches!(&kinds[7], EventKind::TaskStarted { label, .. } if label == "planned"));
    assert_eq!(kinds[9], EventKind::State { state: BakeState::Done });
}

/// Everything that can happen to an attempt, told to both bakes that want the task.
pub async fn events_tell_what_became_of_each_attempt(world: World) {
    let a = task("a", &[]);
    let bakes = [world.submit("one", from_ref(&a)).await, world.submit("two", from_ref(&a)).await];
    let end = async |name: &str, elapsed_ms| {
        // Whoever failed before leaves it to others, while there are some.
        let lease = world.claim_one(name).await;
        world.clock.advance_ms(elapsed_ms);
        lease
    };
    let lease = end("v", 10).await;
    world.store.release(&lease.token).await.unwrap();
    let lease = end("v", 20).await;
    world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
    world.clock.advance_ms(60_000);
    // A worker that never said that it has the task may not have heard of it: that counts for no attempt.
    end("w", TTL_MS).await;
    world.store.reap().await.unwrap();
    let lease = end("w", 0).await;
    world.store.heartbeat(&lease.token, 0.5).await.unwrap();
    world.clock.advance_ms(TTL_MS);
    world.store.reap().await.unwrap();
    let lease = end("w", 30).await;
    world.commit(&lease).await;
    for bake in &bakes {
        let events: Vec<EventKind> = world.events(bake).await.into_iter().map(|event| event.event).collect();
        let told = events.iter().filter_map(|event| match event {
            EventKind::TaskStarted { worker, attempt, .. } => Some(format!("started {worker} {attempt}")),
            EventKind::TaskReleased { worker, elapsed_ms, .. } => {
                Some(format!("released {worker} {elapsed_ms}"))
            }
            EventKind::TaskFailed { attempt, elapsed_ms, wait_ms, retry, .. } => {
                assert!((500..=1_000).contains(wait_ms) && *retry, "{event:?}");
                Some(format!("failed {attempt} {elapsed_ms}"))
            }
            EventKind::LeaseExpired { label, attempt, elapsed_ms, took_too_long, .. } => {
                assert_eq!((label.as_str(), took_too_long), ("a", &false));
                Some(format!("expired {attempt} {elapsed_ms}"))
            }
            EventKind::TaskDone { attempt, elapsed_ms, .. } => Some(format!("done {attempt} {elapsed_ms}")),
            _ => None,
        });
        let wanted = [
            "started v 1",
            "released v 10",
            "started v 1",
            "failed 1 20",
            "started w 2",
            "expired 2 30000",
            "started w 2",
            "expired 2 30000",
            "started w 3",
            "done 3 30",
        ];
        assert_eq!(told.collect::<Vec<_>>(), wanted);
    }
}

pub async fn events_page_through(world: World) {
    let bake = world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    world.drain("w").await;
    let mut seen = Vec::new();
    loop {
        let after = seen.last().copied().unwrap_or(0);
        let page = world.store.events_after(&bake.id, after, 2).await.unwrap();
        assert_eq!(page.bake.state, BakeState::Done);
        if page.events.is_empty() {
            break;
        }
        seen.extend(page.events.iter().map(|event| event.seq));
    }
    assert_eq!(seen, [1, 2, 3, 4, 5, 6, 7]);
}

pub async fn list_pages_newest_first(world: World) {
    let mut ids = Vec::new();
    for name in ["a", "b", "c", "d", "e"] {
        ids.insert(0, world.submit(name, &[]).await.id);
    }
    let mut seen = Vec::new();
    let mut after = None;
    loop {
        let page = world.store.list(&BakeFilter::default(), after, 2).await.unwrap();
        seen.extend(page.bakes.into_iter().map(|bake| bake.id));
        after = page.next;
        if after.is_none() {
            break;
        }
    }
    assert_eq!(seen, ids);
}

/// Whoever reads page after page while others delete bakes misses none and is not refused.
pub async fn list_goes_on_behind_a_bake_that_was_deleted(world: World) {
    let mut ids = Vec::new();
    for name in ["a", "b", "c", "d", "e"] {
        ids.insert(0, world.submit(name, &[]).await.id);
    }
    let page = world.store.list(&BakeFilter::default(), None, 2).await.unwrap();
    for id in &ids[..3] {
        world.store.delete_bake(id).await.unwrap();
    }
    world.submit("new", &[]).await;
    let rest = world.store.list(&BakeFilter::default(), page.next, 2).await.unwrap();
    assert_eq!(rest.bakes.iter().map(|bake| &bake.id).collect::<Vec<_>>(), [&ids[3], &ids[4]]);
    assert_eq!(rest.next, None);
    assert!(world.store.list(&BakeFilter::default(), Some(0), 2).await.unwrap().bakes.is_empty());
    assert_eq!(world.store.list(&BakeFilter::default(), Some(u64::MAX), 5).await.unwrap().bakes.len(), 3);
}

/// Names of the bakes that the filter takes, newest first.
async fn listed(world: &World, filter: &BakeFilter) -> Vec<String> {
    let page = world.store.list(filter, None, 100).await.unwrap();
    assert_eq!(page.next, None);
    page.bakes.into_iter().map(|bake| bake.name).collect()
}

pub async fn list_holds_what_the_filter_takes(world: World) {
    let open = [task("a", &[])];
    let hour = 3_600_000;
    world.submit("Cornell box", &[]).await;
    world.clock.advance_ms(hour);
    let paused = world.submit("100% of the cornell_box", &open).await;
    world.store.pause(&paused.id).await.unwrap();
    world.clock.advance_ms(hour);
    let cancelled = world.submit("KÜCHE", &open).await;
    world.store.cancel(&cancelled.id).await.unwrap();
    let noon = world.submit("atrium", &open).await;
    let all = BakeFilter::default();
    assert_eq!(listed(&world, &all).await, ["atrium", "KÜCHE", "100% of the cornell_box", "Cornell box"]);
    for (states, wanted) in [
        (vec![BakeState::Running], &["atrium"][..]),
        (vec![BakeState::Done, BakeState::Paused], &["100% of the cornell_box", "Cornell box"]),
        (vec![BakeState::Cancelled, BakeState::Cancelled], &["KÜCHE"]),
        (vec![BakeState::Failed], &[]),
    ] {
        assert_eq!(listed(&world, &BakeFilter { states, ..all.clone() }).await, wanted);
    }
    for (name, wanted) in [
        ("cornell", &["100% of the cornell_box", "Cornell box"][..]),
        ("l b", &["Cornell box"]),
        ("%", &["100% of the cornell_box"]),
        ("_", &["100% of the cornell_box"]),
        ("küche", &[]),
        ("Üche", &["KÜCHE"]),
        ("'", &[]),
    ] {
        assert_eq!(listed(&world, &BakeFilter { name: name.into(), ..all.clone() }).await, wanted, "{name}");
    }
    for (since_ms, wanted) in [
        (noon.created_ms + 1, &[][..]),
        (noon.created_ms, &["atrium", "KÜCHE"]),
        (noon.created_ms - hour, &["atrium", "KÜCHE", "100% of the cornell_box"]),
    ] {
        assert_eq!(listed(&world, &BakeFilter { since_ms: Some(since_ms), ..all.clone() }).await, wanted);
    }
    let states = vec![BakeState::Paused, BakeState::Done];
    let each = BakeFilter { states, name: "BOX".into(), since_ms: Some(noon.created_ms - hour) };
    assert_eq!(listed(&world, &each).await, ["100% of the cornell_box"]);
}

/// Bakes that the filter does not take stand between those that it takes.
pub async fn filtered_list_pages_without_a_gap(world: World) {
    let mut wanted = Vec::new();
    for number in 0..9 {
        let bake = world.submit(if number % 3 == 2 { "other" } else { "mine" }, &[]).await;
        if number % 3 != 2 {
            wanted.insert(0, bake.id);
        }
    }
    for filter in [
        BakeFilter { name: "mine".into(), ..BakeFilter::default() },
        BakeFilter { name: "mine".into(), states: vec![BakeState::Done], since_ms: Some(1) },
    ] {
        let (mut seen, mut after) = (Vec::new(), None);
        loop {
            let page = world.store.list(&filter, after, 2).await.unwrap();
            assert_eq!(page.bakes.len(), 2, "no page is short while there are more");
            seen.extend(page.bakes.into_iter().map(|bake| bake.id));
            after = page.next;
            if after.is_none() {
                break;
            }
        }
        assert_eq!(seen, wanted);
    }
}

pub async fn bakes_are_found_by_the_beginning_of_their_ids(world: World) {
    let mut ids = Vec::new();
    for _ in 0..20 {
        ids.push(world.submit("bake", &[]).await.id);
    }
    ids.sort();
    let found = async |id: &str, limit| -> Vec<String> {
        let found = world.store.begin_with(id, limit).await.unwrap();
        assert!(found.iter().all(|bake| (bake.name.as_str(), bake.state) == ("bake", BakeState::Done)));
        found.into_iter().map(|bake| bake.id).collect()
    };
    assert_eq!(found("", 100).await, ids);
    assert_eq!(found("", 3).await, ids[..3]);
    for id in &ids {
        for length in [1, 2, 15, 16] {
            let alike: Vec<&String> = ids.iter().filter(|other| other.starts_with(&id[..length])).collect();
            assert_eq!(
                found(&id[..length], 100).await.iter().collect::<Vec<_>>(),
                alike,
                "{}",
                &id[..length]
            );
        }
    }
    assert!(found(&format!("{}0", ids[0]), 100).await.is_empty());
}

pub async fn stages_count_what_happens(world: World) {
    let first = task_of("work", "first", &[], 5);
    let bake = world.submit("bake", &[task_of("more", "last", &[&first], 7), first]).await;
    assert_eq!(bake.stages.iter().map(|stage| stage.kind.as_str()).collect::<Vec<_>>(), ["more", "work"]);
    let lease = world.claim_one("w").await;
    assert_eq!(world.show(&bake).await.stages[1].leased, 1);
    world.clock.advance_ms(40);
    world.commit(&lease).await;
    let stages = world.show(&bake).await.stages;
    let work = &stages[1];
    assert_eq!((work.total, work.done, work.leased, work.elapsed_ms), (1, 1, 0, 40));
    assert_eq!((work.cost_total, work.cost_done), (5, 5));
    assert_eq!((stages[0].total, stages[0].done, stages[0].cost_total), (1, 0, 7));
}

pub async fn results_are_named_when_done(world: World) {
    let bake = world.submit("bake", &[task("a", &[]), task("b", &[])]).await;
    let leases = world.claim("w", 2).await;
    let digest = output(0);
    let named = |name: &str| Artefact { name: name.into(), digest, bytes: 32 };
    let outputs = vec![named(MANIFEST_OUTPUT), named(REPORT_OUTPUT)];
    let result = TaskResult { outputs, ..TaskResult::default() };
    world.store.commit(&leases[0].token, &result).await.unwrap();
    assert_eq!(world.show(&bake).await.manifest, None, "not before the bake is done");
    world.commit(&leases[1]).await;
    let bake = world.show(&bake).await;
    assert_eq!((bake.manifest, bake.report), (Some(digest), Some(digest)));
    let again = world.submit("again", &[leases[0].task.clone()]).await;
    assert_eq!(again.manifest, Some(digest));
}

pub async fn workers_show_what_they_hold(world: World) {
    world.submit("bake", &[task("b", &[]), task("a", &[])]).await;
    world.claim("idle", 1).await;
    world.clock.advance_ms(400_000);
    world.store.reap().await.unwrap();
    world.clock.advance_ms(300_000);
    let leases = world.claim("busy", 2).await;
    assert_eq!(leases.len(), 2);
    let workers = world.store.workers().await.unwrap();
    assert_eq!(workers.len(), 1, "the idle one was not heard of for long");
    let busy = &workers[0];
    assert_eq!((busy.name.as_str(), busy.threads, busy.seen_ms), ("busy", 2, 1_700_000));
    assert_eq!((&busy.kinds, &busy.holds[..]), (&request("", 1).kinds, &["a".to_owned(), "b".into()][..]));
}

pub async fn stats_count_tasks_by_state(world: World) {
    let [a, b] = ["a", "b"].map(|name| task(name, &[]));
    world.submit("bake", &[a.clone(), b, task_of("more", "c", &[&a], 0), task("d", &[])]).await;
    let leases = world.claim("w", 2).await;
    let done = leases.iter().find(|lease| lease.task.key != a.key).unwrap();
    world.commit(done).await;
    let stats = world.store.stats().await.unwrap();
    let counts: Vec<_> =
        stats.tasks.iter().map(|count: &TaskCount| (count.kind.as_str(), count.state)).collect();
    let mut wanted = vec![("more", TaskState::Waiting)];
    wanted.extend([TaskState::Ready, TaskState::Leased, TaskState::Done].map(|state| ("work", state)));
    assert_eq!(counts, wanted);
    assert_eq!(stats.tasks.iter().map(|count| count.count).sum::<u64>(), 4);
    assert_eq!((stats.bakes_live, stats.bakes_total, stats.tasks_run, stats.tasks_reused), (1, 1, 1, 0));
}

pub async fn stats_tell_for_how_long_tasks_have_been_waiting(world: World) {
    let a = task("a", &[]);
    let bake = world.submit("bake", &[a.clone(), task_of("more", "b", &[&a], 1), task("c", &[])]).await;
    let waited = async || -> Vec<(String, u64, u64)> {
        let demand = world.store.stats().await.unwrap().demand.into_iter();
        demand.map(|demand| (demand.kind, demand.ready, demand.waited_ms)).collect()
    };
    let work = |ready, waited_ms| ("work".to_owned(), ready, waited_ms);
    world.clock.advance_ms(5_000);
    assert_eq!(waited().await, [work(2, 5_000)]);
    let leases = world.claim("w", 2).await;
    assert_eq!(waited().await, []);
    world.clock.advance_ms(1_000);
    let (first, other) = match leases[0].task.key == a.key {
        true => (&leases[0], &leases[1]),
        false => (&leases[1], &leases[0]),
    };
    world.commit(first).await;
    world.store.release(&other.token).await.unwrap();
    world.clock.advance_ms(2_000);
    assert_eq!(waited().await, [("more".to_owned(), 1, 2_000), work(1, 2_000)]);
    // While a bake is paused nobody keeps its tasks waiting but who paused it.
    world.store.pause(&bake.id).await.unwrap();
    world.clock.advance_ms(60_000);
    assert_eq!(waited().await, []);
    world.store.resume(&bake.id).await.unwrap();
    world.clock.advance_ms(3_000);
    assert_eq!(waited().await, [("more".to_owned(), 1, 3_000), work(1, 3_000)]);
    // Nor does a task wait for a worker that is held back after a failure.
    let lease = world.claim_one("w").await;
    world.store.fail(&lease.token, Blame::Worker, "why").await.unwrap();
    let held_back: Vec<_> = waited().await.into_iter().filter(|demand| demand.0 == lease.task.kind).collect();
    assert_eq!(held_back, [(lease.task.kind.clone(), 1, 0)]);
}

pub async fn counts_of_run_and_reused_tasks_never_fall(world: World) {
    let plan = [task("a", &[]), task("b", &[])];
    let first = world.submit("first", &plan).await;
    world.drain("w").await;
    let second = world.submit("second", &plan).await;
    let counts = async || {
        let stats = world.store.stats().await.unwrap();
        (stats.tasks_run, stats.tasks_reused)
    };
    assert_eq!(counts().await, (2, 2));
    world.store.delete_bake(&first.id).await.unwrap();
    assert_eq!(counts().await, (2, 2));
    world.submit("third", &[&plan[..], &[task("open", &[])]].concat()).await;
    assert_eq!(counts().await, (2, 4));
    world.store.forget(&[plan[0].key]).await.unwrap();
    assert_eq!(counts().await, (2, 4), "it was reused, although it will run now");
    world.drain("w").await;
    world.store.delete_bake(&second.id).await.unwrap();
    assert_eq!(counts().await, (4, 4));
}

pub async fn probe_writes(world: World) {
    world.store.probe().await.unwrap();
    world.store.probe().await.unwrap();
}
