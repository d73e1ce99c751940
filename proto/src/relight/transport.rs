//! The decoded transport of a bake: receivers, clusters, near hits, and the columns that clusters read.

use std::fmt::Debug;

use glam::{Vec3, Vec4};

use super::{
    ClusterTable, EmitterTable, Inconsistent, Irradiance, NearTable, Panorama, Parallel, ReceiverTable, Sky,
    SlotTable, WalkedTable,
};
use crate::content::{BlockKey, ClusterTransport};

/// Level of columns that no level of detail leaves out.
pub const ALWAYS: u8 = u8::MAX;

/// Meaning of the clusters' columns: how λ is made of the light at receivers and of the sky.
///
/// λ holds J coefficients for each patch or probe, then the sky's.
pub trait Columns: Debug + Send + Sync {
    /// Highest band D; J = (D+1)².
    fn bands(&self) -> u32;

    /// Length of λ.
    fn lambda_count(&self) -> usize;

    /// Place of a column in λ by its key, in units of J.
    fn index(&self, key: u64) -> Option<u32>;

    /// Tree level of a column by its key: levels of detail leave out those below theirs. [`ALWAYS`] for columns without which light
    /// is lost.
    fn level(&self, key: u64) -> u8 {
        let _ = key;
        ALWAYS
    }

    /// Place in λ of the sky as one column, where it is one.
    fn sky_index(&self) -> Option<u32>;

    /// The end of λ: the sky, which no bounce changes.
    fn sky_lambda(&self, sky: Sky) -> Vec<Vec4>;

    /// The same of a panorama.
    fn panorama_lambda(&self, panorama: &Panorama) -> Vec<Vec4>;

    /// The sum of both: light adds up.
    fn skies_lambda(&self, sky: Sky, panorama: Option<&Panorama>) -> Vec<Vec4> {
        let mut lambda = self.sky_lambda(sky);
        if let Some(panorama) = panorama {
            lambda.iter_mut().zip(self.panorama_lambda(panorama)).for_each(|(sum, more)| *sum += more);
        }
        lambda
    }

    /// The start of λ, from the light at receivers.
    fn surface_lambda(
        &self,
        parallel: &impl Parallel,
        receivers: &ReceiverTable,
        irradiance: Irradiance<'_>,
    ) -> Vec<Vec4>;

    /// Coefficients J.
    fn coefficients(&self) -> usize {
        (self.bands() as usize + 1).pow(2)
    }
}

/// Place where the run time reads E_dir.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DirectAt {
    /// At the receiver of a slot.
    Receiver(u32),
    /// At another point of a receiver's texel.
    Texel {
        /// The receiver.
        slot: u32,
        /// The point in metres.
        position_m: Vec3,
        /// The receiver's normal.
        normal: Vec3,
    },
    /// At a point of a surface that no texel stands for.
    Point {
        /// The point in metres.
        position_m: Vec3,
        /// Its unit normal.
        normal: Vec3,
    },
}

/// The decoded transport of a bake, its columns read from `C`.
#[derive(Debug, Default)]
pub struct Transport<C> {
    /// Texel → slot.
    pub slots: SlotTable,
    /// Receivers by slot.
    pub receivers: ReceiverTable,
    /// Clusters and their factors.
    pub clusters: ClusterTable,
    /// Irradiance straight from emissive surfaces.
    pub emitters: EmitterTable,
    /// Near hits.
    pub near: NearTable,
    /// Ends of walks, of receivers that have their light from these.
    pub walked: WalkedTable,
    /// The clusters' columns.
    pub columns: C,
}

impl<C: Columns> Transport<C> {
    /// Joins decoded clusters. `blocks` are the manifest's by key and size, `emitters` the number of its emitters;
    /// `columns` makes the columns, with all receivers in their slots.
    pub fn join(
        blocks: impl IntoIterator<Item = (BlockKey, [u32; 2])>,
        emitters: usize,
        contents: &[ClusterTransport],
        columns: impl FnOnce(&SlotTable) -> Result<C, Inconsistent>,
    ) -> Result<Self, Inconsistent> {
        Self::join_some(blocks, emitters, contents, |_| Ok(()), columns)
    }

    /// As [`Transport::join`], of some of a bake's clusters: `stand_in` says which receivers stand for those that are not there,
    /// see [`super::stand_in`].
    pub fn join_some(
        blocks: impl IntoIterator<Item = (BlockKey, [u32; 2])>,
        emitters: usize,
        contents: &[ClusterTransport],
        stand_in: impl FnOnce(&mut SlotTable) -> Result<(), Inconsistent>,
        columns: impl FnOnce(&SlotTable) -> Result<C, Inconsistent>,
    ) -> Result<Self, Inconsistent> {
        let (mut slots, mut receivers) = (SlotTable::new(blocks)?, ReceiverTable::default());
        for (index, content) in contents.iter().enumerate() {
            let named = |problem| Inconsistent::new(format!("cluster {index}"), problem);
            receivers.push(&content.receivers, &mut slots).map_err(named)?;
        }
        stand_in(&mut slots)?;
        let columns = columns(&slots)?;
        let of_clusters = contents.iter().map(|content| (&content.factors, content.receivers.len()));
        let clusters = ClusterTable::join(of_clusters, &columns)?;
        let of_emitters = contents.iter().map(|content| (&content.emitters[..], content.receivers.len()));
        let emitters = EmitterTable::join(of_emitters, emitters)?;
        let near = NearTable::join(contents, &clusters, &receivers, &slots)?;
        let walked = WalkedTable::default();
        Ok(Self { slots, receivers, clusters, emitters, near, walked, columns })
    }

    /// Irradiance straight from emissive surfaces by slot, W·m⁻²; `scale` is one factor per emitter, 1 if absent.
    pub fn emitter_irradiance(&self, scale: &[f32]) -> Vec<Vec4> {
        self.emitters.irradiance(self.receivers.len(), scale)
    }

    /// λ of the light at receivers; `sky` is [`Columns::sky_lambda`].
    pub fn lambda(&self, parallel: &impl Parallel, irradiance: Irradiance<'_>, sky: &[Vec4]) -> Vec<Vec4> {
        let mut lambda = self.columns.surface_lambda(parallel, &self.receivers, irradiance);
        lambda.extend_from_slice(sky);
        lambda
    }
}
