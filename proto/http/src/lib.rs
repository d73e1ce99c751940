//! How a role calls a server over HTTP: one agent per server with its trust, token and trace; answers of bounded size;
//! problems decoded; failed calls made again with growing waits that a shutdown ends; a cache on disk for what was fetched.
//!
//! Calls block, on plain threads. The calls themselves are typed where they are made: people's in the client, those of
//! leases in the worker.

mod call;
mod client;
mod disk_cache;
mod error;
pub mod foreign;
mod part;
mod patience;
mod retry;
mod shutdown;
pub mod trace;

pub use call::{Answer, Call};
pub use client::{CONNECTIONS, HttpClient};
pub use disk_cache::DiskCache;
pub use error::CallError;
pub use part::Part;
pub use patience::{Notice, Patience};
pub use retry::{FOREVER, RetryPolicy, USUAL, retry};
pub use shutdown::{Level, ShutdownFlag};
