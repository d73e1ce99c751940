//! A bake's light from its decoded chunks, whatever carries it.

use anyhow::{Context, Result, bail, ensure};
use glam::{DVec3, Vec3, Vec4};
use lightkiln_proto::chunk::decode_patches;
use lightkiln_proto::content::{BlockKey, ClusterTransport, Texel};
use lightkiln_proto::kinds::{self, captured, cloud, field, grid, prt, sh};
use lightkiln_proto::manifest::CLUSTERS;
use lightkiln_proto::relight::{PatchTable, Transport, WalkedTable};
use lightkiln_proto::voxels;
use lightkiln_worker::evaluate::EvaluationError;
use lightkiln_worker::factors::{Baked, Light, Threads};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::reference::Lighting;

use super::LocalBake;

/// Decoded clusters over the columns of either kind.
#[derive(Debug)]
pub enum Decoded {
    /// Over surface patches.
    Patches(Baked<PatchTable>),
    /// Over probes.
    Probes(Baked<sh::ProbeTable>),
}

/// Runs an expression with the clusters of either kind.
macro_rules! either {
    ($decoded:expr, $baked:ident => $value:expr) => {
        match $decoded {
            Decoded::Patches($baked) => $value,
            Decoded::Probes($baked) => $value,
        }
    };
}

impl Decoded {
    /// Decodes all chunks of light.
    pub fn new(bake: &LocalBake) -> Result<Self> {
        let manifest = &bake.manifest;
        let bytes = |digest| {
            bake.chunk(digest).map_err(|error| EvaluationError::Missing { digest, source: error.into() })
        };
        match manifest.kind.as_str() {
            prt::NAME | grid::NAME | cloud::NAME | kinds::voxels::NAME => {
                let chunk = manifest.chunks(prt::PATCHES).first().context("no patches")?;
                let set = decode_patches(&bake.chunk(chunk.digest)?)?;
                let baked = Baked::decode(manifest, &bytes, |slots| PatchTable::new(&set, slots))?;
                let decoded = Self::Patches(baked);
                if manifest.kind == kinds::voxels::NAME { decoded.walked(bake) } else { Ok(decoded) }
            }
            kind => {
                ensure!(kind == sh::NAME, "there is no '{kind}' here");
                let settings: sh::Settings = manifest.settings()?;
                let chunks = manifest.chunks(sh::PROBES).iter();
                let batches: Vec<sh::ProbeBatch> = chunks
                    .map(|chunk| Ok(sh::decode_probe_batch(&bake.chunk(chunk.digest)?)?))
                    .collect::<Result<_>>()?;
                let (rays, bands) = (settings.probes.relight_rays, settings.probes.bands);
                let columns = |slots: &_| sh::ProbeTable::join(&batches, rays, bands, slots);
                Ok(Self::Probes(Baked::decode(manifest, &bytes, columns)?))
            }
        }
    }

    /// It with all of E_ind by walks.
    fn walked(mut self, bake: &LocalBake) -> Result<Self> {
        let (table, patches) = self.voxels(bake)?;
        let Self::Patches(Baked { transport: Transport { receivers, near, .. }, .. }) = &self else {
            bail!("voxels name patches")
        };
        let ends = voxels::walked(&table, patches, receivers, |_| true, &Threads);
        let ends = WalkedTable::new(ends, voxels::WALK_WEIGHT, near)?;
        if let Self::Patches(baked) = &mut self {
            baked.transport.walked = ends;
        }
        Ok(self)
    }

    /// Light under some lights, E_dir at sites given by `direct`: the mean over `sites` of a slot's texel.
    pub fn lit(
        &self,
        lighting: &Lighting,
        sites: impl Fn(u32) -> Vec<Site> + Sync,
        site: impl Fn(u32) -> Site + Sync,
        direct: impl Fn(&Site) -> DVec3 + Sync,
    ) -> Light {
        let direct = |sites: &[Site]| -> std::result::Result<DVec3, std::convert::Infallible> {
            Ok(sites.iter().map(&direct).sum::<DVec3>() / sites.len() as f64)
        };
        let lit = either!(self, baked => baked.lit(lighting, sites, site, direct));
        let Ok(light) = lit;
        light
    }

    /// The field of a bake that has one.
    pub fn field(&self, bake: &LocalBake) -> Result<field::FieldTable> {
        let Self::Patches(baked) = self else { bail!("a field reads patches") };
        let (parts, tetrahedra) = parts(bake)?;
        let (emitters, columns) = (bake.manifest.emitters.len(), &baked.transport.columns);
        Ok(field::FieldTable::join(&parts, tetrahedra.as_ref(), emitters, columns)?)
    }

    /// The voxels of a bake that has some, and the patches that they name.
    pub fn voxels(&self, bake: &LocalBake) -> Result<(voxels::VoxelTable, &PatchTable)> {
        let Self::Patches(baked) = self else { bail!("voxels name patches") };
        let chunks = bake.manifest.chunks(voxels::VOXELS).iter();
        let parts: Vec<voxels::VoxelPart> = chunks
            .map(|chunk| Ok(voxels::decode_voxels(&bake.chunk(chunk.digest)?)?))
            .collect::<Result<_>>()?;
        ensure!(!parts.is_empty(), "the bake has no voxels");
        let patches = &baked.transport.columns;
        Ok((voxels::VoxelTable::of_bake(parts.iter(), patches)?, patches))
    }

    /// Slot of a texel; `None` for those that no light can reach.
    pub fn slot(&self, block: BlockKey, texel: Texel) -> Option<u32> {
        either!(self, baked => baked.transport.slots.slot_of(block, texel))
    }

    /// Place, normal and albedo of a slot.
    pub fn receiver(&self, slot: u32) -> [Vec3; 3] {
        let slot = slot as usize;
        let table = either!(self, baked => &baked.transport.receivers);
        [table.position_m[slot], table.normal[slot], table.albedo[slot]].map(Vec4::truncate)
    }
}

/// The field of a bake whose light is captured, and its coefficients at probes.
pub fn captured(bake: &LocalBake) -> Result<(field::FieldTable, Vec<Vec4>)> {
    let (parts, tetrahedra) = parts(bake)?;
    let table = captured::joined(&bake.manifest.body()?, &parts, tetrahedra.as_ref())?;
    let rows = captured::light(&table, &Threads);
    Ok((table, rows))
}

/// Parts of a bake's field, and its tetrahedra.
fn parts(bake: &LocalBake) -> Result<(Vec<field::FieldPart>, Option<field::TetrahedronSet>)> {
    let chunks = bake.manifest.chunks(field::FIELD).iter();
    let parts: Vec<field::FieldPart> =
        chunks.map(|chunk| Ok(field::decode_field(&bake.chunk(chunk.digest)?)?)).collect::<Result<_>>()?;
    let tetrahedra = bake.manifest.chunks(cloud::TETRAHEDRA).first();
    let tetrahedra =
        tetrahedra.map(|chunk| Ok::<_, anyhow::Error>(field::decode_tetrahedra(&bake.chunk(chunk.digest)?)?));
    Ok((parts, tetrahedra.transpose()?))
}

/// The bake's clusters, decoded.
pub fn clusters(bake: &LocalBake) -> Result<Vec<ClusterTransport>> {
    let chunks = bake.manifest.chunks(CLUSTERS).iter();
    chunks.map(|chunk| Ok(lightkiln_proto::chunk::decode_cluster(&bake.chunk(chunk.digest)?)?)).collect()
}
