//! Colours of a cluster's chunk: they are put in after its factors, which no colour changes and which take far longer.

use super::cluster::{EncodedCluster, Places, check_places, tags};
use super::cluster_head::ClusterHead;
use super::container::{Container, ContainerWriter};
use super::error::{ChunkError, in_range};
use super::order::Arrangement;
use super::table::CLUSTER;
use crate::content::ClusterTransport;

/// The chunk of a cluster with other albedo, emission, irradiance of emitters and colours of near hits. `colourless` is the
/// encoded chunk of `cluster` with all albedo and emission 0; its factors are taken over byte by byte, those of `cluster` are not
/// read. The emitters of both are the same.
///
/// Gives what encoding all of it at once would. Errs as [`super::encode_cluster`] does, and when both are not the same cluster.
pub fn coloured_cluster(
    colourless: &EncodedCluster,
    cluster: &ClusterTransport,
) -> Result<EncodedCluster, ChunkError> {
    check_places(cluster)?;
    let container = Container::whole(CLUSTER, &colourless.bytes)?;
    let head = ClusterHead::read(container.head, container.entries.len())?;
    let arrangement = Arrangement::of(&cluster.receivers, head.shape.levels)?;
    let same = |what, found: usize, wanted: usize| {
        in_range("encoder", what, found as u64, wanted as u64, wanted as u64).map(drop)
    };
    for (found, wanted) in arrangement.counts.into_iter().zip(head.shape.counts) {
        same("receivers of a level", found, wanted)?;
    }
    let places = Places::of(cluster, &arrangement, head.shape)?;
    same("emitters", places.emitters.len(), head.emitters)?;
    // Without colours the palette has one entry, or none without receivers.
    let base_end = 2 * head.emitters + 2 + 12 * head.receivers().min(1);
    let mut writer = ContainerWriter::new(CLUSTER);
    let mut before = None;
    for &(sections, layer) in &head.layers {
        while writer.section_count() < sections {
            let index = writer.section_count();
            let id = container.entries[index].id;
            match id.tag {
                tags::BASE => {
                    let mut base = container.section(index, "base", container.raw_bytes(index))?;
                    base.truncate(base.len().saturating_sub(base_end));
                    places.write_base(&mut base);
                    writer.push(id, &base)?;
                }
                tags::RECEIVERS | tags::NEAR => writer.push(id, &places.section(id.tag, before, layer))?,
                _ => writer.push_stored(id, container.stored(index)?, container.raw_bytes(index))?,
            }
        }
        before = Some(layer);
    }
    let (bytes, ends) = writer.finish(container.head)?;
    let layers = head.layers.iter().map(|&(sections, layer)| layer.with_bytes(ends[sections - 1])).collect();
    let EncodedCluster { quantisation_error, keys, .. } = *colourless;
    Ok(EncodedCluster { bytes, layers, quantisation_error, keys })
}
