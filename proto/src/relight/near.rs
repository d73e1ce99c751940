//! Near hits of all clusters, their texels resolved to slots.

use std::collections::HashMap;
use std::f32::consts::FRAC_1_PI;

use glam::Vec4;

use super::{ClusterTable, DirectAt, Inconsistent, Irradiance, Parallel, ReceiverTable, SlotTable, four};
use crate::content::{ClusterTransport, NearHits, NearSurface};

/// The hits of one receiver as shaders read them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct NearRow {
    /// Slot of the receiver.
    pub slot: u32,
    /// First of its hits.
    pub first: u32,
    /// Its hits.
    pub count: u32,
    /// Weight of each, `∫ cosθ dω`.
    pub weight: f32,
}

/// A hit as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct NearHit {
    /// Place in metres.
    pub position_m: [f32; 3],
    /// Slot of the texel that it lies on, or [`OWN_SURFACE`] and the number of a surface of its own.
    pub light: u32,
}

/// Bit of [`NearHit::light`]: the hit lies on a surface that no texel stands for, and has E_emit and E_ind of the receiver that
/// meets it.
pub const OWN_SURFACE: u32 = 1 << 31;

/// A surface that no texel stands for, as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct OwnSurface {
    /// Its unit normal.
    pub normal: Vec4,
    /// Its diffuse albedo ρ.
    pub albedo: Vec4,
}

/// Near hits of a bake. Hits on texels that no light reaches are left out: they are dark.
#[derive(Debug, Default)]
pub struct NearTable {
    /// Receivers that have hits, by slot.
    pub rows: Vec<NearRow>,
    /// Hits, receiver after receiver.
    pub hits: Vec<NearHit>,
    /// Surfaces that no texel stands for.
    pub own: Vec<OwnSurface>,
}

impl NearTable {
    /// Joins the hits of all clusters.
    pub fn join(
        contents: &[ClusterTransport],
        clusters: &ClusterTable,
        receivers: &ReceiverTable,
        slots: &SlotTable,
    ) -> Result<Self, Inconsistent> {
        let (mut table, mut known) = (Self::default(), HashMap::new());
        for (index, (content, cluster)) in contents.iter().zip(&clusters.clusters).enumerate() {
            check(&content.near, cluster.row_count)
                .and_then(|()| table.push(&content.near, cluster.first_row, (receivers, slots), &mut known))
                .map_err(|problem| Inconsistent::new(format!("cluster {index}"), problem))?;
        }
        Ok(table)
    }

    /// Hits.
    pub fn len(&self) -> usize {
        self.hits.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.hits.is_empty()
    }

    /// Place where E_dir of a hit is read.
    pub fn direct_at(&self, hit: usize, receivers: &ReceiverTable) -> DirectAt {
        let hit = &self.hits[hit];
        let position_m = hit.position_m.into();
        match self.own_surface(hit) {
            Some(own) => DirectAt::Point { position_m, normal: own.normal.truncate() },
            None => {
                let normal = receivers.normal[hit.light as usize].truncate();
                DirectAt::Texel { slot: hit.light, position_m, normal }
            }
        }
    }

    /// Places in metres and normals of all hits.
    pub fn surfaces(&self, receivers: &ReceiverTable) -> [Vec<Vec4>; 2] {
        let place = |hit: &NearHit| four(hit.position_m);
        let normal = |hit: &NearHit| {
            self.own_surface(hit).map_or_else(|| receivers.normal[hit.light as usize], |own| own.normal)
        };
        [self.hits.iter().map(place).collect(), self.hits.iter().map(normal).collect()]
    }

    /// `N(r) = w_r Σ_y ρ/π · (E_dir(y) + E_emit + E_ind)` by slot, W·m⁻²; `dir` is E_dir by hit, `irradiance` that of
    /// receivers.
    pub fn gather(
        &self,
        parallel: &impl Parallel,
        receivers: &ReceiverTable,
        dir: &[Vec4],
        irradiance: Irradiance<'_>,
    ) -> Vec<Vec4> {
        let sums = parallel.map(self.rows.len(), |row| {
            let row = &self.rows[row];
            let hits = row.first as usize..(row.first + row.count) as usize;
            // Light that bounces do not change by itself, as adapters have it.
            let (mut direct, mut bounced) = (Vec4::ZERO, Vec4::ZERO);
            for (hit, dir) in self.hits[hits.clone()].iter().zip(&dir[hits]) {
                let (slot, albedo) = match self.own_surface(hit) {
                    Some(own) => (row.slot as usize, own.albedo),
                    None => (hit.light as usize, receivers.albedo[hit.light as usize]),
                };
                direct += albedo * FRAC_1_PI * *dir;
                bounced += albedo * FRAC_1_PI * (irradiance.emit[slot] + irradiance.ind[slot]);
            }
            row.weight * (direct + bounced)
        });
        let mut all = vec![Vec4::ZERO; irradiance.ind.len()];
        self.rows.iter().zip(sums).for_each(|(row, sum)| all[row.slot as usize] = sum);
        all
    }

    /// The surface of a hit that no texel stands for.
    fn own_surface(&self, hit: &NearHit) -> Option<&OwnSurface> {
        (hit.light & OWN_SURFACE != 0).then(|| &self.own[(hit.light & !OWN_SURFACE) as usize])
    }

    /// Adds the hits of a cluster whose receivers begin at slot `first_receiver`.
    fn push(
        &mut self,
        near: &NearHits,
        first_receiver: usize,
        (receivers, slots): (&ReceiverTable, &SlotTable),
        known: &mut HashMap<[u32; 6], u32>,
    ) -> Result<(), String> {
        let blocks = slots.block_indices(&near.blocks)?;
        for (receiver, (hits, &weight)) in near.ranges().zip(&near.weight).enumerate() {
            let slot = first_receiver + receiver;
            let from_m = receivers.position_m[slot].truncate().into();
            let first = self.len() as u32;
            for hit in hits {
                let (light, normal) = match near.surface[hit] {
                    NearSurface::Own { albedo, normal } => {
                        // Faces of a few directions and colours: each is there once.
                        let [[a, b, c], [d, e, f]] = [normal, albedo].map(|of| of.map(f32::to_bits));
                        let own = *known.entry([a, b, c, d, e, f]).or_insert_with(|| {
                            self.own.push(OwnSurface { normal: four(normal), albedo: four(albedo) });
                            self.own.len() as u32 - 1
                        });
                        (OWN_SURFACE | own, normal)
                    }
                    NearSurface::Texel { block, texel } => {
                        let Some(on) = slots.standing(blocks[usize::from(block)], texel) else { continue };
                        (on, receivers.normal[on as usize].truncate().into())
                    }
                };
                self.hits.push(NearHit { position_m: near.position_m(hit, from_m, normal), light });
            }
            let count = self.len() as u32 - first;
            if count > 0 {
                self.rows.push(NearRow { slot: slot as u32, first, count, weight });
            }
        }
        Ok(())
    }
}

/// Checks the hits of a cluster of so many receivers.
fn check(near: &NearHits, receivers: usize) -> Result<(), String> {
    let hits: usize = near.count.iter().map(|&count| usize::from(count)).sum();
    let by_hit = [near.surface.len(), near.offset.len()];
    let by_receiver = [near.count.len(), near.weight.len()];
    let is_blank = by_receiver == [0; 2];
    if by_hit != [hits; 2] || !is_blank && by_receiver != [receivers; 2] {
        return Err(format!("its near hits differ in length: {hits}, {by_hit:?}, {by_receiver:?}"));
    }
    let is_number = near.reach_m.is_finite() && near.weight.iter().all(|weight| weight.is_finite());
    let is_there = |surface: &NearSurface| match surface {
        NearSurface::Texel { block, .. } => usize::from(*block) < near.blocks.len(),
        NearSurface::Own { albedo, normal } => {
            normal.iter().all(|x| x.is_finite()) && albedo.iter().all(|albedo| (0.0..=1.0).contains(albedo))
        }
    };
    if !is_number || !near.surface.iter().all(is_there) {
        return Err("a near hit names no block, or one of its numbers is none".to_owned());
    }
    Ok(())
}
