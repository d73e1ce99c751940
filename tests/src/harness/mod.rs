//! Bakes scenes inside the test process, and holds them against the path tracer.

mod decoded;
mod first_light;
mod free_points;
mod held;
mod local_bake;
mod relit;

pub use decoded::{Decoded, captured, clusters};
pub use first_light::{FirstLight, beside_the_whole, first_light};
pub use free_points::free_points;
pub use held::{Compared, Held, Lit};
pub use local_bake::{Bakery, LocalBake, Rebaked, Recipe, bake, bake_in_world};
pub use relit::{Lighting, RelitReceiver, Rgb, relit};
