//! A cluster without colours, as `prt.transport` gives it: no ray and no factor hangs on the albedo or the emission of a surface, so
//! that a change of either makes no transport anew. `prt.colour` puts them in.

use lightkiln_proto::chunk::{EncodedCluster, coloured_cluster, encode_directory};
use lightkiln_proto::content::{
    BlockKey, ClusterTransport, EmitterIrradiance, NearHits, NearSurface, Receivers, Texel,
};
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::PAGE_OUTPUT;
use lightkiln_proto::manifest::Layer;
use serde::{Deserialize, Serialize};

use crate::emitters::radiance_of_emitters;
use crate::factors::{CellIndex, Piece};
use crate::lightmap::{Lightmap, Numbering, World};
use crate::task::{Context, TaskError, TaskOutput, artefact};

/// Magic of the artefact.
const ARTEFACT_MAGIC: &[u8; 4] = b"LKcu";
/// Name of a cell's transport among the inputs of its colours.
pub const TRANSPORT_INPUT: &str = "rays";

/// A receiver by name.
type ReceiverName = (BlockKey, Texel);

/// A cluster whose albedo and emission are 0, and whose emitters have radiance 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Colourless {
    bounds_m: [[f32; 3]; 2],
    receivers: Receivers,
    emitters: Vec<EmitterIrradiance>,
    near: NearHits,
    /// Receivers that near hits with surfaces of their own have the albedo of, in the order of the hits.
    near_own: Vec<ReceiverName>,
    /// Its chunk.
    bytes: Vec<u8>,
    layers: Vec<Layer>,
    quantisation_error: f32,
    keys: u32,
}

impl Colourless {
    /// Takes the colours out of a piece.
    pub fn take_from(piece: &mut Piece) {
        let ClusterTransport { receivers, near, .. } = &mut piece.transport;
        receivers.albedo.fill([0.0; 3]);
        receivers.emission.fill([0.0; 3]);
        for surface in &mut near.surface {
            if let NearSurface::Own { albedo, .. } = surface {
                *albedo = [0.0; 3];
            }
        }
    }

    /// Of a piece without colours, encoded.
    pub fn of(piece: Piece, near_own: Vec<ReceiverName>, encoded: EncodedCluster) -> Self {
        let ClusterTransport { bounds_m, receivers, emitters, near, .. } = piece.transport;
        let EncodedCluster { bytes, layers, quantisation_error, keys } = encoded;
        Self { bounds_m, receivers, emitters, near, near_own, bytes, layers, quantisation_error, keys }
    }

    /// The artefact.
    pub fn encoded(&self) -> Result<Vec<u8>, TaskError> {
        artefact::encode(ARTEFACT_MAGIC, self)
    }

    /// The chunk with the colours that a lightmap has now, and with the radiance of each emitter.
    fn coloured(mut self, lightmap: &Lightmap, radiance: &[[f32; 3]]) -> Result<EncodedCluster, TaskError> {
        let names = (0..self.receivers.len()).map(|row| {
            (self.receivers.blocks[usize::from(self.receivers.block[row])], self.receivers.texel[row])
        });
        let names: Vec<ReceiverName> = names.collect();
        let found = found(lightmap, names.iter().chain(&self.near_own).copied())?;
        let (own, near_own) = found.split_at(names.len());
        self.receivers.albedo = own.iter().map(|&at| lightmap.receivers[at as usize].albedo).collect();
        self.receivers.emission = own.iter().map(|&at| lightmap.receivers[at as usize].emission).collect();
        let own_surfaces = self.near.surface.iter_mut().filter_map(|surface| match surface {
            NearSurface::Own { albedo, .. } => Some(albedo),
            NearSurface::Texel { .. } => None,
        });
        own_surfaces.zip(near_own).for_each(|(albedo, &at)| *albedo = lightmap.receivers[at as usize].albedo);
        for column in &mut self.emitters {
            let Some(radiance) = radiance.get(usize::from(column.emitter)) else { continue };
            for irradiance in &mut column.irradiance {
                *irradiance = [0, 1, 2].map(|channel| irradiance[channel] * radiance[channel]);
            }
        }
        let Self { bounds_m, receivers, emitters, near, bytes, layers, quantisation_error, keys, .. } = self;
        let cluster = ClusterTransport { bounds_m, receivers, emitters, near, ..ClusterTransport::default() };
        let colourless = EncodedCluster { bytes, layers, quantisation_error, keys };
        coloured_cluster(&colourless, &cluster)
            .map_err(|error| TaskError::bad_input_from("a cluster cannot be stored", error))
    }
}

/// Indices of receivers by their names.
fn found(
    lightmap: &Lightmap,
    names: impl Iterator<Item = ReceiverName> + Clone,
) -> Result<Vec<u32>, TaskError> {
    let keys = Numbering::of(names.clone().map(|(key, _)| key));
    let mut block_of = vec![None; keys.len()];
    for (index, block) in (0..).zip(&lightmap.blocks) {
        if let Some(place) = keys.find(block.key) {
            block_of[place] = Some(index);
        }
    }
    let index = |(key, [x, y]): ReceiverName| {
        block_of[keys.place(key)].and_then(|block| lightmap.receiver_at(block, x.into(), y.into()))
    };
    let absent = || TaskError::bad_input("a cluster has a receiver that the lightmap does not have");
    names.map(index).collect::<Option<_>>().ok_or_else(absent)
}

/// Runs task `prt.colour`: inputs `import/scene`, those of the lightmap, and `rays/…`, the outputs of a cell's transport; outputs
/// `chunk/N`, `index`, and `page`, which tells whoever follows the bake of the chunks.
pub fn run(context: &Context, _: &TaskSpec) -> Result<TaskOutput, TaskError> {
    let world = World::of(context)?;
    let radiance = radiance_of_emitters(&world.geometry.scene);
    let name = format!("{TRANSPORT_INPUT}/{}", CellIndex::OUTPUT);
    let index = CellIndex::decoded(&context.bytes(&name)?)?;
    let mut coloured = Vec::with_capacity(index.clusters.len());
    for number in 0..index.clusters.len() {
        context.progress.check()?;
        let name = format!("{TRANSPORT_INPUT}/{}", output(number));
        let (colourless, _): (Colourless, _) = context.decoded(ARTEFACT_MAGIC, &name)?;
        coloured.push(colourless.coloured(&world.lightmap, &radiance)?);
    }
    let (mut output, index) = crate::factors::stored_as(coloured, index)?;
    let page = encode_directory(&index.clusters, &index.chunks)
        .map_err(|error| TaskError::bad_input_from("the clusters of a cell cannot be listed", error))?;
    output.artefacts.push((PAGE_OUTPUT.to_owned(), page));
    Ok(output)
}

/// Name of a cell's cluster of that number among the outputs of transport.
pub fn output(number: usize) -> String {
    format!("cluster/{number}")
}
