//! Every prefix of a cluster or probe chunk is a coarser version or an error.

use super::scenes::{batch, narrow, wall};
use super::whole::assert_whole;
use crate::chunk::*;
use crate::content::*;
use crate::kinds::sh::*;
use crate::manifest::Layer;

/// `full` when only `layer` of it is kept.
fn kept(full: &ClusterTransport, layer: Layer) -> (usize, Vec<f32>, Vec<f32>) {
    let level = |texel: &Texel| Receivers::level(*texel, 3);
    let receivers = full.receivers.texel.iter().take_while(|texel| level(texel) >= layer.level).count();
    let (rank, full_rank) = (layer.rank as usize, full.factors.rank as usize);
    let u =
        full.factors.u.chunks_exact(full_rank).take(receivers).flat_map(|row| row[..rank].to_vec()).collect();
    let coefficients = (layer.bands as usize + 1) * (layer.bands as usize + 1);
    let rows = full.factors.vt.chunks_exact(full.factors.columns()).take(rank);
    let vt = rows.flat_map(|row| {
        row.chunks_exact(full.factors.coefficients()).flat_map(|p| p[..coefficients].to_vec())
    });
    (receivers, u, vt.collect())
}

#[test]
fn every_layer_prefix_is_the_leading_part_of_the_whole() {
    let cluster = wall(16, 4, 7, 20, 5);
    let encoded = encode_cluster(&cluster, QuantisationSettings::default()).unwrap();
    let full = decode_cluster(&encoded.bytes).unwrap();
    let total = encoded.bytes.len() as u64;
    assert_eq!(encoded.layers.len(), 4);
    assert_eq!(encoded.layers.last().map(|layer| layer.bytes), Some(total));
    assert_eq!(cluster_layers(&encoded.bytes[..700], total).unwrap(), encoded.layers);
    for layer in &encoded.layers {
        let (part, found) = decode_cluster_prefix(&encoded.bytes[..layer.bytes as usize], total).unwrap();
        assert_eq!(&found, layer);
        assert_whole(&part);
        let (receivers, u, vt) = kept(&full, layer.clone());
        assert_eq!((part.receivers.len(), &part.factors.u, &part.factors.vt), (receivers, &u, &vt));
        assert_eq!(part.receivers.position_m, full.receivers.position_m[..receivers]);
        assert_eq!(part.receivers.links, full.receivers.links[..receivers]);
        assert_eq!(part.receivers.coverage, full.receivers.coverage[..receivers]);
        assert_eq!(part.receivers.edge, full.receivers.edge[..receivers]);
        assert_eq!(part.emitters[0].irradiance, full.emitters[0].irradiance[..receivers]);
        assert_eq!((part.factors.bands, part.factors.rank), (layer.bands, layer.rank));
    }
}

#[test]
fn every_layer_has_the_near_hits_of_its_receivers() {
    let encoded = encode_cluster(&narrow(16, 5), QuantisationSettings::default()).unwrap();
    let full = decode_cluster(&encoded.bytes).unwrap().near;
    let total = encoded.bytes.len() as u64;
    assert!(encoded.layers.len() > 2);
    for layer in &encoded.layers {
        let (part, _) = decode_cluster_prefix(&encoded.bytes[..layer.bytes as usize], total).unwrap();
        assert_whole(&part);
        let (receivers, hits) = (part.receivers.len(), part.near.len());
        assert!(hits > 0);
        assert_eq!(
            (&part.near.count[..], &part.near.weight[..]),
            (&full.count[..receivers], &full.weight[..receivers])
        );
        assert_eq!(
            (&part.near.surface[..], &part.near.offset[..]),
            (&full.surface[..hits], &full.offset[..hits])
        );
    }
}

#[test]
fn order_of_near_hits_and_their_blocks_does_not_matter() {
    let mut cluster = narrow(8, 2);
    let bytes =
        |cluster: &ClusterTransport| encode_cluster(cluster, QuantisationSettings::default()).unwrap().bytes;
    let wanted = bytes(&cluster);
    let near = &mut cluster.near;
    near.blocks = vec![700, 5, 11];
    for surface in &mut near.surface {
        if let NearSurface::Texel { block, .. } = surface {
            *block = 2 - 2 * *block;
        }
    }
    let ranges: Vec<_> = near.ranges().collect();
    for hits in ranges {
        near.surface[hits.clone()].reverse();
        near.offset[hits].reverse();
    }
    assert_eq!(bytes(&cluster), wanted);
}

#[test]
fn a_prefix_of_any_length_is_the_largest_layer_in_it_or_an_error() {
    let encoded = encode_cluster(&wall(8, 3, 3, 9, 1), QuantisationSettings::default()).unwrap();
    let total = encoded.bytes.len() as u64;
    for length in 0..=encoded.bytes.len() {
        let largest = encoded.layers.iter().rev().find(|layer| layer.bytes <= length as u64);
        match decode_cluster_prefix(&encoded.bytes[..length], total) {
            Ok((cluster, layer)) => {
                assert_eq!(Some(&layer), largest, "{length}");
                assert_whole(&cluster);
            }
            Err(error) => assert!(largest.is_none(), "{length}: {error}"),
        }
    }
}

#[test]
fn a_prefix_of_a_batch_has_the_first_rays() {
    let batch = batch(5, 64, 9);
    let bytes = encode_probe_batch(&batch).unwrap();
    let full = decode_probe_batch(&bytes).unwrap();
    let mut seen = Vec::new();
    for length in 0..=bytes.len() {
        if let Ok((part, rays)) = decode_probe_batch_prefix(&bytes[..length], bytes.len() as u64) {
            assert_eq!(rays, 64);
            for (part_hits, hits) in
                part.hits.chunks_exact(part.relight_rays as usize).zip(full.hits.chunks_exact(64))
            {
                assert_eq!(part_hits, &hits[..part_hits.len()]);
            }
            seen.push(part.relight_rays);
        }
    }
    seen.dedup();
    assert_eq!(seen, [16, 32, 64]);
}

#[test]
fn order_of_receivers_probes_blocks_and_emitters_does_not_matter() {
    let cluster = wall(8, 3, 2, 5, 4);
    let mut shuffled = cluster.clone();
    let count = cluster.receivers.len();
    let source: Vec<usize> = (0..count).map(|i| (i * 37 + 11) % count).collect();
    let receivers = &mut shuffled.receivers;
    receivers.blocks = vec![99, 11];
    receivers.block = vec![1; count];
    receivers.texel = source.iter().map(|&i| cluster.receivers.texel[i]).collect();
    receivers.position_m = source.iter().map(|&i| cluster.receivers.position_m[i]).collect();
    receivers.albedo = source.iter().map(|&i| cluster.receivers.albedo[i]).collect();
    receivers.emission = source.iter().map(|&i| cluster.receivers.emission[i]).collect();
    receivers.links = source.iter().map(|&i| cluster.receivers.links[i]).collect();
    receivers.coverage = source.iter().map(|&i| cluster.receivers.coverage[i]).collect();
    receivers.edge = source.iter().map(|&i| cluster.receivers.edge[i]).collect();
    shuffled.factors.u =
        source.iter().flat_map(|&i| cluster.factors.u[i * 5..(i + 1) * 5].to_vec()).collect();
    shuffled.factors.keys.reverse();
    let j = cluster.factors.coefficients();
    let rows = cluster.factors.vt.chunks_exact(cluster.factors.columns());
    shuffled.factors.vt = rows
        .flat_map(|row| [&row[2 * j..3 * j], &row[j..2 * j], &row[..j], &row[3 * j..]].concat())
        .collect();
    for emitter in &mut shuffled.emitters {
        emitter.irradiance = source.iter().map(|&i| emitter.irradiance[i]).collect();
    }
    let dark = EmitterIrradiance { emitter: 1, irradiance: vec![[0.0; 3]; count] };
    shuffled.emitters.push(dark.clone());
    let mut wanted = cluster;
    wanted.emitters.insert(0, dark);
    let bytes =
        |cluster: &ClusterTransport| encode_cluster(cluster, QuantisationSettings::default()).unwrap().bytes;
    assert_eq!(bytes(&shuffled), bytes(&wanted));
}

#[test]
fn a_dark_cluster_and_an_empty_one_are_chunks_too() {
    let mut dark = wall(8, 3, 4, 6, 1);
    dark.factors.u.fill(0.0);
    dark.emitters.clear();
    let bytes = encode_cluster(&dark, QuantisationSettings::default()).unwrap().bytes;
    let decoded = decode_cluster(&bytes).unwrap();
    assert!(
        decoded.factors.u.iter().chain(&decoded.factors.vt).all(|&x| x == 0.0),
        "a dark room is exactly dark"
    );
    let none = ClusterTransport {
        factors: TransportFactors { rank: 0, u: vec![], vt: vec![], ..dark.factors },
        ..dark
    };
    let decoded =
        decode_cluster(&encode_cluster(&none, QuantisationSettings::default()).unwrap().bytes).unwrap();
    assert_eq!((decoded.factors.rank, decoded.receivers.len()), (0, 64));
    let empty = encode_cluster(&ClusterTransport::default(), QuantisationSettings::default()).unwrap();
    assert_eq!(decode_cluster(&empty.bytes).unwrap(), ClusterTransport::default());
}
