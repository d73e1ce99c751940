//! How factors are cut into sections, and which prefixes of them are its coarser versions.
//!
//! U is cut by the rows' level and rank group, ΣVᵀ by rank group and band group. A layer is a box (level, rank,
//! bands); layers are nested, and a layer's sections come right after those of the layer before it.

use std::ops::Range;

use super::error::{ChunkError, in_range};
use super::limits::{BANDS_MAX, CLUSTER_KEYS_MAX, RANK_MAX, RECEIVERS_MAX, VT_ENTRIES_MAX};
use super::order::LEVELS_MAX;
use crate::manifest::Layer;

/// Ends of the groups of ranks: 0–8, 8–16, 16–32, 32–64.
pub const RANK_GROUP_ENDS: [u32; 4] = [8, 16, 32, 64];
/// Last bands of the groups of bands: 0–2, 3–4, 5–7, 8–10.
pub const BAND_GROUP_LASTS: [u32; 4] = [2, 4, 7, 10];
/// Most layers of a cluster.
pub const LAYERS_MAX: usize = 4;

/// Counts that decide the grid of sections of some rows' factors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FactorShape {
    /// Rows of each level, finest first; rows without levels are all of the first.
    pub counts: [usize; LEVELS_MAX as usize],
    /// Levels in use.
    pub levels: u32,
    /// Keys of columns.
    pub keys: usize,
    /// Whether columns of the sky follow those of the keys.
    pub sky: bool,
    /// Highest band.
    pub bands: u32,
    /// Rank.
    pub rank: u32,
}

/// A box of the grid that is usable alone: receivers of `level` and coarser, `bands`, `rank`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LayerBox {
    /// Finest receiver level in it.
    pub level: u32,
    /// Highest band in it.
    pub bands: u32,
    /// Rank in it.
    pub rank: u32,
}

impl LayerBox {
    /// As the manifest lists it.
    pub fn with_bytes(self, bytes: u64) -> Layer {
        Layer { bytes, level: self.level, bands: self.bands, rank: self.rank }
    }
}

impl FactorShape {
    /// Errs if a count passes its limit.
    pub fn check(&self, section: &'static str) -> Result<(), ChunkError> {
        let limit =
            |what, value: usize, max: usize| in_range(section, what, value as u64, 0, max as u64).map(drop);
        in_range(section, "levels", self.levels.into(), 1, LEVELS_MAX.into())?;
        limit("bands", self.bands as usize, BANDS_MAX)?;
        limit("rank", self.rank as usize, RANK_MAX)?;
        limit("rows", self.receivers_in(0), RECEIVERS_MAX)?;
        limit("rows of levels not in use", self.counts[self.levels as usize..].iter().sum(), 0)?;
        limit("column keys", self.keys, CLUSTER_KEYS_MAX)?;
        limit("entries of ΣVᵀ", self.rank as usize * self.columns(self.bands), VT_ENTRIES_MAX)
    }

    /// Everything.
    pub(super) fn full(&self) -> LayerBox {
        LayerBox { level: 0, bands: self.bands, rank: self.rank }
    }

    /// The layers, smallest first; the last is everything. Boxes without receivers or like the one before are left
    /// out.
    pub(super) fn layers(&self) -> Vec<LayerBox> {
        let top = self.levels - 1;
        let boxed = |level: u32, bands: u32, rank: u32| LayerBox {
            level,
            bands: bands.min(self.bands),
            rank: rank.min(self.rank),
        };
        let wanted = [boxed(top, 2, 8), boxed(top.saturating_sub(1), 4, 16), boxed(0, 4, 16), self.full()];
        let mut layers: Vec<LayerBox> = Vec::with_capacity(LAYERS_MAX);
        for layer in wanted {
            let last = layer == self.full();
            let empty = self.receivers_in(layer.level) == 0;
            let same = layers.last().is_some_and(|before| self.same_content(*before, layer));
            if same {
                layers.pop();
            }
            if same || last || !empty {
                layers.push(layer);
            }
            if last {
                break;
            }
        }
        layers
    }

    fn same_content(&self, a: LayerBox, b: LayerBox) -> bool {
        // Without ranks there is nothing that bands could add to.
        let same_factors = a.rank == b.rank && (a.rank == 0 || a.bands == b.bands);
        same_factors && self.receivers_in(a.level) == self.receivers_in(b.level)
    }

    /// Receivers of `level` and coarser.
    pub(super) fn receivers_in(&self, level: u32) -> usize {
        self.counts[level as usize..].iter().sum()
    }

    /// Where receivers of `level` lie in stored order.
    pub(super) fn rows_of(&self, level: u32) -> Range<usize> {
        let first = self.receivers_in(level + 1);
        first..first + self.counts[level as usize]
    }

    /// Levels inside `layer` that have receivers, coarsest first.
    pub(super) fn levels_in(&self, layer: LayerBox) -> impl Iterator<Item = u32> + use<> {
        let counts = self.counts;
        (layer.level..self.levels).rev().filter(move |&level| counts[level as usize] > 0)
    }

    /// Levels that `layer` adds to `before`, coarsest first.
    pub(super) fn new_levels(
        &self,
        before: Option<LayerBox>,
        layer: LayerBox,
    ) -> impl Iterator<Item = u32> + use<> {
        let known = before.map_or(self.levels, |before| before.level);
        self.levels_in(layer).filter(move |&level| level < known)
    }

    /// Groups of columns: keys, and the sky.
    pub(super) fn column_groups(&self) -> usize {
        self.keys + usize::from(self.sky)
    }

    /// Columns of ΣVᵀ with bands up to `bands`.
    pub(super) fn columns(&self, bands: u32) -> usize {
        self.column_groups() * (bands as usize + 1) * (bands as usize + 1)
    }
}

/// Ranks of rank group `group`, below `rank`.
pub(super) fn ranks_of(group: usize, rank: u32) -> Range<usize> {
    let first = if group == 0 { 0 } else { RANK_GROUP_ENDS[group - 1] };
    first.min(rank) as usize..RANK_GROUP_ENDS[group].min(rank) as usize
}

/// Coefficients j of band group `group`, of bands up to `bands`.
pub(super) fn coefficients_of(group: usize, bands: u32) -> Range<usize> {
    let square = |band: u32| (band * band) as usize;
    let first = if group == 0 { 0 } else { BAND_GROUP_LASTS[group - 1] + 1 };
    square(first.min(bands + 1))..square(BAND_GROUP_LASTS[group].min(bands) + 1)
}

/// Rank groups that have any of the ranks below `rank`.
pub(super) fn rank_groups(rank: u32) -> Range<usize> {
    0..RANK_GROUP_ENDS.iter().filter(|&&end| end < rank).count() + usize::from(rank > 0)
}

/// Band groups that have any of the bands up to `bands`.
pub(super) fn band_groups(bands: u32) -> Range<usize> {
    0..BAND_GROUP_LASTS.iter().filter(|&&last| last < bands).count() + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(counts: [usize; 4], levels: u32, bands: u32, rank: u32) -> FactorShape {
        FactorShape { counts, levels, keys: 3, sky: false, bands, rank }
    }

    #[test]
    fn layers_are_nested_and_end_in_everything() {
        let shape = shape([768, 192, 64, 0], 3, 7, 24);
        let layers = shape.layers();
        assert_eq!(layers.len(), 4);
        for pair in layers.windows(2) {
            assert!(pair[1].level <= pair[0].level && pair[1].rank >= pair[0].rank);
            assert!(pair[1].bands >= pair[0].bands && pair[0] != pair[1]);
        }
        assert_eq!(layers.last(), Some(&shape.full()));
    }

    #[test]
    fn layers_without_receivers_or_news_are_left_out() {
        assert_eq!(shape([5, 0, 0, 0], 3, 2, 3).layers(), [LayerBox { level: 0, bands: 2, rank: 3 }]);
        assert_eq!(shape([0, 0, 0, 0], 3, 7, 0).layers(), [LayerBox { level: 0, bands: 7, rank: 0 }]);
        assert_eq!(shape([5, 0, 0, 0], 1, 7, 20).layers().len(), 3);
        // Nothing reaches these receivers: bands alone are no news.
        assert_eq!(shape([0, 2, 3, 0], 3, 7, 0).layers().len(), 2);
        assert_eq!(shape([0, 0, 3, 0], 3, 7, 0).layers(), [LayerBox { level: 0, bands: 7, rank: 0 }]);
    }

    #[test]
    fn groups_cover_every_rank_and_coefficient_once() {
        for rank in 0..=64 {
            let ranks: Vec<usize> = rank_groups(rank).flat_map(|group| ranks_of(group, rank)).collect();
            assert_eq!(ranks, (0..rank as usize).collect::<Vec<_>>());
            assert!(rank_groups(rank).all(|group| !ranks_of(group, rank).is_empty()));
        }
        for bands in 0..=10 {
            let js: Vec<usize> = band_groups(bands).flat_map(|group| coefficients_of(group, bands)).collect();
            assert_eq!(js, (0..((bands + 1) * (bands + 1)) as usize).collect::<Vec<_>>());
            assert!(band_groups(bands).all(|group| !coefficients_of(group, bands).is_empty()));
        }
    }
}
