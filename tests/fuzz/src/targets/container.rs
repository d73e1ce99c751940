//! The container of chunks as FORMAT.md describes it, read and written here anew: with its sections unpacked, so that
//! a mutation changes what is in them instead of breaking their compression.

const HEADER_BYTES: usize = 12;
const ENTRY_BYTES: usize = 12;
/// Longest unpacked chunk that is packed.
const BYTES_MAX: usize = 1 << 20;

struct Entry {
    id: [u8; 4],
    stored: u32,
    raw: u32,
}

/// The bytes before the table; the table; the bytes after it.
fn parts(bytes: &[u8]) -> Option<(&[u8], Vec<Entry>, &[u8])> {
    let word = |at: usize| Some(usize::from(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?)));
    let (head, count) = (word(8)?, word(10)?);
    let (before, rest) = bytes.split_at_checked(HEADER_BYTES + head)?;
    let (table, sections) = rest.split_at_checked(count * ENTRY_BYTES)?;
    let entry = |raw: &[u8]| Entry {
        id: [raw[0], raw[1], raw[2], raw[3]],
        stored: u32::from_le_bytes([raw[4], raw[5], raw[6], raw[7]]),
        raw: u32::from_le_bytes([raw[8], raw[9], raw[10], raw[11]]),
    };
    Some((before, table.chunks_exact(ENTRY_BYTES).map(entry).collect(), sections))
}

fn assembled(before: &[u8], entries: &[Entry], sections: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = before.to_vec();
    for entry in entries {
        bytes.extend_from_slice(&entry.id);
        bytes.extend_from_slice(&entry.stored.to_le_bytes());
        bytes.extend_from_slice(&entry.raw.to_le_bytes());
    }
    bytes.extend(sections.concat());
    bytes
}

/// A good chunk with its sections as they are without compression.
pub fn unpacked(chunk: &[u8]) -> Vec<u8> {
    let (before, mut entries, mut rest) = parts(chunk).expect("a good chunk");
    let mut sections = Vec::new();
    for entry in &mut entries {
        let (stored, after) = rest.split_at(entry.stored as usize);
        rest = after;
        sections.push(zstd::bulk::decompress(stored, entry.raw as usize).expect("a good section"));
        entry.stored = entry.raw;
    }
    assembled(before, &entries, &sections)
}

/// An unpacked chunk, changed or not, with its sections compressed; their true lengths are put into the table. Nothing
/// if it has no table.
pub fn packed(unpacked: &[u8]) -> Option<Vec<u8>> {
    if unpacked.len() > BYTES_MAX {
        return None;
    }
    let (before, mut entries, mut rest) = parts(unpacked)?;
    let mut sections = Vec::new();
    for entry in &mut entries {
        let (raw, after) = rest.split_at((entry.stored as usize).min(rest.len()));
        rest = after;
        let stored = zstd::bulk::compress(raw, 1).ok()?;
        (entry.stored, entry.raw) = (stored.len() as u32, raw.len() as u32);
        sections.push(stored);
    }
    Some(assembled(before, &entries, &sections))
}
