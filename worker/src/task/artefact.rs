//! Artefacts between tasks: a magic, then zstd over postcard. Chunks for clients have their own format.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::task::TaskError;

/// Largest decoded artefact.
const MAX_DECODED_BYTES: usize = 8 << 30;
/// zstd level: fast, as artefacts live only between tasks.
const LEVEL: i32 = 3;

/// Encodes a value under a four-byte magic.
pub fn encode<T: Serialize>(magic: &[u8; 4], value: &T) -> Result<Vec<u8>, TaskError> {
    let failed = |error: String| TaskError::bad_input(format!("artefact cannot be encoded: {error}"));
    let plain = postcard::to_stdvec(value).map_err(|error| failed(error.to_string()))?;
    let mut bytes = magic.to_vec();
    bytes.extend((plain.len() as u64).to_le_bytes());
    bytes.extend(zstd::bulk::compress(&plain, LEVEL).map_err(|error| failed(error.to_string()))?);
    Ok(bytes)
}

/// Decodes a value; also gives its decoded size in bytes.
///
/// Errors with [`TaskError::BadInput`] when the bytes are not an artefact of this magic.
pub fn decode<T: DeserializeOwned>(magic: &[u8; 4], bytes: &[u8]) -> Result<(T, usize), TaskError> {
    let name = String::from_utf8_lossy(magic).into_owned();
    let wrong = |what: &str| TaskError::bad_input(format!("artefact '{name}' is damaged: {what}"));
    let body = bytes.strip_prefix(magic).ok_or_else(|| wrong("it starts with another magic"))?;
    let (length, packed) = body.split_first_chunk::<8>().ok_or_else(|| wrong("it ends within its header"))?;
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    if length > MAX_DECODED_BYTES {
        return Err(wrong("it says that it is larger than any artefact"));
    }
    let plain = zstd::bulk::decompress(packed, length).map_err(|error| wrong(&error.to_string()))?;
    let value = postcard::from_bytes(&plain).map_err(|error| wrong(&error.to_string()))?;
    Ok((value, plain.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_survives_and_damage_is_an_error() {
        let bytes = encode(b"TEST", &vec![1_u32, 2, 3]).unwrap();
        assert_eq!(decode::<Vec<u32>>(b"TEST", &bytes).unwrap().0, vec![1, 2, 3]);
        assert!(decode::<Vec<u32>>(b"ELSE", &bytes).is_err());
        for length in 0..bytes.len() {
            assert!(decode::<Vec<u32>>(b"TEST", &bytes[..length]).is_err(), "{length}");
        }
    }
}
