//! Values as columns have them: digests in hex, lists and maps as JSON.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::conn::{Row, corrupt};
use crate::store::Result;

/// Rows that one statement takes in as a JSON array.
pub(super) const ROWS_PER_STATEMENT: usize = 2_000;

/// JSON of a value for a column.
pub(super) fn to_json<T: Serialize + ?Sized>(value: &T) -> Result<String> {
    serde_json::to_string(value).map_err(|error| corrupt("a value cannot be written as JSON", error))
}

impl Row {
    /// A column of JSON.
    pub(super) fn json<T: DeserializeOwned>(&self, column: &str) -> Result<T> {
        let text = self.text(column)?;
        serde_json::from_str(&text).map_err(|error| corrupt(&format!("column {column}"), error))
    }

    /// A digest column.
    pub(super) fn digest(&self, column: &str) -> Result<Digest> {
        digest(&self.text(column)?)
    }

    /// A digest column that may be empty.
    pub(super) fn digest_if_any(&self, column: &str) -> Result<Option<Digest>> {
        self.get::<Option<String>>(column)?.as_deref().map(digest).transpose()
    }

    /// A task, of the columns of `tasks` that say what it is.
    pub(super) fn task(&self) -> Result<TaskSpec> {
        Ok(TaskSpec {
            key: self.digest("key")?,
            kind: self.get("kind")?,
            version: self.small("version")?,
            label: self.get("label")?,
            params: self.json("params")?,
            inputs: self.json("inputs")?,
            cost: self.count("cost")?,
            alike: self.digest_if_any("alike")?,
        })
    }
}

fn digest(text: &str) -> Result<Digest> {
    text.parse().map_err(|error| corrupt("a digest", error))
}
