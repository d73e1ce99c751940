//! The octree of a scene from its triangles to filtered bricks, with the time of each step.

use std::time::Instant;

use glam::Vec3;
use lightkiln_worker::geometry::Geometry;
use lightkiln_worker::rays::Hit;

use super::cone::Volume;
use super::fill::{fragments, leaves};
use super::filter::{FilterTimes, filtered};
use super::inject::{Injected, Lamp, inject, shadow_map};
use super::tree::{Cube, Tree};
use super::{Kind, Manner, Sampling};

/// Settings of the octree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Build {
    /// Depth of the octree.
    pub depth: u32,
    /// Texels along a side of the lamp's six maps.
    pub shadow_map: u32,
    /// Places of samples along cones.
    pub sampling: Sampling,
    /// Distance from a surface at which mended cones start, in voxels.
    pub start: f32,
}

/// Seconds of the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// Voxel fragments.
    pub fragments_secs: f64,
    /// The octree's nodes.
    pub tree_secs: f64,
    /// Values of voxels.
    pub fill_secs: f64,
    /// Shadow maps of the lamp.
    pub shadow_secs: f64,
    /// Their texels written.
    pub inject_secs: f64,
    /// Bricks.
    pub filter: FilterTimes,
}

/// A volume, and how it came about.
#[derive(Clone, Debug)]
pub struct Built {
    /// The volume.
    pub volume: Volume,
    /// Its steps.
    pub times: Times,
    /// Texels of shadow maps.
    pub injected: Injected,
}

/// Builds the volume of a scene. As written its light is that of the lamp, mended that which `light` gives surfaces.
pub fn built(
    geometry: &Geometry,
    kind: Kind,
    build: &Build,
    lamp: Option<&Lamp>,
    light: impl Fn(&Hit) -> Vec3,
) -> Built {
    let mut times = Times::default();
    let cube = Cube::about(geometry.near_bounds_m(), build.depth);
    let found = timed(&mut times.fragments_secs, || fragments(geometry, &cube));
    let tree = timed(&mut times.tree_secs, || Tree::new(cube, found.iter().map(|fragment| fragment.voxel)));
    let mut leaves = timed(&mut times.fill_secs, || leaves(geometry, &found, kind, light));
    let mut injected = Injected::default();
    if let Some(lamp) = lamp.filter(|_| kind.manner == Manner::Written) {
        let seen = timed(&mut times.shadow_secs, || shadow_map(geometry, lamp, build.shadow_map));
        injected = timed(&mut times.inject_secs, || inject(&mut leaves, &cube, kind.model, lamp, &seen));
    }
    let (levels, filter) = filtered(&tree, &leaves, kind);
    times.filter = filter;
    Built {
        volume: Volume { tree, levels, kind, sampling: build.sampling, start: build.start },
        times,
        injected,
    }
}

fn timed<T>(secs: &mut f64, step: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let made = step();
    *secs = begun.elapsed().as_secs_f64();
    made
}
