//! First light: how near a bake's overview comes to all of it, at how many bytes, and how light gets better as clusters come.

mod layers;
mod line;
mod measure;

pub use layers::{Stored, Streamed};
pub use lightkiln_worker::kinds::prt::overview::Size;
pub use line::{FirstOverLine, Line, first_over_line};
pub use measure::{FirstLight, OfLight, SHARES, Whole};
