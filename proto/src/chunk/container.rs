//! The container that all kinds of chunk share: header, section table, sections.
//!
//! Offsets of sections are not stored: a section starts where the one before it ends, so they cannot overlap.

use super::bytes::Reader;
use super::error::{ChunkError, in_range};
use super::limits::{EXPANSION_FREE_BYTES, EXPANSION_MAX};

/// First four bytes of every chunk.
pub const MAGIC: [u8; 4] = *b"LKCH";
/// Version that this code writes; it reads those before too.
pub const VERSION: u16 = 4;
/// Bytes of the fixed part of the header.
pub const HEADER_BYTES: usize = 12;
/// Bytes of an entry of the section table.
pub const ENTRY_BYTES: usize = 12;
/// Most bytes of a kind's own head.
pub const HEAD_BYTES_MAX: usize = 1024;
/// Most sections in a chunk.
pub const SECTIONS_MAX: usize = 256;
/// Longest chunk that is read: 256 MiB.
pub const CHUNK_BYTES_MAX: usize = 256 << 20;
/// Highest zstd level, for sections up to [`SMALL_SECTION_BYTES`]: 3 % fewer bytes of a cluster than level 12.
const LEVEL_SMALL: i32 = 19;
/// zstd level of longer sections, which are mostly images that are compressed already.
const LEVEL_LARGE: i32 = 9;
const SMALL_SECTION_BYTES: usize = 1 << 20;

/// Kind of a chunk: the number in its header. Rows of the table of chunk kinds say what each number is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChunkKind(pub u8);

/// Identity of a section: its tag and up to three part numbers, whose meaning is the tag's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SectionId {
    /// Tag, unique within the chunk's kind.
    pub tag: u8,
    /// Part numbers, 0 where unused.
    pub part: [u8; 3],
}

impl SectionId {
    /// An id.
    pub const fn new(tag: u8, part: [u8; 3]) -> Self {
        Self { tag, part }
    }

    /// The error that something is wrong with this section.
    pub fn problem(self, problem: &'static str) -> ChunkError {
        ChunkError::Section { tag: self.tag, part: self.part, problem }
    }
}

/// A section as the table lists it.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Its identity.
    pub id: SectionId,
    start: usize,
    stored_bytes: usize,
    raw_bytes: usize,
}

/// A chunk whose header and section table have been read and checked.
pub struct Container<'a> {
    /// Version of its format.
    pub version: u16,
    /// The kind's own head.
    pub head: &'a [u8],
    /// All sections in order, whether their bytes are there or not.
    pub entries: Vec<Entry>,
    /// How many of them are there in full.
    pub complete: usize,
    bytes: &'a [u8],
}

impl<'a> Container<'a> {
    /// Reads a chunk of which all bytes are there.
    pub fn whole(kind: ChunkKind, bytes: &'a [u8]) -> Result<Self, ChunkError> {
        Self::prefix(kind, bytes, bytes.len() as u64)
    }

    /// Reads the first bytes of a chunk that has `total_bytes` in full.
    pub fn prefix(kind: ChunkKind, bytes: &'a [u8], total_bytes: u64) -> Result<Self, ChunkError> {
        let section = "header";
        in_range(section, "chunk length", total_bytes, bytes.len() as u64, CHUNK_BYTES_MAX as u64)?;
        let mut reader = Reader::new(section, bytes);
        let (version, head_bytes, section_count) = read_fixed(kind, &mut reader)?;
        let head = reader.take("head", head_bytes, 1)?;
        let table = reader.take("section table", section_count, ENTRY_BYTES)?;
        let mut start = reader.offset();
        let mut entries = Vec::with_capacity(section_count);
        let mut complete = 0;
        for raw in table.chunks_exact(ENTRY_BYTES) {
            let entry = read_entry(raw, start)?;
            // At most 256 sections of at most 2³² bytes: no overflow in 64 bits.
            start = in_range(
                section,
                "end of sections",
                start as u64 + entry.stored_bytes as u64,
                0,
                total_bytes,
            )?;
            complete += usize::from(start <= bytes.len());
            entries.push(entry);
        }
        let extra = total_bytes - start as u64;
        if extra > 0 {
            return Err(ChunkError::Trailing { section, offset: start, extra });
        }
        Ok(Self { version, head, entries, complete, bytes })
    }

    /// Where section `count − 1` ends: the length of the prefix that holds `count` sections.
    pub fn end_of(&self, count: usize) -> u64 {
        let last = &self.entries[count - 1];
        (last.start + last.stored_bytes) as u64
    }

    /// Errs unless the table lists exactly the sections `wanted`, in that order.
    pub fn check_sections(&self, wanted: &[SectionId]) -> Result<(), ChunkError> {
        let count = wanted.len() as u64;
        in_range("header", "section count", self.entries.len() as u64, count, count)?;
        match wanted.iter().zip(&self.entries).find(|(wanted, entry)| **wanted != entry.id) {
            Some((wanted, _)) => Err(wanted.problem("missing where it should be")),
            None => Ok(()),
        }
    }

    /// Errs if counts ask for more memory than the bytes that are there can answer for.
    pub fn check_expansion(&self, decoded_bytes: u64) -> Result<(), ChunkError> {
        check_expansion("header", decoded_bytes, self.present())
    }

    /// Bytes that are there.
    pub fn present(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Bytes that section `index` says its content has.
    pub fn raw_bytes(&self, index: usize) -> u64 {
        self.entries[index].raw_bytes as u64
    }

    /// Stored bytes of section `index`.
    pub fn stored(&self, index: usize) -> Result<&'a [u8], ChunkError> {
        let Entry { start, stored_bytes, .. } = self.entries[index];
        Reader::new("section", &self.bytes[start.min(self.bytes.len())..]).take("section", stored_bytes, 1)
    }

    /// Decompresses section `index`, whose content may have up to `raw_bytes_max` bytes, and no more than the chunk's
    /// own length answers for.
    pub fn section(
        &self,
        index: usize,
        name: &'static str,
        raw_bytes_max: u64,
    ) -> Result<Vec<u8>, ChunkError> {
        let Entry { start, stored_bytes, raw_bytes, .. } = self.entries[index];
        in_range(name, "raw length", raw_bytes as u64, 0, raw_bytes_max)?;
        self.check_expansion(raw_bytes as u64)?;
        let mut reader = Reader::new(name, &self.bytes[start.min(self.bytes.len())..]);
        let stored = reader.take("section", stored_bytes, 1)?;
        let mut raw = vec![0; raw_bytes];
        match zstd::bulk::decompress_to_buffer(stored, raw.as_mut_slice()) {
            Ok(length) if length == raw_bytes => Ok(raw),
            Ok(_) => Err(ChunkError::Compression { section: name, raw_bytes, source: None }),
            Err(source) => Err(ChunkError::Compression { section: name, raw_bytes, source: Some(source) }),
        }
    }
}

/// Errs if `decoded_bytes` are more than a chunk of `stored_bytes` may unpack to.
pub fn check_expansion(
    section: &'static str,
    decoded_bytes: u64,
    stored_bytes: u64,
) -> Result<(), ChunkError> {
    let max = EXPANSION_FREE_BYTES + EXPANSION_MAX * stored_bytes;
    in_range(section, "decoded bytes", decoded_bytes, 0, max).map(drop)
}

/// Kind of a chunk, from its header.
pub fn kind_of(bytes: &[u8]) -> Result<ChunkKind, ChunkError> {
    Ok(read_start(&mut Reader::new("header", bytes))?.1)
}

fn read_start(reader: &mut Reader) -> Result<(u16, ChunkKind), ChunkError> {
    let magic = reader.take("magic", 4, 1)?;
    if magic != MAGIC {
        return Err(ChunkError::Magic { found: [magic[0], magic[1], magic[2], magic[3]] });
    }
    let version = reader.u16("version")?;
    if !(1..=VERSION).contains(&version) {
        return Err(ChunkError::Version { found: version });
    }
    Ok((version, ChunkKind(reader.u8("kind")?)))
}

fn read_fixed(kind: ChunkKind, reader: &mut Reader) -> Result<(u16, usize, usize), ChunkError> {
    let (version, found) = read_start(reader)?;
    if found != kind {
        return Err(ChunkError::Kind { wanted: kind.0, found: found.0 });
    }
    let zero = reader.u8("reserved")?;
    in_range("header", "reserved byte", zero.into(), 0, 0)?;
    let head_bytes = reader.u16("head length")?;
    let section_count = reader.u16("section count")?;
    Ok((
        version,
        in_range("header", "head length", head_bytes.into(), 0, HEAD_BYTES_MAX as u64)?,
        in_range("header", "section count", section_count.into(), 0, SECTIONS_MAX as u64)?,
    ))
}

fn read_entry(raw: &[u8], start: usize) -> Result<Entry, ChunkError> {
    let mut reader = Reader::new("section table", raw);
    let tag = reader.u8("tag")?;
    let part = [reader.u8("part")?, reader.u8("part")?, reader.u8("part")?];
    let stored_bytes = reader.u32("stored length")? as usize;
    let raw_bytes = reader.u32("raw length")? as usize;
    Ok(Entry { id: SectionId { tag, part }, start, stored_bytes, raw_bytes })
}

/// Puts a chunk together.
pub struct ContainerWriter {
    kind: ChunkKind,
    table: Vec<u8>,
    body: Vec<u8>,
    /// Length of `body` after each section.
    ends: Vec<usize>,
}

impl ContainerWriter {
    /// A chunk without sections.
    pub fn new(kind: ChunkKind) -> Self {
        Self { kind, table: Vec::new(), body: Vec::new(), ends: Vec::new() }
    }

    /// Appends a section.
    pub fn push(&mut self, id: SectionId, raw: &[u8]) -> Result<(), ChunkError> {
        self.push_stored(id, &compress(raw)?, raw.len() as u64)
    }

    /// Appends a section as another chunk has it stored.
    pub fn push_stored(&mut self, id: SectionId, stored: &[u8], raw_bytes: u64) -> Result<(), ChunkError> {
        in_range("encoder", "raw length", raw_bytes, 0, u32::MAX.into())?;
        self.table.push(id.tag);
        self.table.extend_from_slice(&id.part);
        self.table.extend_from_slice(&(stored.len() as u32).to_le_bytes());
        self.table.extend_from_slice(&(raw_bytes as u32).to_le_bytes());
        self.body.extend_from_slice(stored);
        self.ends.push(self.body.len());
        in_range("encoder", "section count", self.ends.len() as u64, 0, SECTIONS_MAX as u64)?;
        Ok(())
    }

    /// Sections so far.
    pub fn section_count(&self) -> usize {
        self.ends.len()
    }

    /// The chunk, and the length of its prefix up to the end of each section.
    pub fn finish(self, head: &[u8]) -> Result<(Vec<u8>, Vec<u64>), ChunkError> {
        in_range("encoder", "head length", head.len() as u64, 0, HEAD_BYTES_MAX as u64)?;
        let mut bytes = Vec::with_capacity(HEADER_BYTES + head.len() + self.table.len() + self.body.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&[self.kind.0, 0]);
        bytes.extend_from_slice(&(head.len() as u16).to_le_bytes());
        bytes.extend_from_slice(&(self.ends.len() as u16).to_le_bytes());
        bytes.extend_from_slice(head);
        bytes.extend_from_slice(&self.table);
        let start = bytes.len();
        bytes.extend_from_slice(&self.body);
        in_range("encoder", "chunk length", bytes.len() as u64, 0, CHUNK_BYTES_MAX as u64)?;
        Ok((bytes, self.ends.iter().map(|end| (start + end) as u64).collect()))
    }
}

/// One zstd frame without checksum, content size or dictionary id: the table holds the length.
fn compress(raw: &[u8]) -> Result<Vec<u8>, ChunkError> {
    use zstd::zstd_safe::CParameter::{ChecksumFlag, ContentSizeFlag, DictIdFlag};
    let level = if raw.len() <= SMALL_SECTION_BYTES { LEVEL_SMALL } else { LEVEL_LARGE };
    let run = || {
        let mut compressor = zstd::bulk::Compressor::new(level)?;
        for parameter in [ChecksumFlag(false), ContentSizeFlag(false), DictIdFlag(false)] {
            compressor.set_parameter(parameter)?;
        }
        compressor.compress(raw)
    };
    let raw_bytes = raw.len();
    run().map_err(|source| ChunkError::Compression { section: "encoder", raw_bytes, source: Some(source) })
}
