//! Light of a part of a bake's layers, as a client has it, beside that of the whole.

use std::collections::{HashMap, HashSet};

use anyhow::Result;
use glam::{Vec3, Vec4};
use lightkiln_client::fetch::{Layers, Source};
use lightkiln_client::kinds::prt::only;
use lightkiln_client::stream::{Budget, Candidate, Lit as Place, Plan, Rung, by_need, plan};
use lightkiln_proto::chunk::{decode_cluster, decode_cluster_prefix};
use lightkiln_proto::content::{BlockKey, ClusterTransport, Texel};
use lightkiln_proto::kinds::prt::PATCHES;
use lightkiln_proto::manifest::{CLUSTERS, DIRECTORY, OVERVIEW};
use lightkiln_proto::relight::{DirectAt, PatchTable, Transport};
use lightkiln_worker::reference::Reference;
use rayon::prelude::*;

use super::measure::{Lit, Part, Seen, Whole, direct, joined};

/// Light of as many layers as some bytes bring.
#[derive(Clone, Debug)]
pub struct Streamed {
    /// Name of the light.
    pub light: String,
    /// Bytes over those of all light, manifest counted.
    pub share: f64,
    /// Clusters that are there with some of their layers, and with all.
    pub clusters: [usize; 2],
    /// Energy over that of the whole.
    pub energy: f64,
    /// Relative RMSE of E_ind over all receivers.
    pub error: f64,
}

/// Chunks of a bundle.
pub struct Stored {
    overview: Vec<ClusterTransport>,
    /// By cluster.
    chunks: Vec<Vec<u8>>,
    base_bytes: u64,
}

impl Stored {
    /// Of a bundle.
    pub fn read(source: &Source) -> Result<Self> {
        let (json, manifest) = source.manifest()?;
        let of_role = |role: &str| -> Result<Vec<Vec<u8>>> {
            manifest.chunks(role).iter().map(|chunk| Ok(source.chunk(chunk)?)).collect()
        };
        let overview =
            of_role(OVERVIEW)?.iter().map(|bytes| Ok(decode_cluster(bytes)?)).collect::<Result<_>>()?;
        let base_bytes = json.len() as u64
            + [DIRECTORY, PATCHES, OVERVIEW].iter().map(|role| manifest.bytes_of(role)).sum::<u64>();
        Ok(Self { overview, chunks: of_role(CLUSTERS)?, base_bytes })
    }

    /// Bytes of all light, manifest counted.
    fn bytes_all(&self) -> u64 {
        self.base_bytes + self.chunks.iter().map(|bytes| bytes.len() as u64).sum::<u64>()
    }
}

impl Whole {
    /// Light after the first bytes, and after each share of all bytes that is more, by need under each light; `by_layers` lets
    /// clusters come by layers, else they come whole.
    pub fn streamed(&self, stored: &Stored, shares: &[f64], by_layers: bool) -> Result<Vec<Streamed>> {
        let first = self.part(&stored.overview)?;
        let mut found = Vec::new();
        for lit in &self.lights {
            let seen = self.seen(lit, &first, &[]);
            let bytes_all = stored.bytes_all() as f64;
            for share in shares {
                let bytes = (share * bytes_all) as u64;
                let budget = Budget::of_bytes(bytes.saturating_sub(stored.base_bytes));
                let chosen = self.chosen(&first, &seen.ind, budget, by_layers);
                if !chosen.is_empty() {
                    found.push(self.with(stored, lit, &chosen)?);
                }
            }
            found.push(seen.streamed(lit, stored.base_bytes as f64 / bytes_all, [0; 2]));
        }
        Ok(found)
    }

    /// Light of so many layers of every cluster.
    pub fn of_layers(&self, stored: &Stored, layers: usize) -> Result<Vec<Streamed>> {
        let chosen: Vec<(usize, usize)> =
            (0..stored.chunks.len()).map(|index| (index, layers.min(self.layers(index).count()))).collect();
        self.lights.iter().map(|lit| self.with(stored, lit, &chosen)).collect()
    }

    /// Light of some layers, and of the overview where there are none.
    fn with(&self, stored: &Stored, lit: &Lit, chosen: &[(usize, usize)]) -> Result<Streamed> {
        let (clusters, bytes, whole) = self.decoded(stored, chosen)?;
        let part = self.part(&clusters)?;
        let near = self.near_of(lit, &part.transport)?;
        let share = (stored.base_bytes + bytes) as f64 / stored.bytes_all() as f64;
        Ok(self.seen(lit, &part, &near).streamed(lit, share, [chosen.len(), whole]))
    }

    /// Layers of clusters that a client would have within a budget.
    fn chosen(&self, first: &Part, ind: &[Vec4], budget: Budget, by_layers: bool) -> Vec<(usize, usize)> {
        let place = |(position_m, ind): (&Vec4, &Vec4)| Place {
            position_m: position_m.truncate(),
            irradiance: ind.truncate(),
        };
        let places: Vec<Place> = first.transport.receivers.position_m.iter().zip(ind).map(place).collect();
        let candidates: Vec<Candidate> = (0..self.manifest.clusters.len())
            .map(|index| {
                let of = self.layers(index);
                let rung = |layers: usize| Rung {
                    bytes: of.bytes_of(layers),
                    memory: 0,
                    left: match layers < of.count() {
                        true => Rung::left_after(&of.row.layers[layers - 1], of.row.rank),
                        false => 0.0,
                    },
                };
                let from = if by_layers { 1 } else { of.count() };
                Candidate {
                    bounds_m: of.row.bounds_m.map(Vec3::from),
                    receivers: of.row.receivers,
                    rungs: (from..=of.count()).map(rung).collect(),
                    held: 0,
                    kept: 0,
                }
            })
            .collect();
        let [low, high] = self.manifest.bounds_m.map(Vec3::from);
        let steps = by_need(&candidates, &places, None, low.distance(high));
        let Plan { fetch, .. } = plan(&candidates, &steps, budget);
        let layers = |(index, rungs): (usize, usize)| match by_layers {
            true => (index, rungs),
            false => (index, self.layers(index).count()),
        };
        fetch.into_iter().map(layers).collect()
    }

    fn layers(&self, cluster: usize) -> Layers<'_> {
        Layers {
            cluster,
            row: &self.manifest.clusters[cluster],
            chunk: &self.manifest.chunks(CLUSTERS)[cluster],
        }
    }

    /// Clusters with those receivers of the overview that are in none of them, their bytes, and how many are whole.
    fn decoded(
        &self,
        stored: &Stored,
        chosen: &[(usize, usize)],
    ) -> Result<(Vec<ClusterTransport>, u64, usize)> {
        let mut chosen = chosen.to_vec();
        chosen.sort_unstable();
        let decode = |&(index, layers): &(usize, usize)| -> Result<(ClusterTransport, u64)> {
            let bytes = self.layers(index).bytes_of(layers);
            let chunk = &stored.chunks[index];
            let (cluster, _) = decode_cluster_prefix(&chunk[..bytes as usize], chunk.len() as u64)?;
            Ok((cluster, bytes))
        };
        let found: Vec<(ClusterTransport, u64)> = chosen.par_iter().map(decode).collect::<Result<_>>()?;
        let whole = chosen.iter().filter(|&&(index, layers)| layers == self.layers(index).count()).count();
        let bytes = found.iter().map(|(_, bytes)| bytes).sum();
        let mut clusters: Vec<ClusterTransport> = found.into_iter().map(|(cluster, _)| cluster).collect();
        let names = |cluster: &ClusterTransport| -> Vec<(BlockKey, Texel)> {
            let blocks = &cluster.receivers.blocks;
            let block = cluster.receivers.block.iter().map(|&block| blocks[usize::from(block)]);
            block.zip(cluster.receivers.texel.iter().copied()).collect()
        };
        let there: HashSet<_> = clusters.iter().flat_map(names).collect();
        let rest = |cluster| only(cluster, |name| !there.contains(&name));
        clusters.extend(stored.overview.iter().filter_map(rest));
        Ok((clusters, bytes, whole))
    }

    /// E_dir of the near hits of a part: that of the same hits of the whole.
    fn near_of(&self, lit: &Lit, part: &Transport<PatchTable>) -> Result<Vec<Vec4>> {
        let key = |hit: usize, of: &Transport<PatchTable>| {
            let (DirectAt::Texel { position_m, normal, .. } | DirectAt::Point { position_m, normal }) =
                of.near.direct_at(hit, &of.receivers)
            else {
                return [0; 6];
            };
            let bits = |vector: Vec3| vector.to_array().map(f32::to_bits);
            let [[a, b, c], [d, e, f]] = [bits(position_m), bits(normal)];
            [a, b, c, d, e, f]
        };
        let reference = Reference::new(&self.geometry, &lit.light.lighting)?;
        let known: HashMap<[u32; 6], Vec4> =
            (0..self.transport.near.len()).map(|hit| (key(hit, &self.transport), lit.near[hit])).collect();
        let of_hit = |hit: usize| match known.get(&key(hit, part)) {
            Some(dir) => *dir,
            // A hit on a texel whose receiver another one stands for has that one's normal.
            None => direct(&reference, part, part.near.direct_at(hit, &part.receivers)),
        };
        Ok((0..part.near.len()).into_par_iter().map(of_hit).collect())
    }

    /// Joins clusters with the overview's receivers that are in none of them.
    fn part(&self, clusters: &[ClusterTransport]) -> Result<Part> {
        self.standing(joined(&self.manifest, &self.set, clusters)?)
    }
}

impl Seen {
    fn streamed(&self, lit: &Lit, share: f64, clusters: [usize; 2]) -> Streamed {
        let (energy, error) = (self.energy, self.error);
        Streamed { light: lit.light.name.clone(), share, clusters, energy, error }
    }
}
