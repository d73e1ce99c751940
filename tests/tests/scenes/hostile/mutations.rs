//! Mutations of good input: what breaks parsers is mostly a number that is a little or far off, or a part that is
//! missing, twice there or from elsewhere.

/// Numbers at the edges of what fields hold.
const EDGES: [u64; 18] = [
    0,
    1,
    2,
    3,
    0x7f,
    0x80,
    0xff,
    0x100,
    0x7fff,
    0xffff,
    0x1_0000,
    0x100_0000,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    1 << 40,
    i64::MAX as u64,
    u64::MAX,
];

/// Numbers and words as texts have them.
const TOKENS: [&str; 22] = [
    "0",
    "-1",
    "1",
    "2",
    "7",
    "255",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "99999999999999999999999",
    "1e38",
    "1e-320",
    "-0.0",
    "1e400",
    "null",
    "true",
    "{}",
    "[]",
    "\"\"",
    "\"a\"",
    "\"\\u0000\"",
];

/// Most mutations of one input.
const MUTATIONS_MAX: u64 = 6;

/// A source of mutations; the same seed gives the same ones.
pub struct Mutator(u64);

impl Mutator {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// SplitMix64 [Steele2014].
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count.max(1) as u64) as usize
    }

    /// One of the seeds, changed in some places.
    pub fn mutated(&mut self, seeds: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = seeds[self.below(seeds.len())].clone();
        for _ in 0..=self.next() % MUTATIONS_MAX {
            self.mutate(&mut bytes, seeds);
        }
        bytes
    }

    fn mutate(&mut self, bytes: &mut Vec<u8>, seeds: &[Vec<u8>]) {
        let at = self.below(bytes.len() + 1);
        let range = at..(at + 1 + self.below(16)).min(bytes.len());
        match self.below(12) {
            0 => flip(bytes, at, 1 << self.below(8)),
            1 => flip(bytes, at, self.next() as u8 | 1),
            2..=4 => self.put_edge(bytes, at),
            5 => nudge(bytes, at, self.next()),
            6 => bytes.truncate(at),
            7 => drop(bytes.drain(range)),
            8 => {
                let copy = bytes[range].to_vec();
                bytes.splice(at..at, copy);
            }
            9 => {
                let other = &seeds[self.below(seeds.len())];
                let start = self.below(other.len() + 1);
                bytes.truncate(at);
                bytes.extend_from_slice(&other[start..]);
            }
            _ => self.put_token(bytes, at),
        }
    }

    /// Overwrites one to eight bytes with a number at an edge, little or big endian.
    fn put_edge(&mut self, bytes: &mut [u8], at: usize) {
        let number = EDGES[self.below(EDGES.len())];
        let number = if self.below(4) == 0 { number.swap_bytes() } else { number };
        let width = 1 << self.below(4);
        bytes.iter_mut().skip(at).zip(number.to_le_bytes()).take(width).for_each(|(byte, new)| *byte = new);
    }

    /// Replaces the number or word around `at` with another, if the input is a text there.
    fn put_token(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let is_part = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'+' | b'.');
        let start = bytes[..at].iter().rposition(|byte| !is_part(byte)).map_or(0, |before| before + 1);
        let end = at + bytes[at..].iter().take_while(|byte| is_part(byte)).count();
        let token = TOKENS[self.below(TOKENS.len())];
        bytes.splice(start..end, token.bytes());
    }
}

fn flip(bytes: &mut [u8], at: usize, bits: u8) {
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= bits;
    }
}

/// Adds a little to a byte, or takes it away.
fn nudge(bytes: &mut [u8], at: usize, by: u64) {
    if let Some(byte) = bytes.get_mut(at) {
        *byte = byte.wrapping_add(by as u8 % 9).wrapping_sub(4);
    }
}
