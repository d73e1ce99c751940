//! Outputs of tasks that are done, as leases tell of them.

use std::collections::{BTreeMap, BTreeSet};

use lightkiln_proto::ids::{Digest, TaskKey};
use lightkiln_proto::jobs::{Artefact, MAX_ALIKE};

use super::codec::to_json;
use super::conn::{Conn, query};
use crate::store::Result;

/// Outputs of all that some tasks depend on.
pub(super) async fn outputs_of_needs(
    conn: &mut Conn,
    tasks: &str,
) -> Result<BTreeMap<TaskKey, Vec<Artefact>>> {
    // PostgreSQL goes from the tasks to their dependencies, whatever it believes of their numbers: another task may depend on one of them
    // with a hundred thousand others.
    let sql = conn.pick(
        "SELECT t.key, r.outputs FROM task_needs n JOIN tasks t ON t.id = n.needs
         JOIN results r ON r.task = t.id WHERE n.task IN (SELECT CAST(value AS BIGINT) FROM json_each($1))",
        "SELECT (SELECT t.key FROM tasks t WHERE t.id = d.needs) AS key,
         coalesce((SELECT r.outputs FROM results r WHERE r.task = d.needs), '[]') AS outputs
         FROM json_each($1) j CROSS JOIN LATERAL (
             SELECT n.needs FROM task_needs n WHERE n.task = CAST(j.value AS BIGINT) OFFSET 0) AS d",
    );
    let mut outputs = BTreeMap::new();
    for row in query(sql).bind(tasks).all(conn).await? {
        outputs.insert(row.digest("key")?, row.json("outputs")?);
    }
    Ok(outputs)
}

/// Outputs of the newest done tasks of each name.
pub(super) async fn outputs_of_alike(
    conn: &mut Conn,
    names: &BTreeSet<Digest>,
) -> Result<BTreeMap<Digest, Vec<Vec<Artefact>>>> {
    let sql = "SELECT n.alike, n.outputs FROM (
                   SELECT t.alike, r.outputs, row_number() OVER (PARTITION BY t.alike ORDER BY t.id DESC) AS place
                   FROM tasks t JOIN results r ON r.task = t.id
                   WHERE t.state = 'done' AND t.alike IN (SELECT value FROM json_each($1))) AS n
               WHERE n.place <= $2 ORDER BY n.alike, n.place";
    let mut outputs: BTreeMap<Digest, Vec<Vec<Artefact>>> = BTreeMap::new();
    for row in query(sql).bind(to_json(names)?).bind(MAX_ALIKE as i64).all(conn).await? {
        outputs.entry(row.digest("alike")?).or_default().push(row.json("outputs")?);
    }
    Ok(outputs)
}
