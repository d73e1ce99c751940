//! One look at the farm for all who wait: which work there is, and how far bakes have come.

use super::codec::to_json;
use super::conn::{Conn, query};
use super::ledger::state_from;
use crate::store::{Look, Opening, Result, Standing};

/// Openings of running bakes: ready tasks are counted up to a number, which the index finds, stage by stage.
macro_rules! openings {
    ($ready:literal, $kind:literal) => {
        concat!(
            "SELECT x.kind, x.needs, CAST(sum(x.ready) AS BIGINT) AS ready FROM (
                 SELECT s.kind, b.needs, (SELECT count(*) FROM (
                     SELECT 1 FROM ",
            $ready,
            " WHERE r.bake = s.bake AND r.kind = ",
            $kind,
            " AND r.not_before_ms <= $1 LIMIT $2) AS counted) AS ready
                 FROM bakes b JOIN stages s ON s.bake = b.seq
                 WHERE b.state = 'running' AND s.total > s.done + s.leased) AS x
             WHERE x.ready > 0 GROUP BY x.kind, x.needs"
        )
    };
}

pub(super) async fn look(conn: &mut Conn, bakes: &[String], enough: u64) -> Result<Look> {
    // SQLite would take the index of all kinds. On PostgreSQL the two tables' kinds have two orders, of which a comparison takes one.
    let sql = conn.pick(
        openings!("ready r INDEXED BY ready_by_kind", "s.kind"),
        openings!("ready r", "s.kind COLLATE \"default\""),
    );
    let mut openings = Vec::new();
    for row in query(sql).bind(conn.now_ms).bind(enough).all(conn).await? {
        openings.push(Opening {
            kind: row.get("kind")?,
            needs: row.json("needs")?,
            ready: row.count("ready")?,
        });
    }
    Ok(Look { openings, standings: standings(conn, bakes).await? })
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
