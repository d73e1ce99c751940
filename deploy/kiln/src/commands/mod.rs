//! The subcommands, one file each (those that need a bake's id alone share one).

pub mod actions;
pub mod bake;
pub mod blocklist;
pub mod check;
pub mod evaluate;
pub mod export;
pub mod fetch;
pub mod fsck;
pub mod inspect;
pub mod list;
pub mod logs;
pub mod preview;
pub mod priority;
pub mod server;
pub mod settings;
pub mod show;
pub mod site;
pub mod submit;
pub mod token;
pub mod top;
#[cfg(feature = "view")]
pub mod view;
pub mod watch;
pub mod worker;
