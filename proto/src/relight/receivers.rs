//! Receivers by slot.

use glam::Vec4;

use super::{SlotTable, four};
use crate::content::{Receivers, TexelEdge};

/// Most receivers that a bake may have.
pub const MAX_RECEIVERS: usize = 1 << 26;

/// Receivers by slot.
#[derive(Debug, Default)]
pub struct ReceiverTable {
    /// Position in metres.
    pub position_m: Vec<Vec4>,
    /// Unit normal towards the lit side.
    pub normal: Vec<Vec4>,
    /// Diffuse albedo ρ.
    pub albedo: Vec<Vec4>,
    /// Neighbouring texels that no wall parts from it, bits of [`crate::content::LINKS`].
    pub links: Vec<u8>,
    /// Points of its texel, bits of [`Receivers::coverage`].
    pub coverage: Vec<u16>,
    /// Where a wall cuts its texel.
    pub edge: Vec<TexelEdge>,
}

impl ReceiverTable {
    /// Receivers.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }

    /// Adds a cluster's receivers and enters them into `slots`.
    pub(super) fn push(&mut self, receivers: &Receivers, slots: &mut SlotTable) -> Result<(), String> {
        check_lengths(receivers)?;
        if self.len() + receivers.len() > MAX_RECEIVERS {
            return Err(format!("brings the receivers above {MAX_RECEIVERS}"));
        }
        let blocks = slots.block_indices(&receivers.blocks)?;
        for index in 0..receivers.len() {
            let wrong = |problem: &str| format!("receiver {index} {problem}");
            let block =
                *blocks.get(usize::from(receivers.block[index])).ok_or_else(|| wrong("names no block"))?;
            slots.enter(block, receivers.texel[index], self.len() as u32).map_err(wrong)?;
            let vectors = [receivers.position_m[index], receivers.normal[index], receivers.albedo[index]];
            if vectors.iter().flatten().any(|value| !value.is_finite()) {
                return Err(wrong("has a number that is not finite"));
            }
            if vectors[2].iter().any(|albedo| !(0.0..=1.0).contains(albedo)) {
                return Err(wrong("has an albedo outside 0..=1"));
            }
            let [position, normal, albedo] = vectors.map(four);
            self.position_m.push(position);
            self.normal.push(normal);
            self.albedo.push(albedo);
            self.links.push(receivers.links[index]);
            self.coverage.push(receivers.coverage[index]);
            self.edge.push(receivers.edge[index]);
        }
        Ok(())
    }
}

fn check_lengths(receivers: &Receivers) -> Result<(), String> {
    let count = receivers.len();
    let lengths = [
        receivers.block.len(),
        receivers.position_m.len(),
        receivers.normal.len(),
        receivers.albedo.len(),
        receivers.links.len(),
        receivers.coverage.len(),
        receivers.edge.len(),
    ];
    if lengths.iter().any(|length| *length != count) {
        return Err(format!("its receiver arrays differ in length: {count}, {lengths:?}"));
    }
    Ok(())
}
