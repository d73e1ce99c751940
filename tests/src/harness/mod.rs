//! Bakes scenes inside the test process, and holds them against the path tracer.

mod gather;
mod held;
mod local_bake;
mod relit;

pub use gather::gathered;
pub use held::{Compared, Held, Lit};
pub use local_bake::{LocalBake, bake};
pub use relit::{Lighting, RelitReceiver, relit};
