//! Kinds of bake as every role knows them: the three tables that a command may ask.

use lightkiln_client::bake::{ClientKind, ClientKinds};
use lightkiln_client::kinds;
use lightkiln_proto::kinds::Kinds;
use lightkiln_worker::kinds::{BakeKind, BakeKinds};

/// One table for each role.
#[derive(Clone)]
pub struct KindTables {
    /// Settings, first tasks, chunks and figures.
    pub contract: Kinds,
    /// Tasks and evaluation.
    pub worker: BakeKinds,
    /// Light to draw with.
    pub client: ClientKinds,
}

impl KindTables {
    /// The kinds that Lightkiln has.
    pub fn new() -> Self {
        Self { contract: Kinds::new(), worker: BakeKinds::new(), client: kinds::all() }
    }

    /// The tables with one more kind, whose contract the client's row names.
    #[must_use]
    pub fn with(self, worker: &'static dyn BakeKind, client: impl ClientKind + 'static) -> Self {
        Self {
            contract: self.contract.with(client.contract()),
            worker: self.worker.with(worker),
            client: self.client.with(client),
        }
    }
}

impl Default for KindTables {
    fn default() -> Self {
        Self::new()
    }
}
