//! One look at the farm for all who wait: which work there is, and how far bakes have come.

use std::collections::{BTreeMap, BTreeSet};

use super::codec::to_json;
use super::conn::{Conn, query};
use super::ledger::state_from;
use super::reruns;
use crate::store::limits::room_for_workers;
use crate::store::{Look, Opening, Result, Room, Standing};

/// Openings of running bakes: ready tasks are counted up to a number, which the index finds, stage by stage.
macro_rules! openings {
    ($ready:literal, $kind:literal) => {
        concat!(
            "SELECT x.kind, x.needs, x.limited, max(x.max_workers) AS max_workers, CAST(sum(x.ready) AS BIGINT) AS ready FROM (
                 SELECT s.kind, b.needs, b.max_workers, CASE WHEN b.max_workers IS NULL THEN 0 ELSE b.seq END AS limited,
                 (SELECT count(*) FROM (
                     SELECT 1 FROM ",
            $ready,
            " WHERE r.bake = s.bake AND r.kind = ",
            $kind,
            " AND r.not_before_ms <= $1 LIMIT $2) AS counted) AS ready
                 FROM bakes b JOIN stages s ON s.bake = b.seq
                 WHERE b.state = 'running' AND s.total > s.done + s.leased) AS x
             WHERE x.ready > 0 GROUP BY x.kind, x.needs, x.limited"
        )
    };
}

pub(super) async fn look(conn: &mut Conn, bakes: &[String], enough: u64) -> Result<Look> {
    // SQLite would take the index of all kinds. On PostgreSQL the two tables' kinds have two orders, of which a comparison takes one.
    let sql = conn.pick(
        openings!("ready r INDEXED BY ready_by_kind", "s.kind"),
        openings!("ready r", "s.kind COLLATE \"default\""),
    );
    let (mut openings, mut limited) = (Vec::new(), Vec::new());
    for row in query(sql).bind(conn.now_ms).bind(enough).all(conn).await? {
        let max_workers = row.get::<Option<i64>>("max_workers")?;
        limited.push((row.get::<i64>("limited")?, max_workers.and_then(|most| u32::try_from(most).ok())));
        openings.push(Opening {
            kind: row.get("kind")?,
            needs: row.json("needs")?,
            ready: row.count("ready")?,
            room: None,
            maker: None,
        });
    }
    if limited.iter().any(|(_, max_workers)| max_workers.is_some()) {
        let holders = holders(conn, &limited).await?;
        for (opening, (bake, max_workers)) in openings.iter_mut().zip(limited) {
            let holders = holders.get(&bake).cloned().unwrap_or_default();
            let others = room_for_workers(max_workers, holders.len() as u64);
            opening.room = others.map(|others| Room { holders, others });
        }
    }
    // Behind tasks: whoever waits takes these first.
    if enough > 0 {
        openings.extend(reruns::openings(conn, enough).await?);
    }
    Ok(Look { openings, standings: standings(conn, bakes).await? })
}

/// Workers that hold tasks of bakes with a limit of workers, by bake.
async fn holders(conn: &mut Conn, limited: &[(i64, Option<u32>)]) -> Result<BTreeMap<i64, BTreeSet<String>>> {
    let bakes: BTreeSet<i64> = limited.iter().map(|(bake, _)| *bake).filter(|bake| *bake > 0).collect();
    let sql = "SELECT DISTINCT l.bake, l.worker FROM json_each($1) j JOIN leases l ON l.bake = CAST(j.value AS BIGINT)";
    let mut holders: BTreeMap<i64, BTreeSet<String>> = BTreeMap::new();
    for row in query(sql).bind(to_json(&bakes)?).all(conn).await? {
        holders.entry(row.get("bake")?).or_default().insert(row.get("worker")?);
    }
    Ok(holders)
}

async fn standings(conn: &mut Conn, bakes: &[String]) -> Result<Vec<Standing>> {
    if bakes.is_empty() {
        return Ok(Vec::new());
    }
    let sql = "SELECT b.id, b.state, b.last_event, b.last_place FROM json_each($1) j JOIN bakes b ON b.id = j.value";
    let mut standings = Vec::with_capacity(bakes.len());
    for row in query(sql).bind(to_json(bakes)?).all(conn).await? {
        let is_final = state_from(&row.text("state")?)?.is_final();
        let (last_event, last_place) = (row.count("last_event")?, row.count("last_place")?);
        standings.push(Standing { bake: row.get("id")?, is_final, last_event, last_place });
    }
    Ok(standings)
}

/// Notes that workers are there whose claims wait. Rows that somebody else writes are left: he says the same.
pub(super) async fn note_present(conn: &mut Conn, workers: &[String]) -> Result<()> {
    let sql = conn.pick(
        "UPDATE workers SET seen_ms = $1 WHERE name IN (SELECT value FROM json_each($2)) AND seen_ms < $1",
        "UPDATE workers SET seen_ms = $1 WHERE name IN (
             SELECT w.name FROM json_each($2) j JOIN workers w ON w.name = j.value AND w.seen_ms < $1
             FOR UPDATE OF w SKIP LOCKED)",
    );
    query(sql).bind(conn.now_ms).bind(to_json(workers)?).run(conn).await?;
    Ok(())
}
