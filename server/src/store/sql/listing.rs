//! Lists of bakes: pages of those that a filter takes, and those whose ids begin alike.

use lightkiln_proto::api::{BakeFilter, BakePage, BakeState};

use super::conn::{Conn, query};
use super::ledger::state_from;
use super::view::{bake_from, bakes};
use crate::store::{Named, Result};

/// A page of bakes. A column that stands in an expression keeps its index out: whoever asks for states or for a time gets
/// the index of those, everybody else the bakes in the order of the list.
macro_rules! page {
    ($seq:literal, $state:literal, $created_ms:literal, $has_name:literal) => {
        concat!(
            bakes!(),
            " WHERE ",
            $seq,
            " < $1 AND ",
            $created_ms,
            " >= $3 AND ",
            $state,
            " IN ($5, $6, $7, $8, $9) AND ",
            $has_name,
            " ORDER BY ",
            $seq,
            " DESC LIMIT $2"
        )
    };
}

/// The statements of one database: for all times and states, for some states, and since a time.
macro_rules! pages {
    ($has_name:literal) => {
        [
            page!("seq", "state || ''", "created_ms + 0", $has_name),
            page!("seq", "state", "created_ms + 0", $has_name),
            page!("seq + 0", "state || ''", "created_ms", $has_name),
        ]
    };
}

/// `lower` of SQLite, and of PostgreSQL in the order of bytes, knows ASCII letters alone.
const SQLITE: [&str; 3] = pages!("instr(lower(name), lower($4)) > 0");
const POSTGRES: [&str; 3] = pages!("strpos(lower(name COLLATE \"C\"), lower($4 COLLATE \"C\")) > 0");

pub(super) async fn page(
    conn: &mut Conn,
    filter: &BakeFilter,
    after: Option<u64>,
    limit: u32,
) -> Result<BakePage> {
    let below = after.and_then(|after| i64::try_from(after).ok()).unwrap_or(i64::MAX);
    let has_states = !filter.states.is_empty();
    let which = match filter.since_ms {
        Some(_) => 2,
        None => usize::from(has_states),
    };
    let mut query = query(conn.pick(SQLITE[which], POSTGRES[which]))
        .bind(below)
        .bind(i64::from(limit) + 1)
        .bind(filter.since_ms.unwrap_or(i64::MIN))
        .bind(&filter.name);
    for state in BakeState::ALL {
        let is_wanted = !has_states || filter.states.contains(&state);
        query = query.bind(if is_wanted { state.name() } else { "" });
    }
    let rows = query.all(conn).await?;
    let has_more = rows.len() > limit as usize;
    let mut bakes = Vec::with_capacity(rows.len());
    let mut last = None;
    for row in rows.iter().take(limit as usize) {
        bakes.push(bake_from(conn, row).await?);
        last = Some(row.count("seq")?);
    }
    let next = last.filter(|_| has_more);
    Ok(BakePage { bakes, next })
}

pub(super) async fn begin_with(conn: &mut Conn, id: &str, limit: u32) -> Result<Vec<Named>> {
    // Ids are in hex: behind all that begin so comes the same beginning with the next letter, whatever the collation.
    let sql = "SELECT id, name, state FROM bakes WHERE id >= $1 AND id < $2 ORDER BY id LIMIT $3";
    let rows = query(sql).bind(id).bind(format!("{id}g")).bind(limit).all(conn).await?;
    let named = |row: &super::conn::Row| {
        Ok(Named { id: row.get("id")?, name: row.get("name")?, state: state_from(&row.text("state")?)? })
    };
    rows.iter().map(named).collect()
}
