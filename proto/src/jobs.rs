//! The job graph: tasks, their inputs and their outputs (ARCHITECTURE.md: "A bake is a graph of tasks").
//!
//! The server stores and schedules tasks without reading `kind` or `params`; only workers know what they mean.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::ids::{Digest, TaskKey};

/// One unit of work. Pure: `key` determines every output byte.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskSpec {
    /// Digest of everything the result can depend on, see [`TaskSpec::new`]. A server computes it itself, and takes no other.
    pub key: TaskKey,
    /// Task kind, e.g. `prt.transport`; a worker claims only kinds that it knows. 1 to 400 bytes.
    #[schema(min_length = 1, max_length = 400)]
    pub kind: String,
    /// Version of the kind's code, which the key depends on. 0 stands for tasks from before it was told.
    #[serde(default)]
    #[schema(format = Int64, maximum = 4294967295_i64)]
    pub version: u32,
    /// For people and events, e.g. `cluster 12`. At most 400 bytes.
    #[schema(max_length = 400)]
    pub label: String,
    /// Parameters as JSON; only the worker reads them.
    pub params: serde_json::Value,
    /// Artefacts that it reads.
    pub inputs: Vec<TaskInput>,
    /// Estimated cost in thousands of rays or the like; bigger is claimed first among equals, and a task that waited for a
    /// bigger one right after it. At most 2^40.
    #[schema(maximum = 1099511627776_i64)]
    pub cost: u64,
    /// Name that it has in common with tasks whose results may stand for its own, as its runner finds by what they recorded: a
    /// worker is told of those. Not part of its identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alike: Option<Digest>,
}

/// Where a task's input comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case", tag = "from", deny_unknown_fields)]
pub enum TaskInput {
    /// A stored artefact that exists already.
    Artefact {
        /// Name under which the task sees it.
        name: String,
        /// Its digest.
        digest: Digest,
    },
    /// All outputs of another task of the same bake: a dependency. The task sees each as `name/output`.
    Task {
        /// Prefix under which the task sees them.
        name: String,
        /// Key of the other task.
        key: TaskKey,
    },
}

/// An artefact that a task gave.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Artefact {
    /// Name inside the task, e.g. `chunk/0`. The names [`MANIFEST_OUTPUT`] and [`REPORT_OUTPUT`] are the bake's results.
    pub name: String,
    /// Digest of the stored bytes.
    pub digest: Digest,
    /// Length of the stored bytes.
    pub bytes: u64,
}

/// Results of a finished task: artefacts already uploaded, more tasks, and counters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskResult {
    /// Outputs; a pure function of the task's key.
    pub outputs: Vec<Artefact>,
    /// Tasks to add to the bake; a pure function of the task's key. Order and dependencies inside the list are free.
    pub plan: Vec<TaskSpec>,
    /// Counters for people (rays, seconds, …), at most 256; not part of the result's identity.
    #[serde(default)]
    pub counters: std::collections::BTreeMap<String, f64>,
    /// Word for people about how the result came about, at most 400 bytes; not part of the result's identity.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    #[schema(max_length = 400)]
    pub note: String,
}

/// Longest note of a result, in bytes.
pub const MAX_NOTE_BYTES: usize = 400;
/// Most results of tasks alike that a lease tells of, newest first.
pub const MAX_ALIKE: usize = 4;

/// Most counters of one result.
pub const MAX_COUNTERS: usize = 256;
/// Longest name of a counter, in bytes.
pub const MAX_COUNTER_NAME_BYTES: usize = 200;
/// Largest counter, and the smallest with the sign turned: sums over a million tasks stay numbers that JSON can say.
pub const MAX_COUNTER: f64 = 1e18;

/// Name of the output that is the bake's manifest.
pub const MANIFEST_OUTPUT: &str = "manifest";
/// Name of the output that is the bake's report.
pub const REPORT_OUTPUT: &str = "report";
/// Most tasks that one plan may hold.
pub const MAX_PLAN_TASKS: usize = 1_000_000;

impl TaskSpec {
    /// Makes a task and its key: blake3 over kind, its code version, parameters and inputs.
    ///
    /// `version` rises whenever the code of `kind` gives other bytes for the same inputs.
    pub fn new(
        kind: &str,
        version: u32,
        label: impl Into<String>,
        params: serde_json::Value,
        inputs: Vec<TaskInput>,
        cost: u64,
    ) -> Self {
        let key = key_of(kind, version, &params, &inputs);
        Self { key, kind: kind.to_owned(), version, label: label.into(), params, inputs, cost, alike: None }
    }

    /// The key that a task of this kind, version, parameters and inputs has.
    pub fn computed_key(&self) -> TaskKey {
        key_of(&self.kind, self.version, &self.params, &self.inputs)
    }

    /// Whether its key is its own.
    pub fn has_its_key(&self) -> bool {
        self.key == self.computed_key()
    }

    /// The task with a name in common with others.
    #[must_use]
    pub fn alike(self, name: Digest) -> Self {
        Self { alike: Some(name), ..self }
    }

    /// Keys of the tasks that must be done before this one.
    pub fn dependencies(&self) -> impl Iterator<Item = TaskKey> + '_ {
        self.inputs.iter().filter_map(|input| match input {
            TaskInput::Task { key, .. } => Some(*key),
            TaskInput::Artefact { .. } => None,
        })
    }
}

/// As [`TaskSpec::new`] has it: the digest of a JSON object whose members are sorted, as are those of everything in it.
fn key_of(kind: &str, version: u32, params: &serde_json::Value, inputs: &[TaskInput]) -> TaskKey {
    // Written at once: a plan has up to a million tasks, and a task as many inputs. serde_json maps are sorted (no
    // `preserve_order`), so equal parameters give equal text.
    let inputs = inputs.iter().map(SortedInput::of).collect();
    let text = serde_json::to_vec(&Identity { inputs, kind, params, version });
    Digest::of(&text.expect("every value is one of JSON, and every map has text for keys"))
}

/// Everything that a key depends on, by the order of names.
#[derive(Serialize)]
struct Identity<'a> {
    inputs: Vec<SortedInput<'a>>,
    kind: &'a str,
    params: &'a serde_json::Value,
    version: u32,
}

/// [`TaskInput`] with its members in the order of their names.
#[derive(Serialize)]
#[serde(untagged)]
enum SortedInput<'a> {
    Artefact { digest: Digest, from: &'static str, name: &'a str },
    Task { from: &'static str, key: TaskKey, name: &'a str },
}

impl<'a> SortedInput<'a> {
    fn of(input: &'a TaskInput) -> Self {
        match input {
            TaskInput::Artefact { name, digest } => {
                Self::Artefact { digest: *digest, from: "artefact", name }
            }
            TaskInput::Task { name, key } => Self::Task { from: "task", key: *key, name },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(kind: &str, version: u32, rays: u32) -> TaskSpec {
        TaskSpec::new(kind, version, "any label", serde_json::json!({ "rays": rays }), Vec::new(), 1)
    }

    #[test]
    fn key_depends_on_kind_version_and_parameters_but_not_on_label_or_cost() {
        let base = task("a", 1, 2);
        assert_ne!(base.key, task("b", 1, 2).key);
        assert_ne!(base.key, task("a", 2, 2).key);
        assert_ne!(base.key, task("a", 1, 3).key);
        let relabelled = TaskSpec::new("a", 1, "other", serde_json::json!({ "rays": 2 }), Vec::new(), 9);
        assert_eq!(base.key, relabelled.key);
    }

    /// Farms have results under keys that were computed from values of JSON.
    #[test]
    fn key_is_that_of_the_sorted_json_of_all_it_depends_on() {
        let params = serde_json::json!({ "z": [1e-7, 0.1_f32, -1], "a": { "y": null, "b": "ä\"\n" } });
        let key = Digest::of(b"key");
        let inputs = vec![
            TaskInput::Artefact { name: "quote \" and ü".into(), digest: Digest::of(b"in") },
            TaskInput::Task { name: "of".into(), key },
        ];
        let identity =
            serde_json::json!({ "kind": "a\\b", "version": 7, "params": params, "inputs": inputs });
        let task = TaskSpec::new("a\\b", 7, "label", params, inputs, 1);
        assert_eq!(task.key, Digest::of(identity.to_string().as_bytes()));
    }

    /// A worker's plan arrives as text: the server must find the same keys.
    #[test]
    fn key_outlives_the_way_over_the_wire() {
        let numbers = [0.1_f32, 1.0, 1e-7, 3.4e38].map(f64::from);
        let more = [0.1_f64, 1.0 / 3.0, 1e300, 5e-324, 123_456_789.123_456_79];
        let params = serde_json::json!({
            "f32": 0.3_f32, "numbers": numbers, "more": more, "i": [i64::MIN, -1, 0], "u": u64::MAX, "text": "ä\"\u{1}"
        });
        let inputs = vec![TaskInput::Artefact { name: "in".into(), digest: Digest::of(b"in") }];
        let task = TaskSpec::new("a", 7, "label", params, inputs, 1);
        let text = serde_json::to_string(&task).unwrap();
        let arrived: TaskSpec = serde_json::from_str(&text).unwrap();
        assert_eq!(arrived, task);
        assert!(arrived.has_its_key());
        assert!(!TaskSpec { version: 8, ..arrived }.has_its_key());
    }
}
