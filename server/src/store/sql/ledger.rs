//! A bake's own row while a transaction changes it, and the end of a bake.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::api::{BakeState, EventKind};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, MANIFEST_OUTPUT, REPORT_OUTPUT};
use serde_json::json;

use super::codec::to_json;
use super::conn::{Conn, Row, corrupt, query, steps, together};
use super::patience::Locked;
use super::remake;
use crate::store::{Result, StoreError};

/// The part of a bake's row that changes, and events not yet written.
pub(super) struct Ledger {
    pub(super) seq: i64,
    pub(super) id: String,
    pub(super) state: BakeState,
    /// Share of its results that are verified.
    pub(super) verify_share: f64,
    pub(super) open_count: u64,
    pub(super) tasks_run: u64,
    pub(super) tasks_reused: u64,
    pub(super) counters: BTreeMap<String, f64>,
    pub(super) counters_reused: BTreeMap<String, f64>,
    manifest: Option<Digest>,
    report: Option<Digest>,
    failure: Option<String>,
    finished_ms: Option<i64>,
    last_event: u64,
    last_place: u64,
    events: Vec<EventKind>,
}

/// Rows of bakes as [`Ledger::read`] takes them.
macro_rules! ledgers {
    ($of:expr) => {
        concat!(
            "SELECT b.seq, b.id, b.state, b.open_count, b.tasks_run, b.tasks_reused, b.counters, b.counters_reused,
             b.manifest, b.report, b.failure, b.finished_ms, b.last_event, b.last_place, b.verify_share
             FROM bakes b ",
            $of
        )
    };
}

macro_rules! locked_ledgers {
    ($end:literal) => {
        ledgers!(concat!(
            "WHERE b.seq = ANY (ARRAY(SELECT CAST(value AS BIGINT) FROM json_each($1)))
             AND b.state || '' IN ('running', 'paused') ORDER BY b.seq FOR NO KEY UPDATE OF b",
            $end
        ))
    };
}

/// Reads a state's name.
pub(super) fn state_from(name: &str) -> Result<BakeState> {
    BakeState::named(name).ok_or_else(|| corrupt("a bake's state", format!("'{name}' is no state")))
}

/// Row number of the bake named `id`.
pub(super) async fn seq_of(conn: &mut Conn, id: &str) -> Result<i64> {
    let seq = query("SELECT seq FROM bakes WHERE id = $1").bind(id).optional(conn).await?;
    seq.ok_or_else(|| StoreError::NoSuchBake { bake: id.to_owned() })?.get("seq")
}

impl Ledger {
    pub(super) async fn load(conn: &mut Conn, seq: i64) -> Result<Self> {
        Self::read(&query(ledgers!("WHERE b.seq = $1")).bind(seq).one(conn).await?)
    }

    /// Live bakes that hold a task, oldest first. A change of one of them leaves the others' rows as they are.
    pub(super) async fn live_of(conn: &mut Conn, task: i64) -> Result<Vec<Self>> {
        let sql = ledgers!(
            "JOIN bake_tasks m ON m.bake = b.seq WHERE m.task = $1 AND b.state || '' IN ('running', 'paused') ORDER BY b.seq"
        );
        query(sql).bind(task).all(conn).await?.iter().map(Self::read).collect()
    }

    /// Those of some bakes that are live, oldest first; without those that somebody else has locked, if these are left. Until the
    /// transaction ends, nobody else changes them.
    pub(super) async fn lock(conn: &mut Conn, bakes: &BTreeSet<i64>, locked: Locked) -> Result<Vec<Self>> {
        if bakes.is_empty() {
            return Ok(Vec::new());
        }
        let of_list = ledgers!(
            "WHERE b.seq IN (SELECT value FROM json_each($1)) AND b.state || '' IN ('running', 'paused') ORDER BY b.seq"
        );
        let sql = match locked {
            Locked::AreWaitedFor => locked_ledgers!(""),
            Locked::AreLeft => locked_ledgers!(" SKIP LOCKED"),
        };
        let sql = conn.pick(of_list, sql);
        query(sql).bind(to_json(bakes)?).all(conn).await?.iter().map(Self::read).collect()
    }

    fn read(row: &Row) -> Result<Self> {
        Ok(Self {
            seq: row.get("seq")?,
            id: row.get("id")?,
            state: state_from(&row.text("state")?)?,
            verify_share: row.get("verify_share")?,
            open_count: row.count("open_count")?,
            tasks_run: row.count("tasks_run")?,
            tasks_reused: row.count("tasks_reused")?,
            counters: row.json("counters")?,
            counters_reused: row.json("counters_reused")?,
            manifest: row.digest_if_any("manifest")?,
            report: row.digest_if_any("report")?,
            failure: row.get("failure")?,
            finished_ms: row.get("finished_ms")?,
            last_event: row.count("last_event")?,
            last_place: row.count("last_place")?,
            events: Vec::new(),
        })
    }

    pub(super) fn event(&mut self, event: EventKind) {
        self.events.push(event);
    }

    /// The place of a result that lands now.
    pub(super) fn next_place(&mut self) -> u64 {
        self.last_place += 1;
        self.last_place
    }

    pub(super) fn note_outputs(&mut self, outputs: &[Artefact]) {
        for output in outputs {
            match output.name.as_str() {
                MANIFEST_OUTPUT => self.manifest = Some(output.digest),
                REPORT_OUTPUT => self.report = Some(output.digest),
                _ => (),
            }
        }
    }

    /// Writes the row and the events.
    pub(super) async fn save(&mut self, conn: &mut Conn) -> Result<()> {
        let mut events = Vec::with_capacity(self.events.len());
        for event in std::mem::take(&mut self.events) {
            self.last_event += 1;
            events.push(json!([self.last_event, conn.now_ms, to_json(&event)?]));
        }
        let insert = conn.pick(
            "INSERT INTO events (bake, seq, at_ms, event) SELECT $12, value ->> 0, value ->> 1, value ->> 2 FROM json_each($13)",
            "INSERT INTO events (bake, seq, at_ms, event) SELECT $12, (v ->> 0)::bigint, (v ->> 1)::bigint, v ->> 2
             FROM jsonb_array_elements($13::jsonb) AS j (v)",
        );
        let update =
            "UPDATE bakes SET state = $1, open_count = $2, tasks_run = $3, tasks_reused = $4, counters = $5,
                      counters_reused = $6, manifest = $7, report = $8, failure = $9, finished_ms = $10,
                      last_event = $11, last_place = $14 WHERE seq = $12";
        together([insert, update])
            .bind(self.state.name())
            .bind(self.open_count)
            .bind(self.tasks_run)
            .bind(self.tasks_reused)
            .bind(to_json(&self.counters)?)
            .bind(to_json(&self.counters_reused)?)
            .bind(self.manifest.map(|digest| digest.to_string()))
            .bind(self.report.map(|digest| digest.to_string()))
            .bind(&self.failure)
            .bind(self.finished_ms)
            .bind(self.last_event)
            .bind(self.seq)
            .bind(to_json(&events)?)
            .bind(self.last_place)
            .run(conn)
            .await?;
        Ok(())
    }

    /// Saves, and ends the bake if no task is open.
    pub(super) async fn save_or_finish(&mut self, conn: &mut Conn) -> Result<()> {
        if self.open_count == 0 {
            self.close(conn, BakeState::Done, None).await
        } else {
            self.save(conn).await
        }
    }

    /// Ends the bake and drops tasks that no other live bake wants.
    pub(super) async fn close(
        &mut self,
        conn: &mut Conn,
        state: BakeState,
        failure: Option<String>,
    ) -> Result<()> {
        self.state = state;
        self.failure = failure;
        self.finished_ms = Some(conn.now_ms);
        self.event(EventKind::State { state });
        self.save(conn).await?;
        remake::let_go(conn, self.seq).await?;
        // Verify no results of a bake that nobody wants any more, and hold none back of one that ended while it was paused.
        let reruns = match state {
            BakeState::Done => "UPDATE reruns SET is_paused = 0 WHERE bake = $1 AND is_paused = 1",
            _ => "DELETE FROM reruns WHERE bake = $1",
        };
        query(reruns).bind(self.seq).run(conn).await?;
        steps([
            "DELETE FROM ready WHERE bake = $1",
            "UPDATE stages SET leased = 0 WHERE bake = $1",
            "DELETE FROM tasks WHERE id IN (SELECT task FROM bake_tasks WHERE bake = $1 AND done = 0)
             AND NOT EXISTS (SELECT 1 FROM bake_tasks o JOIN bakes b ON b.seq = o.bake
                             WHERE o.task = tasks.id AND b.state IN ('running', 'paused'))",
            "DELETE FROM bake_tasks WHERE bake = $1 AND done = 0",
        ])
        .bind(self.seq)
        .run(conn)
        .await?;
        Ok(())
    }
}
