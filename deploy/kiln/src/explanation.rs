//! Explanation of a bake: the tasks that ran, and why, told from its events.

use std::collections::BTreeMap;

use lightkiln_client::fetch::ApiClient;
use lightkiln_proto::api::{BakeEvent, EventKind};

use crate::failure::Result;

/// The explanation of a bake that has ended, in lines.
///
/// Errors when its events cannot be read.
pub fn explanation(client: &ApiClient, id: &str) -> Result<String> {
    let (mut events, mut after): (Vec<BakeEvent>, u64) = (Vec::new(), 0);
    loop {
        let page = client.events(id, after, 0)?;
        let Some(last) = page.events.last() else { return Ok(words(&events)) };
        after = last.seq;
        events.extend(page.events);
    }
}

/// A line for each task that was looked at, by kind in the order of their ends, and one for those that were not.
fn words(events: &[BakeEvent]) -> String {
    let (mut known, mut order, mut lines) = (0, Vec::new(), BTreeMap::<&str, Vec<String>>::new());
    for event in events {
        match &event.event {
            EventKind::Planned { reused, .. } => known += reused,
            EventKind::TaskDone { kind, label, note, .. } => {
                if !order.contains(&kind.as_str()) {
                    order.push(kind);
                }
                let note = if note.is_empty() { "run, as something that it reads is new" } else { note };
                lines.entry(kind).or_default().push(format!("  {label}: {note}\n"));
            }
            _ => (),
        }
    }
    let mut words = String::new();
    for kind in order {
        words.push_str(&format!("{kind}\n{}", lines[kind].concat()));
    }
    words.push_str(&format!("{known} tasks not looked at, as all that they read was there before\n"));
    words
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::ids::Digest;

    use super::*;

    #[test]
    fn tasks_are_told_by_kind_with_their_notes_and_known_ones_are_counted() {
        let done = |kind: &str, label: &str, note: &str| EventKind::TaskDone {
            key: Digest::of(label.as_bytes()),
            kind: kind.into(),
            label: label.into(),
            worker: "w".into(),
            attempt: 1,
            elapsed_ms: 5,
            note: note.into(),
        };
        let events = [
            EventKind::Planned { tasks: 5, reused: 2 },
            done("scene.import", "scene", ""),
            done("prt.transport", "cluster a", "as before"),
            done("prt.colour", "cluster a", ""),
            done("prt.transport", "cluster b", "9 receivers traced"),
        ];
        let events: Vec<BakeEvent> =
            (1..).zip(events).map(|(seq, event)| BakeEvent { seq, at_ms: 0, event }).collect();
        let wanted = "scene.import\n  scene: run, as something that it reads is new\n\
                      prt.transport\n  cluster a: as before\n  cluster b: 9 receivers traced\n\
                      prt.colour\n  cluster a: run, as something that it reads is new\n\
                      2 tasks not looked at, as all that they read was there before\n";
        assert_eq!(words(&events), wanted);
    }
}
