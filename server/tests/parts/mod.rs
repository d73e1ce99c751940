//! Real parts of a farm, started by the tests themselves: on free ports, in folders that go with the process.

#![allow(dead_code, reason = "no test binary uses every part")]

pub mod keeper;
pub mod kind;
pub mod postgres;
pub mod s3;
