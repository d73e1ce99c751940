//! Behaviour of chunks as wholes.

mod colours;
mod document;
mod fixtures;
mod layers;
mod malformed;
mod round_trip;
mod scenes;
mod whole;

use crate::content::*;
use crate::kinds::field::{FieldPart, MAP_POINTS, MOVES_MAX, PROBE_ROWS, TetrahedronSet};
use crate::kinds::sh::{ProbeBatch, RelightHit};
use crate::manifest::{ChunkRef, ClusterRow};
use crate::transfer::TransferLevel;
use crate::voxels::{BRICKS_MAX, Brick, LEVELS_MAX as VOXEL_LEVELS_MAX, VoxelPart};
