//! Signatures: HMAC-SHA256 over time and body, so that a delivery cannot be made up, changed, or sent again much later.
//!
//! ```text
//! Lightkiln-Signature: t=1790000000,v1=<hex of HMAC-SHA256(secret, "1790000000." + body)>
//! ```

use hmac::{Hmac, KeyInit as _, Mac as _};
use sha2::Sha256;

/// The header's value for a body sent at a time, in Unix seconds.
pub(super) fn signature(secret: &[u8], at_secs: i64, body: &[u8]) -> Option<String> {
    // Keys of any length will do.
    let mut mac = Hmac::<Sha256>::new_from_slice(secret).ok()?;
    mac.update(format!("{at_secs}.").as_bytes());
    mac.update(body);
    let hex: String = mac.finalize().into_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
    Some(format!("t={at_secs},v1={hex}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From `printf '1790000000.{}' | openssl dgst -sha256 -hmac sixteen-bytes-or-more`.
    #[test]
    fn signature_is_that_of_other_tools() {
        let signed = signature(b"sixteen-bytes-or-more", 1_790_000_000, b"{}").unwrap();
        assert_eq!(
            signed,
            "t=1790000000,v1=73a9152f910118e60e8f712b2cf1a703dd90433616116177197d0b3f55cfd33b"
        );
    }
}
