//! Files that the server hands out to browsers beside its calls: they are given to it as they are, and it knows nothing of them.

use std::collections::BTreeMap;

use bytes::Bytes;
use lightkiln_proto::ids::Digest;

/// A file.
#[derive(Clone, Debug)]
pub(crate) struct Page {
    /// Content type.
    pub media_type: &'static str,
    /// Strong entity tag: the digest of the bytes.
    pub etag: String,
    /// The bytes.
    pub bytes: Bytes,
}

/// Files by their paths, such as `/` and `/web/view.js`. By default there are none.
#[derive(Clone, Debug, Default)]
pub struct Pages {
    files: BTreeMap<String, Page>,
}

impl Pages {
    /// The same with one file more; its name's ending says its type.
    #[must_use]
    pub fn with(mut self, path: impl Into<String>, bytes: impl Into<Bytes>) -> Self {
        let (path, bytes) = (path.into(), bytes.into());
        let page = Page { media_type: media_type(&path), etag: format!("\"{}\"", Digest::of(&bytes)), bytes };
        self.files.insert(path, page);
        self
    }

    /// The file at a path.
    pub(crate) fn at(&self, path: &str) -> Option<&Page> {
        self.files.get(path)
    }
}

/// Content type by a name's ending. The page at a folder's path is HTML; files without an ending, such as licences, are plain text.
fn media_type(path: &str) -> &'static str {
    let name = path.rsplit('/').next().unwrap_or_default();
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        _ if name.is_empty() => "text/html; charset=utf-8",
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("wgsl") => "text/wgsl; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}
