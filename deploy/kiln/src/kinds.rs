//! Kinds of bake as every role knows them: the three tables that a command may ask.

use lightkiln_client::bake::ClientKinds;
use lightkiln_client::kinds;
use lightkiln_proto::kinds::{Kind, Kinds};
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

    /// The tables with one more kind.
    #[must_use]
    pub fn with(
        self,
        contract: &'static dyn Kind,
        worker: &'static dyn BakeKind,
        client: impl lightkiln_client::bake::ClientKind + 'static,
    ) -> Self {
        Self {
            contract: self.contract.with(contract),
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
