//! Kinds of bake that this client plays, a folder each.

pub mod captured;
pub mod cloud;
pub mod field;
pub mod grid;
pub mod prt;
pub mod sh;
pub mod transfer;
pub mod voxels;

use crate::bake::ClientKinds;

/// All of them.
pub fn all() -> ClientKinds {
    ClientKinds::new()
        .with(prt::Prt)
        .with(sh::Sh)
        .with(grid::Grid)
        .with(cloud::Cloud)
        .with(captured::Captured)
        .with(voxels::Voxels)
        .with(transfer::Transfer)
}
