//! Rows of a big plan, copied into PostgreSQL: for them no list is parsed there, and no row is looked up that is known to be new.

use std::fmt::Write as _;

use lightkiln_proto::jobs::TaskSpec;

use super::codec::to_json;
use super::conn::{Conn, query, to_column};
use crate::store::Result;

/// New tasks from which they are copied. Fewer go as lists: that is a round trip less.
pub(super) const COPIED_FROM: usize = 1_000;

/// Statement of the rows of [`push_task`].
pub(super) const TASKS: &str = "COPY tasks (id, key, kind, label, params, inputs, cost, alike, version, state, waiting_count, claim_cost) FROM STDIN";
/// Statement of the rows of [`push_ready`].
pub(super) const READY: &str = "COPY ready (bake, cost, key, task, kind, not_before_ms, since_ms) FROM STDIN";

/// Statement that adds new tasks to a bake.
pub(super) const MEMBERS: &str = "COPY bake_tasks (bake, task, done, reused) FROM STDIN";
/// Statement of edges of dependencies.
pub(super) const EDGES: &str = "COPY task_needs (task, needs) FROM STDIN";

/// Bytes of rows that are sent at a time. More → PostgreSQL waits longer for the first ones, and more memory.
const SENT_TOGETHER: usize = 1 << 18;

/// Time that a transaction gets for each task of a plan beside that of all transactions: twice the processor time of taking one in.
/// More → a server that hangs in the middle of a long plan holds up its bake for longer.
const MORE_US_PER_TASK: u64 = 100;
/// Shorter plans need no more time than all.
const LEAST_MORE_MS: u64 = 1_000;

/// A value of a row.
pub(super) enum Field<'a> {
    Int(i64),
    Text(&'a str),
    Nothing,
}

/// Rows as COPY reads them.
pub(super) struct Rows(String);

impl Rows {
    pub(super) fn push(&mut self, fields: &[Field<'_>]) {
        for (index, field) in fields.iter().enumerate() {
            if index > 0 {
                self.0.push('\t');
            }
            match field {
                // Never fails: a string takes all.
                Field::Int(value) => drop(write!(self.0, "{value}")),
                Field::Text(text) => self.push_text(text),
                Field::Nothing => self.0.push_str("\\N"),
            }
        }
        self.0.push('\n');
    }

    fn push_text(&mut self, text: &str) {
        let mut rest = text;
        // By bytes: these four are whole characters wherever they stand.
        let is_sign = |byte| matches!(byte, b'\\' | b'\t' | b'\n' | b'\r');
        while let Some(at) = rest.bytes().position(is_sign) {
            self.0.push_str(&rest[..at]);
            self.0.push_str(match rest.as_bytes()[at] {
                b'\t' => "\\t",
                b'\n' => "\\n",
                b'\r' => "\\r",
                _ => "\\\\",
            });
            rest = &rest[at + 1..];
        }
        self.0.push_str(rest);
    }
}

/// Copies the row that `push` makes of each item. Rows are made while PostgreSQL takes in those before.
pub(super) async fn copy<T: Sync>(
    conn: &mut Conn,
    sql: &'static str,
    items: &[T],
    push: impl Fn(&mut Rows, &T) -> Result<()> + Send,
) -> Result<()> {
    if items.is_empty() {
        return Ok(());
    }
    let mut copying = conn.copy(sql).await?;
    let mut at = 0;
    while at < items.len() {
        let mut rows = Rows(String::with_capacity(SENT_TOGETHER));
        while at < items.len() && rows.0.len() < SENT_TOGETHER {
            if let Err(error) = push(&mut rows, &items[at]) {
                copying.abort("a row cannot be written").await?;
                return Err(error);
            }
            at += 1;
        }
        copying.send(rows.0.into_bytes()).await?;
    }
    copying.finish().await?;
    Ok(())
}

/// Lets this transaction pause and run statements for longer, as a plan of so many tasks asks for.
pub(super) async fn take_time(conn: &mut Conn, tasks: usize) -> Result<()> {
    let more_ms = tasks as u64 * MORE_US_PER_TASK / 1000;
    if more_ms < LEAST_MORE_MS || conn.pick(true, false) {
        return Ok(());
    }
    let sql = "SELECT set_config(n.name, CAST(s.setting AS BIGINT) + $1 || 'ms', true)
               FROM (VALUES ('idle_in_transaction_session_timeout'), ('statement_timeout')) AS n (name)
               JOIN pg_settings s ON s.name = n.name";
    query(sql).bind(more_ms).all(conn).await?;
    Ok(())
}

/// Numbers for new tasks.
pub(super) async fn task_ids(conn: &mut Conn, count: usize) -> Result<Vec<i64>> {
    // In one row, and the sequence is looked up once: either for each number costs more than the number.
    let sql = "SELECT CAST(coalesce(json_agg(n.id), '[]') AS TEXT) AS ids
               FROM (SELECT nextval((SELECT CAST(pg_get_serial_sequence('tasks', 'id') AS regclass))) AS id
                     FROM generate_series(1, $1)) AS n";
    query(sql).bind(count).one(conn).await?.json("ids")
}

/// State of a new task, dependencies that it waits for, and the cost that it is claimed by where that is not its own.
pub(super) struct Standing {
    pub(super) state: &'static str,
    pub(super) waiting_count: usize,
    pub(super) claim_cost: Option<u64>,
}

/// Adds the row of a task.
pub(super) fn push_task(rows: &mut Rows, id: i64, spec: &TaskSpec, standing: &Standing) -> Result<()> {
    let alike = spec.alike.map(|alike| alike.to_string());
    let number = |count: u64| Field::Int(to_column(count));
    rows.push(&[
        Field::Int(id),
        Field::Text(&spec.key.to_string()),
        Field::Text(&spec.kind),
        Field::Text(&spec.label),
        Field::Text(&to_json(&spec.params)?),
        Field::Text(&to_json(&spec.inputs)?),
        number(spec.cost),
        alike.as_deref().map_or(Field::Nothing, Field::Text),
        number(spec.version.into()),
        Field::Text(standing.state),
        number(standing.waiting_count as u64),
        standing.claim_cost.map_or(Field::Nothing, number),
    ]);
    Ok(())
}

/// Offers a task in the bake that holds it, each by its number.
pub(super) fn push_ready(rows: &mut Rows, (bake, task): (i64, i64), spec: &TaskSpec, cost: u64, now_ms: i64) {
    let (cost, key) = (Field::Int(to_column(cost)), spec.key.to_string());
    let (key, task, kind) = (Field::Text(&key), Field::Int(task), Field::Text(&spec.kind));
    rows.push(&[Field::Int(bake), cost, key, task, kind, Field::Int(0), Field::Int(now_ms)]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_keep_what_copy_would_take_for_an_end_or_a_sign() {
        let mut rows = Rows(String::new());
        rows.push(&[Field::Int(-1), Field::Text("a\tb\\N\nc\r"), Field::Nothing, Field::Text("")]);
        rows.push(&[Field::Text("\\."), Field::Text("ü")]);
        assert_eq!(rows.0, "-1\ta\\tb\\\\N\\nc\\r\t\\N\t\n\\\\.\tü\n");
    }
}
