//! The model against what is known of any queue.

use std::time::Duration;

use super::costs::{Call, Costs, Database};
use super::farm::{Farm, Limit, Outcome};
use super::times::task_time;

const MS: Duration = Duration::from_millis(1);

/// Costs of round numbers: a task takes 4 ms of a server and `database_ms` of each change and question of the database.
fn costs(database_ms: f64) -> Costs {
    let call = |server_ms| Call { server_ms, database_ms, trips: 0.0 };
    Costs {
        http_ms: 0.25,
        claim: call(1.0),
        lease: call(0.5),
        heartbeat: call(0.5),
        look: call(0.5),
        upload: call(1.0),
        commit: call(1.0),
        result: call(0.75),
        flush_ms: 0.0,
    }
}

fn farm(workers: usize) -> Farm {
    Farm {
        database: Database::Postgres,
        costs: costs(0.0),
        servers: 1,
        server_processors: 2,
        database_processors: Some(64),
        worker_work: Duration::ZERO,
        elsewhere: 0.0,
        round_trip: Duration::ZERO,
        bakes: 16,
        workers,
        in_hand: 1,
        tasks: 20 * workers.max(50),
        mean: 1000 * MS,
        beat: 10_000 * MS,
        seed: 3,
    }
}

/// One that asks for four times what two processors give, or more.
fn hungry() -> Farm {
    Farm { mean: 200 * MS, tasks: 24_000, ..farm(1200) }
}

fn run(farm: Farm) -> Outcome {
    farm.run().unwrap()
}

fn assert_near(found: f64, wanted: f64, part: f64) {
    assert!((found / wanted - 1.0).abs() <= part, "{found}, not {wanted}");
}

#[test]
fn one_worker_takes_the_sum_of_tasks_and_calls() {
    for database in [Database::Sqlite, Database::Postgres] {
        let costs = Costs { flush_ms: 3.0, ..costs(0.5) };
        let farm = Farm { database, costs, bakes: 1, tasks: 100, workers: 1, round_trip: MS, ..farm(1) };
        let tasks: Duration = (0..100).map(|task| task_time(3, task, farm.mean)).sum();
        // Five calls of 4 ms at the server and 0.5 ms each at the database, five round trips, a file's flush and a commit's.
        let calls = Duration::from_secs_f64(0.004 + 0.0025 + 0.005 + 0.006) * 100;
        assert_near(run(farm).finished.as_secs_f64(), (tasks + calls).as_secs_f64(), 1e-6);
    }
}

/// The utilisation law: a server is busy for the rate times its cost of a task. Saturated, it gives nearly its processors over that cost, and
/// never more.
#[test]
fn saturated_server_gives_its_processors_over_its_cost_of_a_task() {
    for (elsewhere, bound) in [(0.0, 2.0 / 0.004), (0.5, 1.0 / 0.004)] {
        let outcome = run(Farm { elsewhere, ..hungry() });
        let rate = outcome.figures.tasks_per_sec;
        assert!(rate > 0.9 * bound && rate < 1.005 * bound, "{rate} of {bound}");
        assert_near(outcome.server_busy, rate / bound, 0.01);
        assert_eq!(outcome.limit(), Limit::Server);
    }
}

#[test]
fn servers_add_up_until_the_database_has_no_time_left() {
    let of = |servers, database_processors, database_ms| {
        let database_processors = Some(database_processors);
        run(Farm { servers, database_processors, costs: costs(database_ms), ..hungry() })
    };
    let rate = |servers, database_ms| of(servers, 64, database_ms).figures.tasks_per_sec;
    assert!(rate(2, 0.0) > 1.9 * rate(1, 0.0));
    // Five calls of 1 ms on one processor: 200 tasks a second at most, however many servers.
    let [one, two, three] = [1, 2, 3].map(|servers| of(servers, 1, 1.0));
    for outcome in [&one, &two, &three] {
        let rate = outcome.figures.tasks_per_sec;
        assert!(rate > 180.0 && rate < 201.0, "{rate}");
        assert_near(outcome.database_busy, rate / 200.0, 0.01);
        assert_eq!(outcome.limit(), Limit::Database);
    }
    assert!(three.figures.tasks_per_sec < 1.1 * one.figures.tasks_per_sec);
}

#[test]
fn workers_are_fed_while_all_have_time() {
    let outcome = run(farm(100));
    assert_eq!(outcome.limit(), Limit::None);
    assert!(outcome.figures.efficiency > 0.98, "{outcome:?}");
    assert_near(outcome.figures.tasks_per_sec, 100.0 * outcome.figures.efficiency, 0.03);
    // 100 tasks a second of 4 ms on two processors.
    assert_near(outcome.server_busy, 0.2, 0.05);
    assert!(outcome.figures.tail < 5 * farm(1).mean);
}

#[test]
fn number_of_busy_places_is_the_rate_times_the_task_time() {
    for workers in [50, 150, 600] {
        let farm = Farm { tasks: 40 * workers, ..farm(workers) };
        let figures = run(farm).figures;
        let busy = figures.efficiency * workers as f64;
        assert_near(busy, figures.tasks_per_sec * farm.mean.as_secs_f64(), 0.03);
    }
}

#[test]
fn sqlite_makes_one_change_at_a_time() {
    let farm = Farm { database: Database::Sqlite, server_processors: 64, servers: 3, ..hungry() };
    let outcome = run(farm);
    // Claim, heartbeat, upload and commit have the file for their work but HTTP's: 0.75, 0.25, 0.75 and 0.75 ms.
    assert_near(outcome.figures.tasks_per_sec, 1.0 / 0.0025, 0.02);
    assert_eq!(outcome.limit(), Limit::Lock);
}

#[test]
fn one_bake_is_locked_where_several_go_side_by_side() {
    let of_bakes = |bakes| {
        let costs = Costs { flush_ms: 0.5, ..costs(1.0) };
        let farm = Farm { bakes, server_processors: 64, servers: 3, costs, ..hungry() };
        run(farm)
    };
    let [one, many] = [1, 12].map(of_bakes);
    assert_eq!(one.limit(), Limit::Lock);
    assert!(many.figures.tasks_per_sec > 1.5 * one.figures.tasks_per_sec, "{one:?} {many:?}");
}

#[test]
fn results_that_meet_share_a_flush() {
    let costs = Costs { flush_ms: 50.0, ..costs(0.0) };
    let outcome = run(Farm { costs, bakes: 1, server_processors: 64, ..farm(500) });
    assert!(outcome.mean_batch > 5.0, "{outcome:?}");
    assert!(outcome.figures.tasks_per_sec > 5.0 / 0.050, "{outcome:?}");
}

#[test]
fn worker_with_several_tasks_in_hand_claims_and_hands_in_several_at_once() {
    let farm = Farm { workers: 25, in_hand: 8, mean: 100 * MS, round_trip: 5 * MS, tasks: 4000, ..farm(25) };
    let alone = run(Farm { workers: 200, in_hand: 1, ..farm });
    assert_eq!((alone.claims, alone.commits), (4000, 4000));
    let together = run(farm);
    assert!(together.claims < 3 * 1000, "{} claims", together.claims);
    assert!(together.commits < 3 * 1000, "{} commits", together.commits);
}

#[test]
fn lease_is_kept_once_at_its_beginning_and_then_from_time_to_time() {
    let farm = Farm { workers: 1, tasks: 20, bakes: 1, mean: 30_000 * MS, ..farm(1) };
    let later: u64 = (0..20).map(|task| (task_time(3, task, farm.mean).as_millis() / 10_000) as u64).sum();
    assert!(later > 20);
    assert_eq!(run(farm).heartbeats, 20 + later);
}

#[test]
fn lease_is_kept_until_its_result_is_answered_and_no_longer() {
    // Each task takes less than 10 s, then waits 15 s for its file's flush and 15 s for its commit's.
    let costs = Costs { flush_ms: 15_000.0, ..costs(0.0) };
    let farm = Farm { workers: 1, tasks: 20, bakes: 1, costs, ..farm(1) };
    assert_eq!(run(farm).heartbeats, 20 * (1 + 3));
}

#[test]
fn same_seed_gives_the_same_course() {
    let [first, again, other] = [3, 3, 4].map(|seed| run(Farm { seed, ..farm(300) }));
    assert_eq!(first.finished, again.finished);
    assert_eq!(first.figures, again.figures);
    assert_ne!(first.finished, other.finished);
}
