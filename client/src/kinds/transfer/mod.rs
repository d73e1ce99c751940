//! An object that moves through other bakes: relightable light over its own patches, voxels, and the volume of what it covers around it.

use lightkiln_proto::kinds::{Kind, transfer};
use lightkiln_proto::relight::Inconsistent;
use lightkiln_proto::transfer::{TRANSFER, TransferTable, decode_transfer};

use super::prt;
use crate::bake::{ClientKind, Light};
use crate::error::{ClientError, Result};
use crate::fetch::{Source, decoded};
use crate::scene::LoadedScene;

/// The kind.
#[derive(Clone, Copy, Debug)]
pub struct Transfer;

impl ClientKind for Transfer {
    fn contract(&self) -> &'static dyn Kind {
        &transfer::Transfer
    }

    fn load(&self, source: &Source, scene: &LoadedScene) -> Result<Box<dyn Light>> {
        let mut light = prt::load(source, scene)?;
        let levels = decoded(source, &scene.manifest, TRANSFER, |bytes| Ok(decode_transfer(bytes)?))?;
        let volume = TransferTable::new(levels, &light.transport.columns)
            .map_err(|Inconsistent { place, problem }| ClientError::inconsistent(place, problem))?;
        light.volume = Some(volume);
        Ok(Box::new(light))
    }
}
