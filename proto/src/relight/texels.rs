//! Texels of a lightmap: receivers' own, empty ones filled from those near, and the light that surfaces read from them.

use glam::Vec4;

use super::slots::beside;
use super::{ReceiverTable, SlotTable, TexelKind, tap_weights};
use crate::content::{LINKS, Texel};

/// Empty texels as far as this from a receiver are filled. More → bridges larger holes, more memory.
pub const EXTENSION_TEXELS: i32 = 4;

/// Distance of the texels whose light a texel takes that has only a stand-in. More → smoother first light, less detail.
const BLENDED_TEXELS: i32 = 2;

/// The receivers of a lightmap by texel.
#[derive(Clone, Copy, Debug)]
pub struct LightmapTexels<'a> {
    /// Slot of each texel.
    pub slots: &'a SlotTable,
    /// Receivers by slot.
    pub receivers: &'a ReceiverTable,
}

impl LightmapTexels<'_> {
    /// Adds the slots whose mean light a texel holds; none, and the default kind, where it holds nothing.
    ///
    /// An empty texel takes the receivers at the smallest Chebyshev distance within its block, so that bilinear reads at
    /// chart edges never meet an unlit texel. Where receivers are not there yet, texels and those beside them take the mean of the
    /// ones that stand for those around.
    pub fn push_sources(&self, block: u32, texel: Texel, sources: &mut Vec<u32>) -> TexelKind {
        let first = sources.len();
        if self.slots.standing(block, texel).is_some() && self.is_amid_stand_ins(block, texel) {
            self.push_standing(block, texel, sources);
            return TexelKind::FILLED;
        }
        for ring in 0..=EXTENSION_TEXELS {
            self.push_ring(block, texel, ring, sources);
            if sources.len() > first {
                let slot = sources[first] as usize;
                let own = || TexelKind::of_receiver(self.receivers.links[slot], self.receivers.edge[slot]);
                return if ring == 0 { own() } else { TexelKind::FILLED };
            }
        }
        TexelKind::default()
    }

    /// Light that a surface shows at a place of a block, in texels, read as [`tap_weights`] says; `light` is that of a
    /// slot. `None` where no texel around the place holds any, or the block does not exist.
    pub fn shown(&self, block: u32, place: [f32; 2], light: impl Fn(u32) -> Vec4) -> Option<Vec4> {
        let (texels, share) = taps_around(self.slots.size(block)?, place);
        let mut sources = Vec::new();
        let taps = texels.map(|texel| {
            sources.clear();
            let kind = self.push_sources(block, texel, &mut sources);
            let sum: Vec4 = sources.iter().map(|&slot| light(slot)).sum();
            (kind, sum / sources.len().max(1) as f32)
        });
        let weights = tap_weights(taps.map(|(kind, _)| kind), share, share);
        let sum = taps.iter().zip(weights).map(|((_, light), weight)| *light * weight).sum();
        weights.iter().any(|weight| *weight > 0.0).then_some(sum)
    }

    /// Slot of the neighbour at an offset of one texel at most along each axis, if no wall parts it from the receiver of
    /// a texel.
    pub fn linked(&self, block: u32, texel: Texel, [dx, dy]: [i32; 2]) -> Option<u32> {
        let own = self.slots.slot(block, texel)?;
        let other = self.slots.slot(block, beside(texel, [dx, dy])?)?;
        let bit_of = |offset: [i32; 2]| LINKS.iter().position(|link| *link == offset);
        let is_linked = match (bit_of([dx, dy]), bit_of([-dx, -dy])) {
            (Some(bit), _) => self.receivers.links[own as usize] >> bit & 1 == 1,
            (None, Some(bit)) => self.receivers.links[other as usize] >> bit & 1 == 1,
            (None, None) => false,
        };
        is_linked.then_some(other)
    }

    /// Whether a texel, or one beside it on its side of every wall, has no more than a stand-in.
    fn is_amid_stand_ins(&self, block: u32, texel: Texel) -> bool {
        let has_stand_in = |other: Texel| {
            self.slots.are_of_one_side(block, texel, other)
                && self.slots.slot(block, other).is_none()
                && self.slots.standing(block, other).is_some()
        };
        let mut around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [dx, dy]));
        around.any(|offset| beside(texel, offset).is_some_and(has_stand_in))
    }

    /// Adds the receivers that stand for a texel and for those around it on its side of every wall: their mean hides the steps
    /// between what two stand for.
    fn push_standing(&self, block: u32, texel: Texel, sources: &mut Vec<u32>) {
        for dy in [-BLENDED_TEXELS, 0, BLENDED_TEXELS] {
            for dx in [-BLENDED_TEXELS, 0, BLENDED_TEXELS] {
                let other =
                    beside(texel, [dx, dy]).filter(|&other| self.slots.are_of_one_side(block, texel, other));
                sources.extend(other.and_then(|other| self.slots.standing(block, other)));
            }
        }
    }

    /// Adds the receivers at Chebyshev distance `ring` from a texel, in rows.
    fn push_ring(&self, block: u32, texel: Texel, ring: i32, sources: &mut Vec<u32>) {
        let [x, y] = texel.map(i32::from);
        for row in y - ring..=y + ring {
            let on_edge = row == y - ring || row == y + ring;
            let step = if on_edge || ring == 0 { 1 } else { 2 * ring };
            for column in (x - ring..=x + ring).step_by(step as usize) {
                if let (Ok(column), Ok(row)) = (u16::try_from(column), u16::try_from(row)) {
                    sources.extend(self.slots.standing(block, [column, row]));
                }
            }
        }
    }
}

/// The four texels around a place of a block of `size`, those beyond its rim moved onto it, in the order of
/// [`super::Taps`]; and the place between their centres, 0..1 in x and y.
pub fn taps_around(size: [u32; 2], [x, y]: [f32; 2]) -> ([Texel; 4], [f32; 2]) {
    let (x, y) = (x - 0.5, y - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let inside = |index: f32, size: u32| index.clamp(0.0, size as f32 - 1.0) as u16;
    let texels = std::array::from_fn(|tap| {
        [inside(x0 + (tap & 1) as f32, size[0]), inside(y0 + (tap >> 1) as f32, size[1])]
    });
    (texels, [x - x0, y - y0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::content::{Receivers, TexelEdge};

    /// A block of 8 × 4 texels with receivers at these, linked along rows alone; slots in their order.
    fn tables(texels: &[Texel]) -> (SlotTable, ReceiverTable) {
        let count = texels.len();
        let receivers = Receivers {
            blocks: vec![7],
            block: vec![0; count],
            texel: texels.to_vec(),
            position_m: vec![[0.0; 3]; count],
            normal: vec![[0.0, 1.0, 0.0]; count],
            albedo: vec![[0.5; 3]; count],
            links: vec![0b0001; count],
            coverage: vec![u16::MAX; count],
            edge: vec![TexelEdge(u16::MAX); count],
            ..Receivers::default()
        };
        let mut slots = SlotTable::new([(7, [8, 4])]).unwrap();
        let mut table = ReceiverTable::default();
        table.push(&receivers, &mut slots).unwrap();
        (slots, table)
    }

    #[test]
    fn empty_texels_hold_the_mean_of_the_nearest_receivers_and_far_ones_nothing() {
        let (slots, receivers) = tables(&[[0, 0], [0, 1], [2, 0]]);
        let texels = LightmapTexels { slots: &slots, receivers: &receivers };
        let sources = |texel| {
            let mut sources = Vec::new();
            let kind = texels.push_sources(0, texel, &mut sources);
            (kind, sources)
        };
        assert_eq!(sources([0, 0]), (TexelKind::of_receiver(1, TexelEdge(u16::MAX)), vec![0]));
        assert_eq!(sources([1, 0]), (TexelKind::FILLED, vec![0, 2, 1]));
        assert_eq!(sources([6, 0]), (TexelKind::FILLED, vec![2]));
        assert_eq!(sources([7, 0]), (TexelKind::default(), vec![]));
    }

    #[test]
    fn places_show_light_between_linked_receivers_and_none_where_no_texel_holds_any() {
        let (slots, receivers) = tables(&[[0, 0], [1, 0], [0, 1]]);
        let texels = LightmapTexels { slots: &slots, receivers: &receivers };
        let shown = |place| texels.shown(0, place, |slot| Vec4::splat([1.0, 3.0, 100.0][slot as usize]));
        let between = shown([1.0, 0.5]).unwrap().x;
        assert!((between - 2.0).abs() < 1e-3, "{between}");
        // Rows are not linked: the lower receiver counts beyond the middle alone.
        assert!((shown([0.5, 0.9]).unwrap().x - 1.0).abs() < 1e-3);
        assert!((shown([0.5, 1.1]).unwrap().x - 100.0).abs() < 1e-3);
        assert_eq!(shown([7.5, 3.5]), None);
        assert_eq!(texels.shown(1, [0.5; 2], |_| Vec4::ONE), None);
    }

    #[test]
    fn neighbours_are_linked_in_both_directions() {
        let (slots, receivers) = tables(&[[0, 0], [1, 0], [0, 1]]);
        let texels = LightmapTexels { slots: &slots, receivers: &receivers };
        assert_eq!(texels.linked(0, [0, 0], [1, 0]), Some(1));
        assert_eq!(texels.linked(0, [1, 0], [-1, 0]), Some(0));
        assert_eq!(texels.linked(0, [0, 0], [0, 1]), None);
        assert_eq!(texels.linked(0, [0, 0], [-1, 0]), None);
    }
}
