//! Clusters by layers, as a client takes them: a directory's row, true or lying, and the first bytes of a chunk.

use lightkiln_client::fetch::{Layers, decoded_layers};
use lightkiln_proto::chunk::{cluster_layers, decode_cluster};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{ChunkRef, ClusterRow, PrefixCheck};

use super::container::packed;
use super::{Target, chunks, taken};

/// The lie that the first byte tells, then a cluster.
pub const LAYERS: Target = Target {
    name: "layers",
    read: |bytes| forms(bytes).iter().any(|bytes| read(bytes)),
    check: |bytes| forms(bytes).iter().for_each(|bytes| check(bytes)),
    seeds: || {
        let clusters = (chunks::CLUSTER.seeds)();
        let lies = clusters.iter().flat_map(|chunk| [0, 1, 2, 3, 4].map(|lie| [&[lie], &chunk[..]].concat()));
        lies.collect()
    },
    memory_max: chunks::CLUSTER.memory_max,
};

/// The bytes, and the chunk that they are the unpacked form of.
fn forms(bytes: &[u8]) -> Vec<Vec<u8>> {
    let Some((lie, chunk)) = bytes.split_first() else { return Vec::new() };
    let packed = packed(chunk).map(|chunk| [&[*lie], &chunk[..]].concat());
    [Some(bytes.to_vec()), packed].into_iter().flatten().collect()
}

/// A row for the chunk, and whether it says the truth; `None` for bytes whose layers nobody can list.
fn row(lie: u8, chunk: &[u8]) -> Option<(ClusterRow, bool)> {
    let mut layers = cluster_layers(chunk, chunk.len() as u64).ok()?;
    let receivers = decode_cluster(chunk).map_or(0, |cluster| cluster.receivers.len() as u32);
    let checks = PrefixCheck::of_prefixes(chunk, &layers);
    let at = usize::from(lie >> 3) % layers.len();
    match lie & 7 {
        1 => layers[at].rank ^= 1,
        2 => layers[at].level ^= 1,
        3 => layers[at].bytes += 1,
        _ => {}
    }
    let row = ClusterRow {
        bounds_m: [[0.0; 3]; 2],
        receivers,
        keys: 0,
        rank: 0,
        truncation_error: 0.0,
        quantisation_error: 0.0,
        uncovered_fraction: 0.0,
        layers,
        checks,
    };
    Some((row, !(1..=3).contains(&(lie & 7))))
}

fn read(bytes: &[u8]) -> bool {
    let Some((row, _)) = row(bytes[0], &bytes[1..]) else { return false };
    let chunk = ChunkRef { digest: Digest::of(b""), bytes: bytes.len() as u64 - 1 };
    taken(&decoded_layers(Layers { cluster: 7, row: &row, chunk: &chunk }, &bytes[1..]))
}

fn check(bytes: &[u8]) {
    let whole = &bytes[1..];
    let Some((row, is_true)) = row(bytes[0], whole) else { return };
    let chunk = ChunkRef { digest: Digest::of(whole), bytes: whole.len() as u64 };
    let of = Layers { cluster: 7, row: &row, chunk: &chunk };
    let mut before = 0;
    for layers in 1..=of.count() {
        let prefix = &whole[..(of.bytes_of(layers) as usize).min(whole.len())];
        let found = decoded_layers(of, prefix);
        assert!(is_true || found.is_err(), "layers that the chunk has not were taken");
        if let Ok((cluster, found)) = found {
            assert_eq!(found, layers);
            let receivers = cluster.receivers.len();
            assert!(receivers >= before && receivers <= row.receivers as usize);
            before = receivers;
        }
        // A layer cut short is never taken for it.
        let cut = &prefix[..prefix.len().saturating_sub(1)];
        assert!(decoded_layers(of, cut).map_or(true, |(_, found)| found < layers));
    }
}
