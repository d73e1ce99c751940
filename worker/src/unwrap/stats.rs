//! How well an unwrap uses its texels.

use glam::DVec2;

use super::Unwrap;
use super::overlap::any_cell;

/// Figures for reports and tuning.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnwrapStats {
    /// Charts of all blocks.
    pub chart_count: u64,
    /// Unwrapped triangles, parts of cut ones counted each.
    pub triangle_count: u64,
    /// Texels of all blocks.
    pub block_texels: u64,
    /// Texels that a triangle reaches by any part.
    pub covered_texels: u64,
}

impl UnwrapStats {
    /// Share of block texels that are covered, 0..=1.
    pub fn utilisation(&self) -> f64 {
        self.covered_texels as f64 / self.block_texels.max(1) as f64
    }
}

impl Unwrap {
    /// Counts charts and texels; costs about as much as rasterising all triangles.
    pub fn stats(&self) -> UnwrapStats {
        let mut stats = UnwrapStats::default();
        for block in &self.blocks {
            let mut covered = vec![false; block.width as usize * block.height as usize];
            let mut charts: Vec<u32> = Vec::new();
            for triangle in &block.triangles {
                charts.push(triangle.chart);
                let uv: [DVec2; 3] = triangle.uv_texels.map(|p| p.as_dvec2());
                any_cell(&uv, 1.0, 1e-4, |x, y| {
                    covered[y as usize * block.width as usize + x as usize] = true;
                    false
                });
            }
            charts.sort_unstable();
            charts.dedup();
            stats.chart_count += charts.len() as u64;
            stats.triangle_count += block.triangles.len() as u64;
            stats.block_texels += covered.len() as u64;
            stats.covered_texels += covered.iter().filter(|&&c| c).count() as u64;
        }
        stats
    }
}
