//! Bakes scenes inside the test process.

mod gather;
mod local_bake;
mod relit;

pub use gather::gathered;
pub use local_bake::{LocalBake, bake};
pub use relit::{Lighting, RelitReceiver, relit};
