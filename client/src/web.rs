//! Shaders for browsers: the very text that adapters get here, joined with the parts that passes share.
//!
//! The browser's modules lie in `client/web`; `client/web/frame/shaders.js` fetches each shader as `NAME.wgsl`.

mod modules;

use std::borrow::Cow;

use crate::passes::SHADERS;
use crate::passes::atlas::INDIRECT;
use crate::passes::shade::Shading;

pub use modules::MODULES;

/// Shaders that browsers alone run: a texture's next coarser level, a device's steps of corners, and radiance on the screen.
const OF_BROWSERS: [(&str, &str); 3] = [
    ("halve", include_str!("../web/frame/halve.wgsl")),
    ("snap", include_str!("../web/frame/snap.wgsl")),
    ("tone", concat!(include_str!("passes/shared/curve.wgsl"), include_str!("../web/frame/tone.wgsl"))),
];

/// The farm's page among the modules.
pub const FACE: &str = "index.html";
/// The page of a site of one bake among the modules.
pub const SITE: &str = "alone.html";

/// Name and whole text of every shader that a browser's frame runs, for light in a lightmap.
pub fn shaders() -> Vec<(&'static str, Cow<'static, str>)> {
    let whole = SHADERS.iter().chain(&OF_BROWSERS).map(|(name, text)| (*name, Cow::Borrowed(*text)));
    let shade = Shading { snippet: INDIRECT, bindings: Vec::new() };
    whole.chain([("shade", Cow::Owned(shade.shader_without_walks()))]).collect()
}
