//! Runs of real workers, many in this process, on one `kiln server`, beside what the model says of the same farm.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use lightkiln_proto::jobs::{TaskInput, TaskSpec};
use lightkiln_tests::scale::costs::{Costs, Database};
use lightkiln_tests::scale::farm::{Farm as Model, Outcome};
use lightkiln_tests::scale::timeline::Figures;
use lightkiln_tests::scale::times::task_time;
use serde_json::json;

use super::costs::{costs_on, output};
use super::meter::{Spent, processors};
use super::worker::{Crew, KIND, Timed, worker};
use super::{DATABASES, Farm, number, numbers};
use crate::calls::Caller;
use crate::report::{quantiles, row};

/// Counts of workers, mean seconds of a task with each, tasks for each worker, tasks in hand, and bakes, where the environment does not say.
const WORKERS: &str = "50";
const MEAN_SECS: &str = "4";
const TASKS_EACH: usize = 8;
const IN_HAND: usize = 1;
const BAKES: usize = 4;
/// Time between two tasks of the caller whose calls are timed.
const PROBE_EVERY: Duration = Duration::from_millis(100);
/// Tasks for it, and their kind.
const PROBES: usize = 4_000;
const PROBED: &str = "bench.probe";
/// Time between two looks whether all is done.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Time between a worker's heartbeats: a third of a lease's usual length.
const BEAT: Duration = Duration::from_secs(10);
/// Longest that a run may take.
const LIMIT: Duration = Duration::from_secs(900);

/// Measures both databases, with each mean time and each count of workers.
pub fn measure() {
    let only = std::env::var("KILN_BENCH_DATABASE").ok();
    for (name, database) in
        DATABASES.into_iter().filter(|(name, _)| only.as_deref().is_none_or(|only| only == *name))
    {
        eprintln!("scale-load: costs of calls on {name}");
        let costs = costs_on(database);
        eprintln!("{costs:.3?}");
        for mean_secs in numbers("KILN_BENCH_MEAN_SECS", MEAN_SECS) {
            for workers in numbers("KILN_BENCH_WORKERS", WORKERS) {
                let run = Run {
                    database,
                    workers,
                    in_hand: number("KILN_BENCH_IN_HAND", IN_HAND),
                    bakes: number("KILN_BENCH_BAKES", BAKES),
                    tasks: workers * number("KILN_BENCH_TASKS_EACH", TASKS_EACH),
                    mean: Duration::from_secs_f64(mean_secs),
                };
                eprintln!("scale-load: {workers} workers on {name}");
                let measured = run.measure();
                run.tell(name, &measured, &run.model(&costs, &measured));
            }
        }
    }
}

struct Run {
    database: Database,
    workers: usize,
    in_hand: usize,
    bakes: usize,
    tasks: usize,
    mean: Duration,
}

struct Measured {
    figures: Figures,
    spent: Spent,
    claims: Vec<Duration>,
    commits: Vec<Duration>,
    /// From the first worker's start to the last commit.
    finished: Duration,
}

impl Run {
    fn measure(&self) -> Measured {
        let farm = Farm::start(self.database);
        let caller = Caller::new(&farm.server.url);
        self.submit(&caller);
        let probes = self.submit_probes(&caller);
        let folder = tempfile::tempdir().unwrap();
        let timed = Arc::new(Timed::new());
        let workers = (0..self.workers)
            .map(|number| worker(&farm.server.url, folder.path(), number, self.in_hand, timed.clone()))
            .collect();
        let (before, started) = (farm.meter.read(), timed.now());
        let is_over = AtomicBool::new(false);
        let (claims, commits, finished, spent) = std::thread::scope(|scope| {
            let probe = scope.spawn(|| probe(&farm.server.url, &is_over));
            let crew = Crew::start(workers);
            let deadline = Instant::now() + LIMIT;
            while timed.count() < self.tasks {
                assert!(Instant::now() < deadline, "the tasks did not end");
                std::thread::park_timeout(LOOK_EVERY);
            }
            is_over.store(true, Ordering::Release);
            let (claims, commits) = probe.join().unwrap();
            caller.post(&format!("/v1/bakes/{probes}/cancel"), &json!({}));
            while caller.get("/v1/bakes?state=running").contains("\"id\"") {
                assert!(Instant::now() < deadline, "the bakes did not end");
                std::thread::park_timeout(LOOK_EVERY);
            }
            let (finished, spent) = (timed.now(), farm.meter.since(&before));
            drop(crew);
            (claims, commits, finished, spent)
        });
        let figures = Figures::of(&timed.spans(), self.workers * self.in_hand, finished);
        let figures = figures.expect("enough tasks for figures");
        Measured { figures, spent, claims, commits, finished: finished - started }
    }

    /// Bakes whose tasks are all ready.
    fn submit(&self, caller: &Caller) {
        let input = caller.put("chunks", b"an input that all tasks have");
        for bake in 0..self.bakes {
            let count = self.tasks / self.bakes + usize::from(bake < self.tasks % self.bakes);
            let task = |index: usize| {
                let micros = task_time(bake as u64, index as u64, self.mean).as_micros() as u64;
                let inputs = vec![TaskInput::Artefact { name: "in".into(), digest: input }];
                let params = json!({ "bake": bake, "index": index, "micros": micros });
                TaskSpec::new(KIND, 1, format!("bake {bake} task {index}"), params, inputs, 1)
            };
            let scene = format!("scene {bake}");
            caller.fill_with(&[], scene.as_bytes(), bake, &(0..count).map(task).collect::<Vec<_>>());
        }
    }

    /// A bake whose tasks are the probe's alone.
    fn submit_probes(&self, caller: &Caller) -> String {
        let task = |index: usize| {
            TaskSpec::new(PROBED, 1, format!("probe {index}"), json!({ "index": index }), Vec::new(), 1)
        };
        caller.fill_with(&[], b"a scene for probes", self.bakes, &(0..PROBES).map(task).collect::<Vec<_>>())
    }

    /// The same farm in the model: all on this machine, beside the same other programs.
    fn model(&self, costs: &Costs, measured: &Measured) -> Outcome {
        Model {
            database: self.database,
            costs: *costs,
            servers: 1,
            server_processors: processors(),
            database_processors: None,
            worker_work: measured.spent.own / self.tasks as u32,
            elsewhere: measured.spent.elsewhere.min(0.9),
            round_trip: Duration::ZERO,
            bakes: self.bakes,
            workers: self.workers,
            in_hand: self.in_hand,
            tasks: self.tasks,
            mean: self.mean,
            beat: BEAT,
            seed: 0,
        }
        .run()
        .expect("enough tasks for figures")
    }

    fn tell(&self, database: &str, measured: &Measured, model: &Outcome) {
        let Measured { figures, spent, .. } = measured;
        let hands =
            if self.in_hand == 1 { String::new() } else { format!(", {} tasks in hand each", self.in_hand) };
        let place =
            format!("{database}, {} workers{hands}, tasks of {:.2} s", self.workers, self.mean.as_secs_f64());
        let all = self.tasks + measured.claims.len();
        let per_task = |time: Duration| time.as_secs_f64() * 1000.0 / all as f64;
        let rate = format!(
            "{:.1} tasks a second, model {:.1}, ratio {:.2}",
            figures.tasks_per_sec,
            model.figures.tasks_per_sec,
            model.figures.tasks_per_sec / figures.tasks_per_sec
        );
        row("throughput", &place, &rate);
        let share = |figures: &Figures| format!("{:.1} %", 100.0 * figures.efficiency);
        row("efficiency of workers", &place, &format!("{}, model {}", share(figures), share(&model.figures)));
        let tail = |figures: &Figures| format!("{:.1} s", figures.tail.as_secs_f64());
        let finished = [measured.finished, model.finished].map(|time| time.as_secs_f64());
        let figure = format!(
            "{}, model {}; all {:.1} s, model {:.1} s",
            tail(figures),
            tail(&model.figures),
            finished[0],
            finished[1]
        );
        row("tail", &place, &figure);
        let model_ms = |time: Duration| time.as_secs_f64() * 1000.0;
        let claim = format!(
            "{}, model's p99 {:.1} ms",
            quantiles(&mut measured.claims.clone()),
            model_ms(model.claim_p99)
        );
        row("claim", &place, &claim);
        let commit = format!(
            "{}, model's p99 {:.1} ms",
            quantiles(&mut measured.commits.clone()),
            model_ms(model.commit_p99)
        );
        row("commit", &place, &commit);
        let figure = format!(
            "server {:.2} ms, database {:.2} ms, workers {:.2} ms a task; {:.0} % of the machine for others, {:.0} % in use, model {:.0} %",
            per_task(spent.server),
            per_task(spent.database),
            per_task(spent.own),
            100.0 * spent.elsewhere,
            100.0 * spent.busy,
            100.0 * (spent.elsewhere + model.server_busy * (1.0 - spent.elsewhere))
        );
        row("processor time", &place, &figure);
    }
}

/// Claims and commits a task from time to time; how long the calls took.
fn probe(url: &str, is_over: &AtomicBool) -> (Vec<Duration>, Vec<Duration>) {
    let caller = Caller::new(url);
    let (mut claims, mut commits) = (Vec::new(), Vec::new());
    while !is_over.load(Ordering::Acquire) && claims.len() < PROBES {
        let started = Instant::now();
        let token = caller.claim("probe", &[PROBED]).unwrap();
        claims.push(started.elapsed());
        let output = output("probe", claims.len());
        caller.put("chunks", &output);
        let started = Instant::now();
        caller.commit_stored(&[(&token, &output)]);
        commits.push(started.elapsed());
        std::thread::park_timeout(PROBE_EVERY);
    }
    (claims, commits)
}
