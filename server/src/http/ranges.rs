//! Conditions and ranges of a GET (RFC 9110 §13 and §14): pure functions.

use std::ops::Range;

/// Bytes that a Range header asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Everything: no range, several ranges, another unit, or one that makes no sense.
    All,
    /// These bytes.
    Part(Range<u64>),
    /// Bytes that are not there.
    Nothing,
}

/// Reads `bytes=first-last`, `bytes=first-` or `bytes=-count` against bytes of a known length.
pub fn wanted(range: Option<&str>, length: u64) -> Wanted {
    let Some(spec) = range.and_then(|range| range.trim().strip_prefix("bytes=")) else { return Wanted::All };
    let Some((first, last)) = spec.trim().split_once('-') else { return Wanted::All };
    match (number(first), number(last)) {
        (Some(Some(first)), Some(None)) => part(first, length, length),
        (Some(Some(first)), Some(Some(last))) if first <= last => {
            part(first, last.saturating_add(1).min(length), length)
        }
        (Some(None), Some(Some(count))) => part(length.saturating_sub(count), length, length),
        _ => Wanted::All,
    }
}

fn part(start: u64, end: u64, length: u64) -> Wanted {
    if start < length && start < end { Wanted::Part(start..end) } else { Wanted::Nothing }
}

/// Nothing, a number, or neither (`None`). A number too large is as good as the largest.
fn number(text: &str) -> Option<Option<u64>> {
    let text = text.trim();
    if text.is_empty() {
        return Some(None);
    }
    if !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    Some(Some(text.parse().unwrap_or(u64::MAX)))
}

/// Whether an If-None-Match names the entity tag, so that the caller has the bytes already.
pub fn is_known(if_none_match: Option<&str>, etag: &str) -> bool {
    let Some(tags) = if_none_match else { return false };
    let matches = |tag: &str| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag;
    tags.split(',').any(|tag| matches(tag.trim()))
}

/// Whether a range may be served: with If-Range, only if it names the very bytes.
pub fn range_applies(if_range: Option<&str>, etag: &str) -> bool {
    if_range.is_none_or(|tag| tag.trim() == etag)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ranges_are_read_as_the_standard_says() {
        let cases = [
            ("bytes=0-3", Wanted::Part(0..4)),
            ("bytes=4-", Wanted::Part(4..10)),
            ("bytes=-3", Wanted::Part(7..10)),
            ("bytes=-30", Wanted::Part(0..10)),
            ("bytes=8-99999999999999999999999", Wanted::Part(8..10)),
            ("bytes=10-", Wanted::Nothing),
            ("bytes=-0", Wanted::Nothing),
            ("bytes=3-2", Wanted::All),
            ("bytes=0-1,4-5", Wanted::All),
            ("items=0-1", Wanted::All),
            ("bytes=x-1", Wanted::All),
            ("bytes=-", Wanted::All),
        ];
        for (range, expected) in cases {
            assert_eq!(wanted(Some(range), 10), expected, "{range}");
        }
        assert_eq!(wanted(None, 10), Wanted::All);
        assert_eq!(wanted(Some("bytes=0-"), 0), Wanted::Nothing);
    }

    #[test]
    fn conditions_compare_entity_tags() {
        assert!(is_known(Some("\"a\""), "\"a\"") && is_known(Some("\"b\", W/\"a\""), "\"a\""));
        assert!(
            is_known(Some("*"), "\"a\"") && !is_known(Some("\"b\""), "\"a\"") && !is_known(None, "\"a\"")
        );
        assert!(range_applies(None, "\"a\"") && range_applies(Some("\"a\""), "\"a\""));
        assert!(!range_applies(Some("W/\"a\""), "\"a\"") && !range_applies(Some("Tue, 1 Jan"), "\"a\""));
    }

    proptest! {
        #[test]
        fn part_always_lies_within_the_bytes(range in "(bytes=)?[0-9x,-]{0,24}", length in 0_u64..20) {
            if let Wanted::Part(part) = wanted(Some(&range), length) {
                prop_assert!(part.start < part.end && part.end <= length);
            }
        }
    }
}
