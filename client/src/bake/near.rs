//! Near hits of all clusters with their texels resolved to slots.

use glam::Vec4;
use lightkiln_proto::prt::{NearHits, NearSurface};

use super::atlas::AtlasLayout;
use super::clusters::{ReceiverTable, block_indices};

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
    /// What each counts by, `∫ cosθ dω`.
    pub weight: f32,
}

/// Near hits of a bake. Those on texels that no light reaches are left out: they are dark.
#[derive(Debug, Default)]
pub struct NearTable {
    /// Receivers that have hits, by slot.
    pub rows: Vec<NearRow>,
    /// Slot whose E_emit and E_ind each hit has: that of its texel, or of the receiver that meets it.
    pub slots: Vec<u32>,
    /// Its place in metres.
    pub position_m: Vec<Vec4>,
    /// Unit normal.
    pub normal: Vec<Vec4>,
    /// Diffuse albedo ρ.
    pub albedo: Vec<Vec4>,
}

impl NearTable {
    /// Hits.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Adds the hits of a cluster whose receivers begin at slot `first_receiver`; all receivers are there.
    pub(super) fn add(
        &mut self,
        near: &NearHits,
        first_receiver: usize,
        receivers: &ReceiverTable,
        atlas: &AtlasLayout,
    ) -> Result<(), String> {
        let blocks = block_indices(&near.blocks, atlas)?;
        for (receiver, (hits, &weight)) in near.ranges().zip(&near.weight).enumerate() {
            let slot = first_receiver + receiver;
            let from_m = receivers.position_m[slot].truncate().into();
            let first = self.len() as u32;
            for hit in hits {
                let (light, normal, albedo) = match near.surface[hit] {
                    NearSurface::Own { albedo, normal } => (slot as u32, four(normal), four(albedo)),
                    NearSurface::Texel { block, texel } => {
                        let Some(on) = atlas.slot(blocks[usize::from(block)], texel) else { continue };
                        (on, receivers.normal[on as usize], receivers.albedo[on as usize])
                    }
                };
                self.slots.push(light);
                self.position_m.push(four(near.position_m(hit, from_m, normal.truncate().into())));
                self.normal.push(normal);
                self.albedo.push(albedo);
            }
            let count = self.len() as u32 - first;
            if count > 0 {
                self.rows.push(NearRow { slot: slot as u32, first, count, weight });
            }
        }
        Ok(())
    }
}

fn four([x, y, z]: [f32; 3]) -> Vec4 {
    Vec4::new(x, y, z, 0.0)
}

/// What is wrong with hits of a cluster of so many receivers, if anything is.
pub(super) fn check(near: &NearHits, receivers: usize) -> Result<(), String> {
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
