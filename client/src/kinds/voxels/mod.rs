//! Voxels alone: receivers and patches whose light is that of walks, which are taken when the bake is loaded.

use lightkiln_proto::kinds::{self, Kind};
use lightkiln_proto::relight::{Inconsistent, PatchTable, Transport, WalkedTable};
use lightkiln_proto::voxels::{VOXELS, WALK_WEIGHT, walked};

use super::prt;
use crate::bake::{ClientKind, Light};
use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::lightmap::LightmapLight;
use crate::scene::LoadedScene;
use crate::threads::Threads;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Voxels;

impl ClientKind for Voxels {
    fn contract(&self) -> &'static dyn Kind {
        &kinds::voxels::Voxels
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let mut light = prt::load(source, scene)?;
        walk(&mut light)?;
        Ok(Box::new(light))
    }
}

/// Gives all receivers the light of walks.
pub fn walk(light: &mut LightmapLight<PatchTable>) -> Result<()> {
    let Transport { receivers, near, columns, .. } = &light.transport;
    let elements = light.voxels.as_ref().ok_or_else(|| {
        ClientError::inconsistent(VOXELS, "are missing, and all light of the bake comes from them".to_owned())
    })?;
    let ends = walked(elements, columns, receivers, |_| true, &Threads);
    light.transport.walked = WalkedTable::new(ends, WALK_WEIGHT, near)
        .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
    Ok(())
}

#[cfg(test)]
mod tests;
