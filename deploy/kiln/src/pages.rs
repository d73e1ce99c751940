//! Files that a server hands out to browsers: the farm's face, the client's modules and shaders.

use lightkiln_client::web::{FACE, MODULES, SITE, shaders};
use lightkiln_server::Pages;

/// All files, by their paths on the server.
pub fn pages() -> Pages {
    let modules = MODULES.iter().filter(|(name, _)| *name != SITE).map(|(name, bytes)| match *name {
        FACE => ("/".to_owned(), *bytes),
        name => (format!("/web/{name}"), *bytes),
    });
    let pages = modules.fold(Pages::default(), |pages, (path, bytes)| pages.with(path, bytes));
    shaders().into_iter().fold(pages, |pages, (name, text)| {
        pages.with(format!("/web/shaders/{name}.wgsl"), text.into_owned().into_bytes())
    })
}
