//! Real parts of a farm, started by the tests themselves: on free ports, in folders that go with the process.

pub mod keeper;
pub mod postgres;
