//! An evaluation attached to a bake: the index that names its files.
//!
//! The index is stored as a chunk like the files. Its JSON has one form for the same files in the same order, so its digest names the
//! evaluation. [`FIGURES`], [`PICTURES`] and [`STILLS`] are the names that readers know.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use utoipa::ToSchema;

use crate::ids::Digest;

/// Name of the figures.
pub const FIGURES: &str = "evaluation.json";
/// Name of the list of pictures.
pub const PICTURES: &str = "pictures.json";
/// Name of the list of stills, for browsers without WebGPU.
pub const STILLS: &str = "stills.json";

/// Most files of an evaluation. More → a longer index, which is read with each file.
pub const MAX_EVALUATION_FILES: usize = 4096;
/// Most bytes of one file: 32 MiB.
pub const MAX_EVALUATION_FILE_BYTES: u64 = 32 << 20;
/// Most bytes of all files together: 1 GiB.
pub const MAX_EVALUATION_BYTES: u64 = 1 << 30;
/// Most characters of a file's name.
pub const MAX_EVALUATION_NAME_CHARS: usize = 64;

/// Types that files may have: none of them runs in a browser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub enum EvaluationMedia {
    /// Figures and lists.
    #[serde(rename = "application/json")]
    Json,
    /// Pictures.
    #[serde(rename = "image/png")]
    Png,
}

impl EvaluationMedia {
    /// The media type.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Png => "image/png",
        }
    }

    /// Ending of names of such files.
    fn ending(self) -> &'static str {
        match self {
            Self::Json => ".json",
            Self::Png => ".png",
        }
    }
}

/// A file of an evaluation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationFile {
    /// Name: parts of lower-case letters, digits and `-`, with `/` between them, and the ending of its type.
    #[schema(max_length = 64, pattern = "^[a-z0-9-]+(/[a-z0-9-]+)*\\.(json|png)$")]
    pub name: String,
    /// Its type.
    pub media_type: EvaluationMedia,
    /// Digest of its bytes.
    pub digest: Digest,
    /// Its length, 1..=33554432.
    #[schema(minimum = 1, maximum = 33554432)]
    pub bytes: u64,
}

/// The files of an evaluation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationIndex {
    /// 1 to 4096 of them, the figures (`evaluation.json`) among them; no name comes twice, and no digest with two types.
    #[schema(min_items = 1, max_items = 4096)]
    pub files: Vec<EvaluationFile>,
}

/// Why an index is refused.
#[derive(Debug, PartialEq, Eq, Error)]
pub enum EvaluationError {
    /// Too many files.
    #[error("the evaluation has {files} files; at most {MAX_EVALUATION_FILES} are taken")]
    TooMany {
        /// Their number.
        files: usize,
    },
    /// Too many bytes.
    #[error(
        "the evaluation has {bytes} bytes; at most {MAX_EVALUATION_BYTES} are taken: draw smaller or fewer pictures"
    )]
    TooLarge {
        /// Their sum.
        bytes: u64,
    },
    /// A file of no bytes, or of too many.
    #[error("file '{name}' has {bytes} bytes; 1 to {MAX_EVALUATION_FILE_BYTES} are taken")]
    Length {
        /// The file.
        name: String,
        /// Its length.
        bytes: u64,
    },
    /// A name that no file may have.
    #[error(
        "file '{name}' must have at most {MAX_EVALUATION_NAME_CHARS} characters: lower-case letters, digits and '-', with '/' between \
         parts, and the ending '{ending}'"
    )]
    Name {
        /// The name's beginning.
        name: String,
        /// The ending of its type.
        ending: &'static str,
    },
    /// A file that is named twice.
    #[error("file '{name}' comes twice, or its bytes come with another type or length")]
    Twice {
        /// The file.
        name: String,
    },
    /// No figures.
    #[error("the evaluation has no file '{FIGURES}'")]
    NoFigures,
}

impl EvaluationIndex {
    /// Checks counts, lengths, names and types.
    pub fn check(&self) -> Result<(), EvaluationError> {
        if self.files.len() > MAX_EVALUATION_FILES {
            return Err(EvaluationError::TooMany { files: self.files.len() });
        }
        let (mut names, mut seen) = (BTreeSet::new(), std::collections::BTreeMap::new());
        let mut bytes = 0_u64;
        for file in &self.files {
            file.check()?;
            let same = seen.entry(file.digest).or_insert((file.media_type, file.bytes));
            if !names.insert(&file.name) || *same != (file.media_type, file.bytes) {
                return Err(EvaluationError::Twice { name: file.name.clone() });
            }
            bytes += file.bytes;
        }
        if bytes > MAX_EVALUATION_BYTES {
            return Err(EvaluationError::TooLarge { bytes });
        }
        let has_figures = self.files.iter().any(|file| file.name == FIGURES);
        if has_figures { Ok(()) } else { Err(EvaluationError::NoFigures) }
    }

    /// The file of those bytes.
    pub fn file(&self, digest: Digest) -> Option<&EvaluationFile> {
        self.files.iter().find(|file| file.digest == digest)
    }
}

impl EvaluationFile {
    fn check(&self) -> Result<(), EvaluationError> {
        let ending = self.media_type.ending();
        let is_known = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-';
        let is_part = |part: &str| !part.is_empty() && part.bytes().all(is_known);
        let is_name = self.name.strip_suffix(ending).is_some_and(|stem| stem.split('/').all(is_part));
        if !is_name || self.name.len() > MAX_EVALUATION_NAME_CHARS {
            let name = self.name.chars().take(MAX_EVALUATION_NAME_CHARS).collect();
            return Err(EvaluationError::Name { name, ending });
        }
        if !(1..=MAX_EVALUATION_FILE_BYTES).contains(&self.bytes) {
            return Err(EvaluationError::Length { name: self.name.clone(), bytes: self.bytes });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, media_type: EvaluationMedia) -> EvaluationFile {
        EvaluationFile { name: name.into(), media_type, digest: Digest::of(name.as_bytes()), bytes: 5 }
    }

    fn with(files: impl IntoIterator<Item = EvaluationFile>) -> EvaluationIndex {
        let figures = file(FIGURES, EvaluationMedia::Json);
        EvaluationIndex { files: [figures].into_iter().chain(files).collect() }
    }

    #[test]
    fn index_keeps_to_its_limits() {
        use EvaluationMedia::{Json, Png};
        with([file("pictures/0-1.png", Png), file(PICTURES, Json)]).check().unwrap();
        assert_eq!(EvaluationIndex::default().check(), Err(EvaluationError::NoFigures));
        let long = format!("{}.png", "x".repeat(MAX_EVALUATION_NAME_CHARS));
        for (name, media) in [
            ("../a.png", Png),
            ("/a.png", Png),
            ("a//b.png", Png),
            (".png", Png),
            ("A.png", Png),
            ("a.html", Png),
            ("a.png", Json),
            (&long, Png),
        ] {
            let refused = with([file(name, media)]).check();
            assert!(matches!(refused, Err(EvaluationError::Name { .. })), "{name}: {refused:?}");
        }
        for bytes in [0, MAX_EVALUATION_FILE_BYTES + 1, u64::MAX] {
            let refused = with([EvaluationFile { bytes, ..file("a.png", Png) }]).check();
            assert!(matches!(refused, Err(EvaluationError::Length { .. })), "{refused:?}");
        }
        let other_type = EvaluationFile { digest: Digest::of(FIGURES.as_bytes()), ..file("a.png", Png) };
        for twice in [file(FIGURES, Json), other_type] {
            assert!(matches!(with([twice]).check(), Err(EvaluationError::Twice { .. })));
        }
        let many = |count: usize, bytes| {
            (0..count).map(move |n| EvaluationFile { bytes, ..file(&format!("{n}.png"), Png) })
        };
        assert!(matches!(with(many(MAX_EVALUATION_FILES, 5)).check(), Err(EvaluationError::TooMany { .. })));
        let largest = with(many(32, MAX_EVALUATION_FILE_BYTES));
        assert!(matches!(largest.check(), Err(EvaluationError::TooLarge { .. })));
    }
}
