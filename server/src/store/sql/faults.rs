//! Named points between the steps of every transaction, where tests end the process.
//!
//! In operation nobody listens: a point then costs one comparison with nothing.

use async_trait::async_trait;

use crate::store::Result;

/// A place between two steps of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FaultPoint {
    /// The call, e.g. `commit`.
    pub call: &'static str,
    /// 1, 2, 3 … within the call.
    pub step: u32,
    /// The statement that comes next, or `COMMIT`, or `after COMMIT`.
    pub before: &'static str,
}

/// Is told of every point that is passed.
#[async_trait]
pub trait Faults: Send + Sync {
    /// An error ends the call there, as the end of the process would: nothing more is sent to the database.
    async fn at(&self, point: FaultPoint) -> Result<()>;
}
