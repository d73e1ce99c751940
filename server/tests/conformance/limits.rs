//! Limits of single bakes: how many workers hold tasks of one at once, and how often its tasks are tried.

use std::slice::from_ref;

use lightkiln_proto::api::{Bake, BakeLimits, BakeState, Blame};
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_server::store::{FailVerdict, MAX_ATTEMPTS, POISON_WORKERS, Room, WAIT_MAX_MS};

use crate::support::{TTL_MS, World, request, submission, task, task_of};

fn workers(most: u32) -> BakeLimits {
    BakeLimits { max_workers: Some(most), ..BakeLimits::default() }
}

async fn submit(world: &World, name: &str, limits: BakeLimits, plan: &[TaskSpec]) -> Bake {
    let mut submission = submission(name, plan);
    submission.bake.limits = limits;
    let bake = world.store.submit(&submission).await.unwrap().bake;
    assert_eq!(bake.limits, limits);
    bake
}

fn tasks(name: &str, count: usize) -> Vec<TaskSpec> {
    (0..count).map(|number| task(&format!("{name} {number}"), &[])).collect()
}

pub async fn bake_at_its_limit_of_workers_goes_to_those_that_hold_some_of_it(world: World) {
    let bake = submit(&world, "bake", workers(2), &tasks("bake", 9)).await;
    let first = world.claim("a", 3).await;
    assert_eq!(first.len(), 3, "a worker counts as one, however many tasks it holds");
    let second = world.claim("b", 1).await;
    assert_eq!((second.len(), world.claim("c", 4).await.len()), (1, 0));
    assert_eq!(world.claim("b", 1).await.len(), 1, "it is one of the two");
    for lease in &first {
        assert_eq!(world.claim("c", 1).await.len(), 0, "until the last of its tasks has ended");
        world.commit(lease).await;
    }
    assert_eq!(world.claim("c", 1).await.len(), 1);
    assert_eq!(world.claim("a", 1).await.len(), 0);
    // Whatever ends the lease makes room.
    assert!(world.store.release(&second[0].token).await.unwrap());
    assert_eq!(world.claim("a", 1).await.len(), 0, "b holds another one");
    world.clock.advance_ms(TTL_MS);
    assert_eq!(world.claim("a", 1).await.len(), 0, "nobody has noticed yet");
    assert_eq!(world.store.reap().await.unwrap().expired, 2);
    assert_eq!((world.drain("a").await, world.state(&bake).await), (6, BakeState::Done));
}

pub async fn bake_at_its_limit_of_workers_holds_no_other_back(world: World) {
    let shared = tasks("shared", 2);
    let plan = [&shared[..], &tasks("own", 2)].concat();
    let limited = submit(&world, "limited", workers(1), &plan).await;
    let held = world.claim("a", 1).await;
    assert_eq!(held[0].bake, limited.id);
    assert_eq!(world.claim("b", 9).await.len(), 0);
    let other = world.submit("other", &shared).await;
    let given = world.claim("b", 9).await;
    let left = 2 - usize::from(shared.contains(&held[0].task));
    assert_eq!(given.len(), left, "what the other one wants, too");
    assert!(given.iter().all(|lease| lease.bake == other.id && shared.contains(&lease.task)));
    assert_eq!(world.claim("c", 9).await.len(), 0);
    // Those of the other one do not count: 'a' is the first alone.
    assert_eq!(world.claim("a", 9).await.len(), 4 - 1 - left);
}

pub async fn look_tells_who_may_take_tasks_of_a_bake_with_a_limit(world: World) {
    let rooms = async || {
        let openings = world.store.look(&[], 100).await.unwrap().openings;
        let mut rooms: Vec<_> = openings.into_iter().map(|opening| (opening.ready, opening.room)).collect();
        rooms.sort();
        rooms
    };
    let room = |holders: &[&str], others| {
        Some(Room { holders: holders.iter().map(|holder| (*holder).to_owned()).collect(), others })
    };
    submit(&world, "one", workers(2), &tasks("one", 5)).await;
    assert_eq!(rooms().await, [(5, room(&[], 2))]);
    world.claim("a", 2).await;
    assert_eq!(rooms().await, [(3, room(&["a"], 1))]);
    let lease = world.claim_one("b").await;
    submit(&world, "two", workers(7), &tasks("two", 3)).await;
    world.submit("three", &tasks("three", 4)).await;
    world.submit("four", &tasks("four", 5)).await;
    assert_eq!(rooms().await, [(2, room(&["a", "b"], 0)), (3, room(&[], 7)), (9, None)]);
    world.commit(&lease).await;
    assert_eq!(rooms().await[0], (2, room(&["a"], 1)));
}

pub async fn demand_of_a_bake_with_a_limit_is_its_free_places(world: World) {
    let demand = async || {
        let demand = world.store.stats().await.unwrap().demand.into_iter();
        demand.map(|demand| (demand.kind, demand.ready, demand.waited_ms)).collect::<Vec<_>>()
    };
    let of = |kind: &str, ready, waited_ms| (kind.to_owned(), ready, waited_ms);
    let plan = [tasks("one", 40), vec![task_of("more", "other", &[], 9)]].concat();
    submit(&world, "one", workers(3), &plan).await;
    world.clock.advance_ms(1_000);
    assert_eq!(demand().await, [of("more", 1, 1_000), of("work", 2, 1_000)], "kinds share its places");
    world.claim("a", 2).await;
    assert_eq!(demand().await, [of("work", 2, 1_000)], "a worker takes one place, however many tasks");
    let lease = world.claim_one("b").await;
    world.claim_one("c").await;
    assert_eq!(demand().await, [], "nobody else may take any");
    submit(&world, "two", workers(9), &tasks("two", 4)).await;
    world.submit("three", &tasks("three", 5)).await;
    assert_eq!(
        demand().await,
        [of("work", 4 + 5, 0)],
        "few tasks ask for few workers, and other bakes for all"
    );
    world.store.release(&lease.token).await.unwrap();
    assert_eq!(demand().await, [of("work", 1 + 4 + 5, 1_000)]);
}

/// Claims of many workers at the same moment.
pub async fn concurrent_claims_keep_to_the_limit_of_workers(world: World) {
    const MOST: u32 = 3;
    for round in 0..4 {
        let bake = submit(&world, "bake", workers(MOST), &tasks(&format!("round {round}"), 40)).await;
        let claims = (0..12).map(|number| {
            let (store, request) = (world.store.clone(), request(&format!("w{round}/{number}"), 2));
            tokio::spawn(async move { store.claim(&request).await.unwrap().len() })
        });
        let given = futures::future::join_all(claims).await.into_iter().map(Result::unwrap);
        let holders = given.filter(|leases| *leases > 0).count();
        assert_eq!(holders, MOST as usize, "round {round}");
        world.store.cancel(&bake.id).await.unwrap();
    }
}

async fn fail(world: &World, worker: &str, blame: Blame) -> FailVerdict {
    let lease = world.begin_one(worker).await;
    let verdict = world.store.fail(&lease.token, blame, "why").await.unwrap();
    world.clock.advance_ms(WAIT_MAX_MS);
    verdict
}

pub async fn attempts_of_a_bake_count_alone(world: World) {
    for attempts in [1, 2, MAX_ATTEMPTS + 4] {
        let limits = BakeLimits { attempts: Some(attempts), ..BakeLimits::default() };
        let bake = submit(&world, "bake", limits, &tasks(&format!("{attempts}"), 1)).await;
        for attempt in 1..attempts {
            // On more workers than usually make a task poison.
            let worker = format!("w{}", attempt % (2 * POISON_WORKERS));
            assert_eq!(
                fail(&world, &worker, Blame::Worker).await,
                FailVerdict::Retry,
                "{attempt} of {attempts}"
            );
        }
        assert_eq!(fail(&world, "last", Blame::Worker).await, FailVerdict::GivenUp);
        let shown = world.show(&bake).await;
        assert_eq!((shown.state, shown.attempts_failed), (BakeState::Failed, attempts.into()));
    }
}

pub async fn lost_workers_of_a_bake_count_instead_of_the_farms(world: World) {
    let limits = BakeLimits { lost_workers: Some(2), ..BakeLimits::default() };
    let bake = submit(&world, "bake", limits, &tasks("bake", 1)).await;
    assert_eq!(fail(&world, "a", Blame::Lost).await, FailVerdict::Retry);
    assert_eq!(fail(&world, "b", Blame::Lost).await, FailVerdict::GivenUp);
    assert!(world.show(&bake).await.failure.unwrap().contains("was lost 2 times"));
}

pub async fn leases_of_a_lost_worker_that_were_not_begun_count_no_attempt(world: World) {
    let limits = BakeLimits { lost_workers: Some(1), ..BakeLimits::default() };
    let bake = submit(&world, "bake", limits, &tasks("bake", 3)).await;
    let leases = world.claim("w", 3).await;
    for lease in &leases {
        let verdict =
            world.store.fail(&lease.token, Blame::Lost, "its next start tells of it").await.unwrap();
        assert_eq!(verdict, FailVerdict::Retry);
    }
    let shown = world.show(&bake).await;
    assert_eq!((shown.state, shown.attempts_lost, shown.attempts_failed), (BakeState::Running, 0, 0));
    assert_eq!(world.claim("v", 9).await.len(), 3, "there is nothing to wait for");
    world.clock.advance_ms(TTL_MS);
    assert_eq!(world.store.reap().await.unwrap().expired, 3);
    assert_eq!(fail(&world, "w", Blame::Lost).await, FailVerdict::GivenUp, "this one was begun");
}

pub async fn most_generous_bake_decides_about_a_task_of_several(world: World) {
    let a = task("a", &[]);
    let strict = BakeLimits { attempts: Some(1), lost_workers: Some(1), ..BakeLimits::default() };
    let bakes =
        [submit(&world, "strict", strict, from_ref(&a)).await, world.submit("usual", from_ref(&a)).await];
    assert_eq!(fail(&world, "a", Blame::Lost).await, FailVerdict::Retry);
    for _ in 1..MAX_ATTEMPTS {
        assert_eq!(fail(&world, "a", Blame::Worker).await, FailVerdict::Retry);
    }
    assert_eq!(fail(&world, "a", Blame::Worker).await, FailVerdict::GivenUp);
    for bake in &bakes {
        assert_eq!(world.state(bake).await, BakeState::Failed);
    }
    // Once the generous one has gone, the other decides.
    let generous = world.submit("generous", from_ref(&a)).await;
    let strict = submit(&world, "strict", strict, from_ref(&a)).await;
    assert_eq!(fail(&world, "a", Blame::Worker).await, FailVerdict::Retry);
    world.store.cancel(&generous.id).await.unwrap();
    assert_eq!(fail(&world, "a", Blame::Worker).await, FailVerdict::GivenUp);
    assert_eq!(world.state(&strict).await, BakeState::Failed);
}
