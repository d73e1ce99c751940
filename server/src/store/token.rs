//! Fencing tokens and bake ids: random, unguessable, without meaning.

use super::StoreError;

/// Characters of a fencing token: 128 random bits in lower-case hex.
pub const TOKEN_CHARS: usize = 32;

/// A new fencing token.
pub fn new_token() -> Result<String, StoreError> {
    random_hex::<16>()
}

/// A new id of a bake or a process: 64 random bits in lower-case hex.
pub fn random_id() -> Result<String, StoreError> {
    random_hex::<8>()
}

/// The random part of a bearer's token: 256 bits in lower-case hex.
pub fn random_secret() -> Result<String, StoreError> {
    random_hex::<32>()
}

/// Whether `text` has the shape of a fencing token.
pub fn is_token(text: &str) -> bool {
    text.len() == TOKEN_CHARS && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// 64 random bits.
pub fn random_u64() -> Result<u64, StoreError> {
    let mut bytes = [0; 8];
    fill(&mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}

fn fill(bytes: &mut [u8]) -> Result<(), StoreError> {
    getrandom::fill(bytes).map_err(|error| StoreError::Unavailable(error.to_string().into()))
}

fn random_hex<const BYTES: usize>() -> Result<String, StoreError> {
    let mut bytes = [0; BYTES];
    fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_have_their_shape_and_differ() {
        let (a, b) = (new_token().unwrap(), new_token().unwrap());
        assert!(is_token(&a) && is_token(&b));
        assert_ne!(a, b);
        assert!(!is_token("") && !is_token(&"G".repeat(TOKEN_CHARS)) && !is_token(&a[1..]));
    }
}
