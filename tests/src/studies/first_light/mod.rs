//! First light: how near a bake's overview comes to all of it, at how many bytes, and how light gets better as clusters come.

mod measure;

pub use lightkiln_worker::kinds::prt::overview::Size;
pub use measure::{FirstLight, OfLight, SHARES, Whole};
