//! Traces across processes, from the submission of a bake to its chunks: W3C Trace Context, carried over HTTP and in leases
//! (<https://www.w3.org/TR/trace-context/>).

/// Target of the spans that make up a trace; other spans are for logs alone.
pub const TARGET: &str = "lightkiln::trace";

/// The header, and the field of a lease, that says which trace a call or a task belongs to.
pub const TRACEPARENT: &str = "traceparent";

/// Whether a text is a traceparent of version 00: trace and parent in lower-case hex, neither of them all zeros, and flags.
pub fn is_traceparent(text: &str) -> bool {
    let parts: Vec<&str> = text.split('-').collect();
    let is_hex = |part: &str, digits: usize| {
        part.len() == digits && part.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    };
    let is_some = |part: &str| part.bytes().any(|byte| byte != b'0');
    match parts[..] {
        ["00", trace, parent, flags] => {
            is_hex(trace, 32) && is_hex(parent, 16) && is_hex(flags, 2) && is_some(trace) && is_some(parent)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traceparents_are_told_from_other_texts() {
        let good = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
        assert!(is_traceparent(good));
        for bad in [
            String::new(),
            good.to_uppercase(),
            good.replace("00-4", "01-4"),
            good.replace("-01", ""),
            format!("{good}-x"),
            good.replace("4bf92f3577b34da6a3ce929d0e0e4736", &"0".repeat(32)),
            good.replace("00f067aa0ba902b7", &"0".repeat(16)),
            good.replace("00f067aa0ba902b7", "00f067aa0ba902b"),
        ] {
            assert!(!is_traceparent(&bad), "{bad}");
        }
    }
}
