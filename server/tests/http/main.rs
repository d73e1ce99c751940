//! The HTTP API through a real listener.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod access;
mod bakes;
mod bytes;
mod connections;
mod enrolments;
mod evaluations;
mod events;
mod life;
mod limits;
mod listing;
mod metrics;
mod owners;
mod pages;
#[path = "../parts/mod.rs"]
mod parts;
mod problems;
mod results;
mod support;
mod webhooks;
