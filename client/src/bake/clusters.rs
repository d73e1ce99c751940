//! Clusters joined into receiver tables and flat factor arrays.

use glam::Vec4;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::{BasisKind, BlockKey, ClusterTransport, ProbeKey, Receivers};

use super::atlas::AtlasLayout;
use super::{MAX_RECEIVERS, near};
use crate::error::{ClientError, Result};

/// Highest rank of a cluster that is read.
const MAX_RANK: u32 = 256;

/// Receivers by slot; the fourth component is 0 everywhere, so that adapters can read the arrays as they are.
#[derive(Debug, Default)]
pub struct ReceiverTable {
    /// Position in metres.
    pub position_m: Vec<Vec4>,
    /// Unit normal towards the lit side.
    pub normal: Vec<Vec4>,
    /// Diffuse albedo ρ.
    pub albedo: Vec<Vec4>,
    /// Which neighbouring texels no wall stands between, bits of [`lightkiln_proto::prt::LINKS`].
    pub links: Vec<u8>,
}

impl ReceiverTable {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }
}

/// A cluster's share of the flat arrays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cluster {
    /// First slot.
    pub first_receiver: usize,
    /// Receivers.
    pub receiver_count: usize,
    /// First entry in [`ClusterTable::support`].
    pub first_support: usize,
    /// Supporting probes, the sky included.
    pub support_count: usize,
    /// Coefficients per probe, J of this cluster.
    pub coefficients: usize,
    /// Rank k.
    pub rank: usize,
    /// First of its k entries in the array b.
    pub first_b: usize,
    /// First element of U in [`ClusterTable::u`], receiver-major.
    pub first_u: usize,
    /// First element of ΣVᵀ in [`ClusterTable::vt`], rank-major.
    pub first_vt: usize,
}

impl Cluster {
    /// Columns n of ΣVᵀ.
    pub fn columns(&self) -> usize {
        self.support_count * self.coefficients
    }
}

/// Irradiance straight from one emitter at one cluster's receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct EmitterPart {
    /// Emitter.
    pub emitter: u16,
    /// First slot.
    pub first_receiver: usize,
    /// W·m⁻² at scale 1, one per receiver.
    pub irradiance: Vec<[f32; 3]>,
}

/// Clusters and their factors.
#[derive(Debug, Default)]
pub struct ClusterTable {
    /// Clusters in the manifest's order.
    pub clusters: Vec<Cluster>,
    /// U of all clusters.
    pub u: Vec<f32>,
    /// ΣVᵀ of all clusters.
    pub vt: Vec<f32>,
    /// Indices of the probes that support each cluster, the number of probes standing for the sky; or of patches and,
    /// after them, parts of the sky.
    pub support: Vec<u32>,
    /// Length of the array b: Σ k.
    pub b_len: usize,
    /// Irradiance straight from emissive surfaces.
    pub emitters: Vec<EmitterPart>,
    support_keys: Vec<Option<ProbeKey>>,
}

impl ClusterTable {
    /// Turns keys into indices of what they name; the sky's is `sky`.
    pub(super) fn resolve_support(
        &mut self,
        what: &str,
        sky: u32,
        index: impl Fn(ProbeKey) -> Option<u32>,
    ) -> Result<()> {
        let resolve = |key: &Option<ProbeKey>| match key {
            None => Ok(sky),
            Some(key) => index(*key).ok_or_else(|| {
                ClientError::inconsistent(
                    "clusters",
                    format!("{what} {key:016x} supports one but is in no chunk"),
                )
            }),
        };
        self.support = self.support_keys.iter().map(resolve).collect::<Result<_>>()?;
        self.support_keys = Vec::new();
        Ok(())
    }
}

/// Joins clusters; receivers get slots and enter the atlas.
pub(super) fn join(
    manifest: &Manifest,
    contents: &[ClusterTransport],
    atlas: &mut AtlasLayout,
) -> Result<(ReceiverTable, ClusterTable)> {
    let (mut receivers, mut table) = (ReceiverTable::default(), ClusterTable::default());
    for (index, content) in contents.iter().enumerate() {
        let wrong = |problem: String| ClientError::inconsistent(format!("cluster {index}"), problem);
        check(content, manifest).map_err(wrong)?;
        if receivers.len() + content.receivers.len() > MAX_RECEIVERS {
            return Err(wrong(format!("brings the receivers above {MAX_RECEIVERS}")));
        }
        enter_receivers(&content.receivers, &mut receivers, atlas).map_err(wrong)?;
        table.push(content, receivers.len());
    }
    Ok((receivers, table))
}

impl ClusterTable {
    fn push(&mut self, content: &ClusterTransport, receivers_after: usize) {
        let receiver_count = content.receivers.len();
        let first_receiver = receivers_after - receiver_count;
        let first_support = self.support_keys.len();
        self.support_keys.extend(content.probes.iter().copied().map(Some));
        self.support_keys.extend(content.sky.then_some(None));
        self.clusters.push(Cluster {
            first_receiver,
            receiver_count,
            first_support,
            support_count: self.support_keys.len() - first_support,
            coefficients: content.coefficients(),
            rank: content.rank as usize,
            first_b: self.b_len,
            first_u: self.u.len(),
            first_vt: self.vt.len(),
        });
        self.b_len += content.rank as usize;
        self.u.extend_from_slice(&content.u);
        self.vt.extend_from_slice(&content.vt);
        self.emitters.extend(content.emitters.iter().map(|part| EmitterPart {
            emitter: part.emitter,
            first_receiver,
            irradiance: part.irradiance.clone(),
        }));
    }
}

fn check(content: &ClusterTransport, manifest: &Manifest) -> std::result::Result<(), String> {
    let receivers = &content.receivers;
    let count = receivers.len();
    let lengths = [
        receivers.block.len(),
        receivers.position_m.len(),
        receivers.normal.len(),
        receivers.albedo.len(),
        receivers.links.len(),
    ];
    if lengths.iter().any(|length| *length != count) {
        return Err(format!("its receiver arrays differ in length: {count}, {lengths:?}"));
    }
    if content.sky && manifest.settings.basis == BasisKind::Patches {
        return Err("has columns of the sky, which patches have parts for".to_owned());
    }
    if content.bands > manifest.settings.coefficient_bands() {
        return Err(format!(
            "has {} bands, the bake {}",
            content.bands,
            manifest.settings.coefficient_bands()
        ));
    }
    if content.rank > MAX_RANK {
        return Err(format!("has rank {}, at most {MAX_RANK}", content.rank));
    }
    let rank = content.rank as usize;
    if content.u.len() != count * rank || content.vt.len() != content.columns() * rank {
        return Err("its factors do not have the lengths that rank, receivers and probes ask for".to_owned());
    }
    if !content.u.iter().chain(&content.vt).all(|value| value.is_finite()) {
        return Err("a factor is not a finite number".to_owned());
    }
    for part in &content.emitters {
        if part.irradiance.len() != count || usize::from(part.emitter) >= manifest.emitters.len() {
            return Err(format!("its light from emitter {} has a wrong length or no emitter", part.emitter));
        }
    }
    near::check(&content.near, count)
}

fn enter_receivers(
    receivers: &Receivers,
    table: &mut ReceiverTable,
    atlas: &mut AtlasLayout,
) -> std::result::Result<(), String> {
    let blocks = block_indices(&receivers.blocks, atlas)?;
    for index in 0..receivers.len() {
        let wrong = |problem: &str| format!("receiver {index} {problem}");
        let block =
            *blocks.get(usize::from(receivers.block[index])).ok_or_else(|| wrong("names no block"))?;
        atlas.enter(block, receivers.texel[index], table.len() as u32).map_err(wrong)?;
        let vectors = [receivers.position_m[index], receivers.normal[index], receivers.albedo[index]];
        if vectors.iter().flatten().any(|value| !value.is_finite()) {
            return Err(wrong("has a number that is not finite"));
        }
        if vectors[2].iter().any(|albedo| !(0.0..=1.0).contains(albedo)) {
            return Err(wrong("has an albedo outside 0..=1"));
        }
        let [position, normal, albedo] = vectors.map(|[x, y, z]| Vec4::new(x, y, z, 0.0));
        table.position_m.push(position);
        table.normal.push(normal);
        table.albedo.push(albedo);
        table.links.push(receivers.links[index]);
    }
    Ok(())
}

/// Indices of blocks in the manifest.
pub(super) fn block_indices(keys: &[BlockKey], atlas: &AtlasLayout) -> std::result::Result<Vec<u32>, String> {
    let find = |key: &BlockKey| {
        atlas.block_index(*key).ok_or_else(|| format!("names block {key:016x}, which the manifest lacks"))
    };
    keys.iter().map(find).collect()
}
