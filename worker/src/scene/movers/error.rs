//! Why nodes cannot be taken out of a scene.

use super::super::error::{ImportError, shown};

/// Nodes that cannot move: the fault, the place, and the next step.
#[derive(Debug, thiserror::Error)]
pub enum MoverError {
    /// The scene itself cannot be read.
    #[error(transparent)]
    Import(#[from] ImportError),
    /// No node has the name.
    #[error("no node of the scene is named {:?}{hint}; name a node as the glTF has it", shown(name))]
    Unknown {
        /// The name.
        name: String,
        /// Names that there are.
        hint: String,
    },
    /// Several nodes have the name.
    #[error("{count} nodes are named {:?}; give the one that moves a name of its own", shown(name))]
    Ambiguous {
        /// The name.
        name: String,
        /// How many.
        count: usize,
    },
    /// A name that was given twice.
    #[error("{:?} is named twice; name each node once", shown(name))]
    Twice {
        /// The name.
        name: String,
    },
    /// A node below another one that moves.
    #[error("{inner} is below {outer}, which moves with all below it; name one of them")]
    Inside {
        /// The node below.
        inner: String,
        /// The other one.
        outer: String,
    },
    /// A node without anything to see.
    #[error("{place} has no mesh of its own, nor has a node below it; name a node with a mesh")]
    NoMesh {
        /// The node.
        place: String,
    },
    /// A mesh whose joints do not move with it.
    #[error("{place} has a skin whose joint {joint} does not move with it; name a node that is above both")]
    SkinOutside {
        /// The mesh's node.
        place: String,
        /// The joint's.
        joint: String,
    },
    /// Animated nodes are asked for, and there is no animation.
    #[error(
        "the scene has no animation that moves, turns or scales a node with a mesh; name the nodes that move"
    )]
    NothingAnimated,
    /// All meshes move.
    #[error(
        "nothing is left of the scene without its movers; leave some of it, or bake the file as an object"
    )]
    NothingLeft,
    /// More than pictures have.
    #[error("{count} nodes are to move (at most {limit}); name those that matter, or a node above them")]
    TooMany {
        /// How many.
        count: usize,
        /// Most of them.
        limit: usize,
    },
}
