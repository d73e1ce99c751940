//! URIs of buffers and images: data URIs decoded, file names resolved without ever leaving the scene's folder.

use base64::Engine as _;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

/// Padding is optional in many exporters' data URIs.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Forms of a URI in a glTF.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Uri<'a> {
    /// `data:[media type][;base64],payload`, the payload still encoded.
    Data(&'a str),
    /// A file, relative to the glTF.
    File(&'a str),
    /// Anything with another scheme, such as `https:` or `file:`.
    Remote,
}

/// Sorts a URI by its scheme; a drive letter counts as one.
pub(super) fn classify(uri: &str) -> Uri<'_> {
    if let Some(rest) = strip_prefix_ignoring_case(uri, "data:") {
        return Uri::Data(rest);
    }
    let scheme_end = uri.find([':', '/', '\\', '?', '#']);
    match scheme_end {
        Some(end) if uri.as_bytes()[end] == b':' => Uri::Remote,
        _ => Uri::File(uri),
    }
}

fn strip_prefix_ignoring_case<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let head = text.get(..prefix.len())?;
    head.eq_ignore_ascii_case(prefix).then(|| &text[prefix.len()..])
}

/// Decodes what follows `data:`.
pub(super) fn decode_data(rest: &str) -> Result<Vec<u8>, String> {
    let (header, payload) = rest.split_once(',').ok_or("it has no comma")?;
    let header_is_base64 = header.split(';').skip(1).any(|part| part.trim().eq_ignore_ascii_case("base64"));
    if !header_is_base64 {
        return Ok(percent_decode_str(payload).collect());
    }
    // Base64 itself has no '%', so decoding first is only needed where an exporter escaped '+', '/' or '='.
    if payload.contains('%') {
        let unescaped: Vec<u8> = percent_decode_str(payload).collect();
        return BASE64.decode(unescaped).map_err(|error| error.to_string());
    }
    BASE64.decode(payload).map_err(|error| error.to_string())
}

/// The percent-decoded form of a file URI; the raw one when it is not UTF-8 after decoding.
pub(super) fn decode_file(uri: &str) -> String {
    percent_decode_str(uri).decode_utf8().map_or_else(|_| uri.to_owned(), |decoded| decoded.into_owned())
}

/// Why a path is refused that a wider folder would hold.
pub(super) const LEAVES: &str = "leaves the scene's folder";

/// Resolves a relative path against a folder, by text alone.
///
/// `folder` is `""` or `a/b`; the result never starts with `..`. Backslashes count as slashes, since exporters on
/// Windows write them. Errors say why the path is refused.
pub(super) fn resolve(folder: &str, path: &str) -> Result<String, &'static str> {
    if path.contains('\0') {
        return Err("has a zero byte in it");
    }
    if path.starts_with(['/', '\\']) {
        return Err("is an absolute path");
    }
    if matches!(classify(path), Uri::Remote | Uri::Data(_)) {
        return Err("is not a relative path");
    }
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop().ok_or(LEAVES)?;
            }
            name => parts.push(name),
        }
    }
    if parts.is_empty() { Err("is empty") } else { Ok(parts.join("/")) }
}

/// The folder part of a path in a bundle, `""` at the top.
pub(super) fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}
