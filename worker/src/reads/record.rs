//! The record that a task leaves of what it read, and how a later stage compares with it.

use lightkiln_proto::ids::Digest;
use serde::{Deserialize, Serialize};

use super::marks::{Bytes, Mark, Name, Part};
use super::patches;
use super::stage::Stage;
use crate::patches::PatchTree;
use crate::task::{TaskError, artefact};

/// Magic of a record's artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKrr";
/// Name of a record among a task's outputs.
pub const RECORD_ARTEFACT: &str = "record";
/// Most names of a record: who read more leaves none, and is run again.
const NAMES_MAX: usize = 1 << 16;

/// All that a task read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Ascending names, each as the distance from the one before.
    steps: Vec<u64>,
    /// Two bytes of each part's digest: they tell which have changed.
    checks: Vec<u16>,
    /// Digest of all parts' digests: it tells whether any has.
    digest: Digest,
}

impl Record {
    /// Of what a task's rays read, each name once, and of its cut over hits on some `leaves`, ascending. `None` if they are too
    /// many.
    pub fn of(
        stage: &Stage,
        tree: &PatchTree,
        read: &[Name],
        leaves: &[u32],
        by_share: &[u32],
    ) -> Option<Self> {
        let mut names = read.to_vec();
        names.extend(patches::read(tree, leaves, by_share));
        names.sort_unstable();
        names.dedup();
        if names.len() > NAMES_MAX {
            return None;
        }
        let marks: Vec<Mark> = names.iter().map(|name| stage.mark(*name)).collect();
        let before = std::iter::once(0).chain(names.iter().map(|name| name.0));
        let steps = names.iter().zip(before).map(|(name, before)| name.0 - before).collect();
        Some(Self { steps, checks: marks.iter().map(check).collect(), digest: digest(&marks) })
    }

    /// The record as an artefact.
    pub fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(ARTEFACT_MAGIC, self)
    }

    /// A record from its artefact. Errs where names do not ascend.
    pub fn decoded(bytes: &[u8]) -> Result<Self, TaskError> {
        let record: Self = artefact::decode(ARTEFACT_MAGIC, bytes)?.0;
        let ascend = record.steps.iter().skip(1).all(|step| *step > 0)
            && record.steps.iter().try_fold(0_u64, |name, step| name.checked_add(*step)).is_some();
        if ascend && record.checks.len() == record.steps.len() {
            return Ok(record);
        }
        Err(TaskError::bad_input("a record's names do not ascend, or have other checks"))
    }

    /// Names of what was read.
    pub fn names(&self) -> impl Iterator<Item = Name> + '_ {
        self.steps.iter().scan(0_u64, |name, step| {
            *name += *step;
            Some(Name(*name))
        })
    }

    /// Names of what rays read, ascending; the rest is what the cut read.
    pub fn names_of_rays(&self) -> Vec<Name> {
        self.names().filter(|name| matches!(name.part(), Part::Cell | Part::Tile | Part::Extent)).collect()
    }

    /// Changes of a stage since, as far as the task read it.
    pub fn changes(&self, stage: &Stage) -> Changes {
        let marks: Vec<Mark> = self.names().map(|name| stage.mark(name)).collect();
        if digest(&marks) == self.digest {
            return Changes::default();
        }
        let changed =
            self.names().zip(&marks).zip(&self.checks).filter(|((_, mark), before)| check(mark) != **before);
        let mut changes = Changes { any: true, ..Changes::default() };
        for ((name, _), _) in changed {
            changes.first.get_or_insert_with(|| name.words(stage.grid.cell_m));
            match name.part() {
                Part::Cell | Part::Extent => changes.cells += 1,
                Part::Tile => changes.tiles += 1,
                Part::Branch | Part::Shape | Part::Shares => changes.patches += 1,
            }
        }
        changes
    }
}

/// Parts of a stage that are other than a record has them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Changes {
    /// There are some.
    pub any: bool,
    /// Cells of space, and the scene's extent.
    pub cells: usize,
    /// Tiles of the lightmap.
    pub tiles: usize,
    /// Parts of the tree of patches.
    pub patches: usize,
    /// One of them, in words.
    pub first: Option<String>,
}

fn check(mark: &Mark) -> u16 {
    u16::from_le_bytes([mark[0], mark[1]])
}

fn digest(marks: &[Mark]) -> Digest {
    let mut bytes = Bytes::default();
    marks.iter().for_each(|mark| {
        bytes.bytes(mark);
    });
    bytes.digest()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_whose_names_do_not_ascend_is_refused() {
        let decoded = |steps: &[u64], checks: usize| {
            let digest = Digest::of(b"marks");
            let record = Record { steps: steps.to_vec(), checks: vec![0; checks], digest };
            Record::decoded(&record.encoded().unwrap()).map(|record| record.names().count())
        };
        assert_eq!(decoded(&[0, 3, 1], 3).unwrap(), 3);
        assert_eq!(decoded(&[], 0).unwrap(), 0);
        for (steps, checks) in [(&[4, 0][..], 2), (&[1, u64::MAX], 2), (&[1, 2], 1)] {
            assert!(decoded(steps, checks).is_err(), "{steps:?}, {checks} checks");
        }
    }
}
