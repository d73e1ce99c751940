//! The modules of `client/web` in Chromium: they read the same numbers as the Rust decoder, refuse what it
//! refuses, and show the light and pictures of the native client.
//!
//! Tests need Chromium and its driver: they are ignored, and `tests/run` asks for them where both are there.

#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod bundle;
mod decoding;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod detail;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod directories;
mod driver;
mod face;
mod fetching;
mod fields;
mod files;
mod hand;
#[path = "../../../server/tests/parts/keeper.rs"]
#[allow(
    dead_code,
    clippy::unwrap_used,
    reason = "no program here is started again; a test that cannot go on has failed"
)]
mod keeper;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod landing;
#[path = "../scenes/hostile/mutations.rs"]
mod mutations;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod objects;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod relighting;
mod shown;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod skies;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod three_js;
mod viewing;
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod working;

use std::path::{Path, PathBuf};

use driver::Browser;
use files::{Answer, Files};
use lightkiln_client::web;

/// The repository's root.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ lies in the repository").to_owned()
}

/// A server of the modules and of the tests' own pages, with more answers of a test.
fn served(answer: impl Fn(&files::Request) -> Option<Answer> + Send + Sync + 'static) -> Files {
    let folders =
        [("/web/", root().join("client/web")), ("/pages/", root().join("tests/tests/browser/pages"))];
    Files::start(folders.to_vec(), answer)
}

/// A browser with the tests' empty page open.
fn browser_at(files: &Files) -> Browser {
    let browser = Browser::start();
    browser.open(&files.url("/pages/empty.html"));
    browser
}

/// A server of the modules, the shaders, a bundle and more answers of a test, and a browser there.
fn bundle_opened(
    bundle: &bundle::Bundle,
    answer: impl Fn(&files::Request) -> Option<Answer> + Send + Sync + 'static,
) -> (Files, Browser) {
    let folder = bundle.folder().to_owned();
    let files = served(move |request| {
        if let Some(name) = request.path.strip_prefix("/web/shaders/") {
            let name = name.strip_suffix(".wgsl")?;
            let (_, text) = web::shaders().into_iter().find(|(own, _)| *own == name)?;
            return Some(Answer::of(text.into_owned().into_bytes()));
        }
        if let Some(name) = request.path.strip_prefix("/bundle/") {
            return std::fs::read(folder.join(name)).ok().map(Answer::of);
        }
        answer(request)
    });
    let browser = browser_at(&files);
    (files, browser)
}

/// Bytes of hex digits that a page told.
fn bytes_of_hex(hex: &serde_json::Value) -> Vec<u8> {
    let digits = hex.as_str().expect("hex digits").as_bytes();
    let digit = |digit: u8| (digit as char).to_digit(16).expect("a hex digit") as u8;
    digits.chunks_exact(2).map(|pair| digit(pair[0]) << 4 | digit(pair[1])).collect()
}
