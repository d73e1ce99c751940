//! Lightkiln's HTTP API, job queue and chunk storage.
//!
//! It knows jobs and bytes, not light: it never reads a task's parameters, a chunk's content or a plan's meaning.
//!
//! - [`Server`] opens a state folder and serves it; [`Config`] says how.
//! - [`store`] is the queue behind one trait, [`chunks`] the bytes, [`wakeup`] lossy hints.
//! - [`storage`] is the bytes that count, `collect` clears away the others, [`fsck`] checks them.
//! - [`access`] says who may call, [`guard`] asks for the tokens.
//! - `owners` says who may change a bake, `request_checks` what a call may ask for, `result_checks` what a result may say.
//! - `bake_ids` finds bakes by beginnings of their ids.
//! - `left_over` clears up after bakes' processes that have ended, where several share a folder.
//! - `lookout` looks for work and news on behalf of all calls that wait.
//! - `start` waits for a database that is away, `readiness` says whether the farm can work.
//! - `connections` are let in, and sent away where they take up room.
//! - [`Pages`] are files for browsers that it is given.
//! - [`farm`] puts them together, `http` makes calls of it.

pub mod access;
mod bake_ids;
pub mod chunks;
pub mod clock;
mod collect;
mod connections;
mod error;
mod evaluations;
pub mod farm;
pub mod fsck;
pub mod guard;
mod held;
mod hold;
mod http;
mod left_over;
mod lookout;
mod metrics;
mod occupant;
mod owners;
mod pages;
pub mod places;
pub mod random;
mod readiness;
mod request_checks;
mod result_checks;
mod scene_parts;
mod server;
mod start;
pub mod storage;
pub mod store;
mod tls;
pub mod wakeup;
mod webhooks;

pub use collect::Retention;
pub use connections::ConnectionConfig;
pub use error::ServerError;
pub use http::{HEAVY_BYTES, LimitConfig, MAX_RESULT_BYTES, openapi_json, ranges};
pub use occupant::Occupant;
pub use pages::Pages;
pub use server::{Config, Seat, Server, check_storage, open_store};
pub use start::serve;
pub use tls::TlsFiles;
pub use webhooks::WebhookConfig;
