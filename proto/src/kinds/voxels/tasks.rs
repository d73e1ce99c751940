//! Tasks of voxels.

use crate::kinds::TaskKind;

/// Surfaces in a cube → its elements, a chunk of the finest levels.
pub const REGION: TaskKind = TaskKind { name: "voxels.region", version: 1 };
/// All surfaces → elements of the coarser levels, a chunk.
pub const TOP: TaskKind = TaskKind { name: "voxels.top", version: 1 };
