//! Where a lamp's rays end on surfaces that light a region of the scene: learned from paths, so that few go astray.
//!
//! A sun through a narrow window lights a small patch of floor, and that patch the room. Directions from the room seldom
//! meet the patch, and rays of the sun seldom pass the window. The guide holds the chance with which a cell of a lamp's
//! square ([`super::beams`]) is tried, in proportion to the light that it was found to bring (\[Vorba2014\] learn directions
//! likewise): blocks of cells by region of space, cells in a block for all the scene. Chances may be 0: directions find the
//! light then.

use std::collections::BTreeMap;

use glam::Vec3;

/// Blocks along each side of a lamp's square, and cells along each side of a block. More → closer fit, longer learning.
const BLOCKS: u32 = 8;
const CELLS: u32 = 8;
/// Cells of a block.
const BLOCK: u32 = CELLS * CELLS;
/// Cells of a lamp's square, blocks one after the other.
pub(super) const SQUARE: u32 = BLOCKS * BLOCKS * BLOCK;
/// Regions along the scene's longest side. More → closer fit, longer learning.
const REGIONS: f32 = 12.0;
/// Findings after which a region's own chances count as much as those of the whole scene.
const FINDINGS: f64 = 64.0;

/// Light that one try brought to a region by way of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finding {
    pub region: u32,
    pub cell: u32,
    /// Luminance in W·m⁻².
    pub light: f64,
}

/// Cells with their chances.
#[derive(Clone, Debug, Default)]
struct Table {
    /// Ascending.
    cells: Vec<u32>,
    /// Sum of the chances up to each, 1 at the end.
    ends: Vec<f64>,
}

impl Table {
    fn of(lights: &BTreeMap<u32, f64>) -> Self {
        let total: f64 = lights.values().sum();
        let mut table = Self::default();
        let mut sum = 0.0;
        for (&cell, light) in lights {
            sum += light / total;
            table.cells.push(cell);
            table.ends.push(sum);
        }
        table
    }

    fn chance(&self, cell: u32) -> f64 {
        let Ok(index) = self.cells.binary_search(&cell) else { return 0.0 };
        self.ends[index] - index.checked_sub(1).map_or(0.0, |before| self.ends[before])
    }

    fn pick(&self, share: f64) -> Option<u32> {
        let index = self.ends.partition_point(|&end| end <= share);
        self.cells.get(index.min(self.cells.len().saturating_sub(1))).copied()
    }

    /// Sum of the chances of the cells before one.
    fn before(&self, cell: u32) -> f64 {
        let index = self.cells.partition_point(|&known| known < cell);
        index.checked_sub(1).map_or(0.0, |last| self.ends[last])
    }

    /// Where a block's cells begin and end among the chances.
    fn block(&self, block: u32) -> [f64; 2] {
        [block, block + 1].map(|block| self.before(block * BLOCK))
    }
}

/// The cell of a point of a lamp's square.
pub(super) fn cell_at(lamp: usize, square: [f32; 2]) -> u32 {
    let [x, y] = square.map(|share| ((share * (BLOCKS * CELLS) as f32) as u32).min(BLOCKS * CELLS - 1));
    let block = y / CELLS * BLOCKS + x / CELLS;
    lamp as u32 * SQUARE + block * BLOCK + y % CELLS * CELLS + x % CELLS
}

/// A point of the square of a cell's lamp, from a point of the cell.
pub(super) fn square_of(cell: u32, within: [f32; 2]) -> [f32; 2] {
    let (block, inside) = (cell % SQUARE / BLOCK, cell % BLOCK);
    let x = (block % BLOCKS * CELLS + inside % CELLS) as f32 + within[0];
    let y = (block / BLOCKS * CELLS + inside / CELLS) as f32 + within[1];
    [x, y].map(|place| place / (BLOCKS * CELLS) as f32)
}

/// Chances of cells by region.
#[derive(Clone, Debug)]
pub(super) struct Guide {
    low_m: Vec3,
    regions_per_m: f32,
    all: Table,
    /// A region's own chances of blocks, and the share with which they are taken.
    regions: BTreeMap<u32, (Table, f64)>,
}

impl Guide {
    /// Every cell of so many lamps with the same chance.
    pub fn even(lamps: usize, [low_m, high_m]: [Vec3; 2]) -> Self {
        let cells = (0..lamps as u32 * SQUARE).map(|cell| (cell, 1.0)).collect();
        let regions_per_m = REGIONS / (high_m - low_m).max_element().max(f32::MIN_POSITIVE);
        Self { low_m, regions_per_m, all: Table::of(&cells), regions: BTreeMap::new() }
    }

    /// Chances in proportion to the light found; none where nothing was.
    pub fn learned(&self, findings: &[Finding]) -> Self {
        let mut all: BTreeMap<u32, f64> = BTreeMap::new();
        let mut by_region: BTreeMap<u32, (BTreeMap<u32, f64>, f64)> = BTreeMap::new();
        for finding in findings {
            *all.entry(finding.cell).or_default() += finding.light;
            let (blocks, count) = by_region.entry(finding.region).or_default();
            *blocks.entry(finding.cell / BLOCK).or_default() += finding.light;
            *count += 1.0;
        }
        let regions = by_region
            .into_iter()
            .map(|(region, (cells, count))| (region, (Table::of(&cells), count / (count + FINDINGS))));
        Self { all: Table::of(&all), regions: regions.collect(), ..*self }
    }

    /// Number of the region of a point.
    pub fn region(&self, position_m: Vec3) -> u32 {
        let cell = ((position_m - self.low_m) * self.regions_per_m).clamp(Vec3::ZERO, Vec3::splat(REGIONS));
        let [x, y, z] = cell.to_array().map(|axis| axis as u32);
        (z << 16) | (y << 8) | x
    }

    /// Chance of a cell in a region.
    pub fn chance(&self, region: u32, cell: u32) -> f64 {
        let of_all = self.all.chance(cell);
        let Some((own, share)) = self.regions.get(&region).filter(|_| of_all > 0.0) else { return of_all };
        let [start, end] = self.all.block(cell / BLOCK);
        of_all * (share * own.chance(cell / BLOCK) / (end - start) + 1.0 - share)
    }

    /// A cell with its chance in a region, from a number in 0..1; `None` where no light was found at all.
    pub fn pick(&self, region: u32, share: f32) -> Option<(u32, f64)> {
        let share = f64::from(share);
        let cell = match self.regions.get(&region) {
            Some((own, of_own)) if share < *of_own => {
                // The place within the block's part of the own chances is its place within the block.
                let own_share = share / of_own;
                let block = own.pick(own_share)?;
                let within = (own_share - own.before(block)) / own.chance(block);
                let [start, end] = self.all.block(block);
                self.all.pick(start + within.clamp(0.0, 1.0 - 1e-9) * (end - start))
            }
            Some((_, of_own)) => self.all.pick((share - of_own) / (1.0 - of_own)),
            None => self.all.pick(share),
        }?;
        Some((cell, self.chance(region, cell)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_picked_as_often_as_their_chance_says() {
        let even = Guide::even(1, [Vec3::ZERO, Vec3::ONE]);
        let [here, there] = [Vec3::ZERO, Vec3::ONE].map(|at| even.region(at));
        let finding = |region, cell, light| Finding { region, cell, light };
        let guide = even.learned(&[finding(here, 3, 1.0), finding(here, 70, 3.0), finding(there, 700, 4.0)]);
        for region in [here, there, even.region(Vec3::splat(0.5))] {
            let count = 10_000;
            let mut picks: BTreeMap<u32, f64> = BTreeMap::new();
            for index in 0..count {
                let (cell, chance) = guide.pick(region, (index as f32 + 0.5) / count as f32).unwrap();
                assert!((chance - guide.chance(region, cell)).abs() < 1e-12);
                *picks.entry(cell).or_default() += 1.0 / f64::from(count);
            }
            assert_eq!(picks.keys().copied().collect::<Vec<_>>(), [3, 70, 700]);
            for (cell, share) in picks {
                assert!((share - guide.chance(region, cell)).abs() < 1e-3, "{region} {cell} {share}");
            }
        }
        assert!(guide.chance(here, 70) > guide.chance(there, 70));
    }

    #[test]
    fn a_point_of_a_cell_lies_in_that_cell() {
        for cell in (0..3 * SQUARE).step_by(97) {
            let square = square_of(cell, [0.25, 0.75]);
            assert_eq!(cell_at((cell / SQUARE) as usize, square), cell);
        }
    }

    #[test]
    fn nothing_found_gives_nothing_to_try() {
        let guide = Guide::even(2, [Vec3::ZERO, Vec3::ONE]);
        assert!(guide.pick(0, 0.3).is_some());
        assert_eq!(guide.learned(&[]).pick(0, 0.3), None);
    }
}
