//! The verdict: conditions that must hold at the end, whatever happened.

use std::collections::BTreeMap;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{Bake, BakeEvent, BakeState, Blame, EventKind};
use lightkiln_proto::ids::TaskKey;
use lightkiln_server::store::{MAX_ATTEMPTS, POISON_WORKERS};

use super::super::processes::{kiln, run};
use super::Patience;
use super::troupe::Troupe;

/// Counts from the bakes' events, added up over all of them.
#[derive(Default)]
pub struct Books {
    /// How often each task was committed.
    commits: BTreeMap<TaskKey, u32>,
    done: u64,
    expired: u64,
    lost: u64,
}

impl Books {
    /// Takes in an ended bake. Whatever happened to it was nobody's fault but that of workers that were not heard from.
    pub fn close(&mut self, client: &ApiClient, bake: &Bake) {
        let mut commits = 0;
        for (index, event) in all_events(client, &bake.id).into_iter().enumerate() {
            assert_eq!(event.seq, index as u64 + 1, "sequence without gaps");
            match event.event {
                EventKind::TaskDone { key, label, .. } => {
                    let count = self.commits.entry(key).or_default();
                    *count += 1;
                    commits += 1;
                    assert_eq!(*count, 1, "{label} was committed twice");
                }
                EventKind::LeaseExpired { .. } => self.expired += 1,
                EventKind::TaskFailed { blame: Blame::Lost, retry: true, .. } => self.lost += 1,
                EventKind::TaskFailed { .. } => panic!("nobody did anything wrong: {event:?}"),
                _ => (),
            }
        }
        assert_eq!(bake.tasks_run, commits, "{bake:?}");
        assert_eq!((bake.state, bake.attempts_failed, bake.alarms), (BakeState::Done, 0, 0), "{bake:?}");
        self.done += 1;
    }

    pub fn assert_told(&self, bakes: u64) {
        assert_eq!(self.done, bakes);
        assert!(self.commits.len() > 30, "a bake has many tasks, not {}", self.commits.len());
    }

    pub fn summary(&self) -> String {
        let Self { commits, done, expired, lost } = self;
        format!(
            "{} tasks, {done} bakes done, {expired} leases ran out, {lost} were told of by the next start",
            commits.len()
        )
    }
}

/// Events of a bake so far.
pub fn all_events(client: &ApiClient, bake: &str) -> Vec<BakeEvent> {
    let mut events: Vec<BakeEvent> = Vec::new();
    loop {
        let seen = events.last().map_or(0, |event| event.seq);
        let page = client.events(bake, seen, 0).unwrap();
        if page.events.is_empty() {
            return events;
        }
        events.extend(page.events);
    }
}

/// Counts that must be 0 once nothing is under way.
const NOUGHTS: [(&str, &str); 9] = [
    ("leases", "SELECT count(*) FROM leases"),
    ("ready tasks", "SELECT count(*) FROM ready"),
    ("tasks that are not done", "SELECT count(*) FROM tasks WHERE state <> 'done'"),
    ("open tasks of bakes that are done", "SELECT count(*) FROM bakes WHERE state = 'done' AND open_count <> 0"),
    ("leases that stages count", "SELECT count(*) FROM stages s JOIN bakes b ON b.seq = s.bake WHERE b.state = 'done' AND s.leased <> 0"),
    ("results without a task's state", "SELECT count(*) FROM tasks t FULL JOIN results r ON r.task = t.id WHERE t.id IS NULL OR r.task IS NULL"),
    (
        "chunks with a wrong count of references",
        "SELECT count(*) FROM chunks c WHERE refs <>
             (SELECT count(*) FROM result_chunks r WHERE r.digest = c.digest) +
             (SELECT count(*) FROM bake_chunks b WHERE b.digest = c.digest)",
    ),
    (
        "results whose bytes are lost",
        "SELECT count(*) FROM result_chunks r JOIN chunks c ON c.digest = r.digest WHERE c.generation IS NULL",
    ),
    (
        "sums that are wrong",
        "SELECT count(*) FROM storage_usage WHERE (chunks, bytes) <> (
             SELECT count(*), coalesce(sum(s.bytes), 0) FROM (
                 SELECT bytes FROM chunks WHERE generation IS NOT NULL UNION ALL SELECT bytes FROM condemned) s)",
    ),
];

/// Looks at what the farm has written down, with its own check and past it.
pub fn assert_books_are_right(troupe: &mut Troupe) {
    // A bake that failed leaves leases behind until their holders hear of it.
    let patience = Patience::new();
    for (what, sql) in NOUGHTS {
        patience.until(&format!("end of {what}"), || troupe.database.number(sql) == 0);
    }
    let attempts = troupe.database.number("SELECT max(attempts) FROM tasks");
    assert!(attempts < MAX_ATTEMPTS.into(), "a task is done after {attempts} failed attempts");
    let sql =
        "SELECT coalesce(max(workers), 0) FROM (SELECT count(*) AS workers FROM blames GROUP BY task) b";
    let workers = troupe.database.number(sql);
    assert!(workers < POISON_WORKERS.into(), "a task is done after {workers} workers failed at it");
    troupe.assert_alive();
    troupe.stop();
    let mut command = kiln(troupe.folder());
    command.envs(troupe.settings(false));
    // Bytes that were written and never taken in are young enough to be uploads under way.
    run(command, &["fsck"], 0);
}
