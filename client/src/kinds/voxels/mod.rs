//! Voxels alone: receivers and patches whose light is that of walks, which are taken when the bake is loaded.

use lightkiln_proto::kinds::{self, Kind};
use lightkiln_proto::voxels::{LitByWalks, VOXELS};

use super::prt;
use crate::bake::{ClientKind, Light};
use crate::error::{ClientError, Result};
use crate::fetch::Source;
use crate::scene::LoadedScene;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Voxels;

impl ClientKind for Voxels {
    fn contract(&self) -> &'static dyn Kind {
        &kinds::voxels::Voxels
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let mut light = prt::load(source, scene)?;
        if light.voxels.is_none() {
            let problem = "are missing, and all light of the bake comes from them".to_owned();
            return Err(ClientError::inconsistent(VOXELS, problem));
        }
        prt::walk(&mut light, LitByWalks::All)?;
        Ok(Box::new(light))
    }
}

#[cfg(test)]
mod tests;
