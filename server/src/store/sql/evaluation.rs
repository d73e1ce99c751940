//! Evaluations attached to bakes: chunks that a bake holds beside those of its tasks.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;

use super::chunks;
use super::codec::{ROWS_PER_STATEMENT, to_json};
use super::conn::{Conn, query};
use super::ledger::{seq_of, state_from};
use crate::store::{Result, require_done};

/// Attaches an evaluation, and lets the chunks of the one before go.
pub(super) async fn set(conn: &mut Conn, id: &str, index: Digest, files: &BTreeSet<Digest>) -> Result<()> {
    let seq = seq_of(conn, id).await?;
    let state = query("SELECT state FROM bakes WHERE seq = $1").bind(seq).one(conn).await?.text("state")?;
    require_done(id, state_from(&state)?, "given an evaluation")?;
    let held: BTreeSet<Digest> = files.iter().copied().chain([index]).collect();
    let held: Vec<Digest> = held.into_iter().collect();
    chunks::require(conn, &held).await?;
    query("DELETE FROM evaluation_chunks WHERE bake = $1").bind(seq).run(conn).await?;
    for held in held.chunks(ROWS_PER_STATEMENT) {
        let sql = "INSERT INTO evaluation_chunks (bake, digest) SELECT $1, value FROM json_each($2)";
        query(sql).bind(seq).bind(to_json(held)?).run(conn).await?;
    }
    let sql = "UPDATE bakes SET evaluation = $1 WHERE seq = $2";
    query(sql).bind(index.to_string()).bind(seq).run(conn).await?;
    Ok(())
}
