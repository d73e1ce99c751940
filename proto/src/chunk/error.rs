//! Faults of a chunk, or of content that is to become one.

use thiserror::Error;

use crate::ids::Digest;

/// Why bytes are not a chunk, or values cannot be put into one. Nothing is decoded in part: an error means nothing.
#[derive(Debug, Error)]
pub enum ChunkError {
    /// Fewer bytes than something needs.
    #[error("{section}: {what} needs {wanted} bytes at offset {offset}, {left} are left")]
    Truncated {
        /// Part of the chunk.
        section: &'static str,
        /// Field.
        what: &'static str,
        /// Offset from the start of the part (of the chunk, for its header).
        offset: usize,
        /// Bytes needed.
        wanted: u64,
        /// Bytes there.
        left: u64,
    },
    /// More bytes than there should be.
    #[error("{section}: {extra} bytes are left over at offset {offset}")]
    Trailing {
        /// Part of the chunk.
        section: &'static str,
        /// Offset of the first of them.
        offset: usize,
        /// How many.
        extra: u64,
    },
    /// Not a chunk at all.
    #[error("the bytes start with {found:02x?}, which is not a chunk")]
    Magic {
        /// First four bytes.
        found: [u8; 4],
    },
    /// A version that this code does not read.
    #[error("chunk version {found} is not known; a newer kiln may read it")]
    Version {
        /// Version in the header.
        found: u16,
    },
    /// A kind that no row of the table of chunk kinds has.
    #[error("chunk kind {found} is not known; a newer kiln may read it")]
    UnknownKind {
        /// Kind in the header.
        found: u8,
    },
    /// A chunk of another kind.
    #[error("the chunk is of kind {found}, wanted {wanted}")]
    Kind {
        /// Kind asked for.
        wanted: u8,
        /// Kind in the header.
        found: u8,
    },
    /// A count, an index or a length outside its range.
    #[error("{section}: {what} is {value}, allowed is {min}..={max}")]
    OutOfRange {
        /// Part of the chunk.
        section: &'static str,
        /// Field.
        what: &'static str,
        /// Value found.
        value: u64,
        /// Smallest allowed.
        min: u64,
        /// Largest allowed.
        max: u64,
    },
    /// A number that is not finite, or not in the range of its quantity.
    #[error("{section}: {what} number {index} is {value}, wanted {wanted}")]
    BadNumber {
        /// Part of the chunk.
        section: &'static str,
        /// Quantity.
        what: &'static str,
        /// Index in its array.
        index: usize,
        /// Value found.
        value: f32,
        /// Allowed values.
        wanted: &'static str,
    },
    /// A section is missing, twice there or before one that it builds on.
    #[error("section {tag} {part:?} is {problem}")]
    Section {
        /// Tag.
        tag: u8,
        /// Part numbers.
        part: [u8; 3],
        /// `missing`, `repeated`, `out of order` or `unknown`.
        problem: &'static str,
    },
    /// Two entries that must ascend do not.
    #[error("{section}: {what} number {index} does not ascend")]
    Order {
        /// Part of the chunk.
        section: &'static str,
        /// Array.
        what: &'static str,
        /// Index in it.
        index: usize,
    },
    /// A section does not decompress to its declared length.
    #[error("{section}: does not decompress to {raw_bytes} bytes")]
    Compression {
        /// Part of the chunk.
        section: &'static str,
        /// Declared length.
        raw_bytes: usize,
        /// Error of zstd, if it failed.
        #[source]
        source: Option<std::io::Error>,
    },
    /// The bytes are not those that the digest names.
    #[error("the chunk's digest is {found}, wanted {wanted}: fetch it again")]
    Digest {
        /// Digest asked for.
        wanted: Digest,
        /// Digest of the bytes.
        found: Digest,
    },
}

/// `value` if it lies in `min..=max`, else the error that says so.
pub fn in_range(
    section: &'static str,
    what: &'static str,
    value: u64,
    min: u64,
    max: u64,
) -> Result<usize, ChunkError> {
    if (min..=max).contains(&value) {
        Ok(value as usize)
    } else {
        Err(ChunkError::OutOfRange { section, what, value, min, max })
    }
}

/// Errs on the first number that is not finite.
pub fn all_finite(section: &'static str, what: &'static str, numbers: &[f32]) -> Result<(), ChunkError> {
    all_numbers(section, what, numbers, "a finite number", f32::is_finite)
}

/// Errs on the first number that is not `wanted`.
pub fn all_numbers(
    section: &'static str,
    what: &'static str,
    numbers: &[f32],
    wanted: &'static str,
    good: impl Fn(f32) -> bool,
) -> Result<(), ChunkError> {
    match numbers.iter().position(|&number| !good(number)) {
        None => Ok(()),
        Some(index) => Err(ChunkError::BadNumber { section, what, index, value: numbers[index], wanted }),
    }
}

/// Errs on the first key that is not larger than the one before.
pub fn all_ascending<T: Ord>(
    section: &'static str,
    what: &'static str,
    keys: &[T],
) -> Result<(), ChunkError> {
    match keys.windows(2).position(|pair| pair[0] >= pair[1]) {
        None => Ok(()),
        Some(index) => Err(ChunkError::Order { section, what, index: index + 1 }),
    }
}
