//! Fencing tokens, secrets, ids and generations: random, unguessable, without meaning.
//!
//! All of them come from the operating system. A machine that has no random bytes can run no farm: asking there panics.

/// Characters of a fencing token: 128 random bits in lower-case hex.
pub const TOKEN_CHARS: usize = 32;

/// Characters of a bake's id.
pub const BAKE_ID_CHARS: usize = 16;

/// A new fencing token.
pub fn fencing_token() -> String {
    hex::<{ TOKEN_CHARS / 2 }>()
}

/// Whether `text` has the shape of a fencing token.
pub fn is_fencing_token(text: &str) -> bool {
    text.len() == TOKEN_CHARS && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// A new id of a bake or a process: 64 random bits in lower-case hex.
pub fn id() -> String {
    hex::<{ BAKE_ID_CHARS / 2 }>()
}

/// The random part of a bearer's token: 256 bits in lower-case hex.
pub(crate) fn secret() -> String {
    hex::<32>()
}

/// A new generation of a chunk, above 0, which is that of farms before generations.
///
/// It has 63 bits, so that it fits a signed column; a name is used twice once in 2⁶³.
pub(crate) fn generation() -> u64 {
    (u64::from_le_bytes(bytes()) >> 1).max(1)
}

fn hex<const BYTES: usize>() -> String {
    bytes::<BYTES>().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes<const BYTES: usize>() -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    getrandom::fill(&mut bytes).expect("the operating system has random bytes");
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_have_their_shape_and_differ() {
        let (a, b) = (fencing_token(), fencing_token());
        assert!(is_fencing_token(&a) && is_fencing_token(&b));
        assert_ne!(a, b);
        assert!(
            !is_fencing_token("")
                && !is_fencing_token(&"G".repeat(TOKEN_CHARS))
                && !is_fencing_token(&a[1..])
        );
    }
}
