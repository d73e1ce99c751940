//! Settings of the unwrap.

use serde::{Deserialize, Serialize};

use super::UnwrapError;

/// Settings of a generated or adopted unwrap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnwrapSettings {
    /// Side of a texel in metres, above 0. Lower → finer light, more receivers (their number grows with the square).
    pub texel_m: f32,
    /// Free texels between charts, 0..=64; half of it at a block's edge. Higher → coarser levels of detail and
    /// filters stay inside their chart, at the price of empty texels.
    pub gutter_texels: u32,
    /// Longest side of a block in texels, 64..=16384. Higher → fewer blocks and cuts.
    pub max_block_texels: u32,
    /// Texel coordinates in a block equal those on the world lattice modulo this, 1..=64. A power of two ≥ the
    /// coarsest level's texel makes levels line up across meshes. Higher → more empty texels.
    pub lod_align_texels: u32,
    /// Half-angle in radians of the cone that a chart's normals may span, 0.05..=1.2. Higher → fewer, more
    /// stretched charts. Below 45° keeps the sides of a smooth-shaded box apart.
    pub chart_cone_rad: f32,
    /// Angle in radians from a chart's axis up to which scraps are merged into it, `chart_cone_rad`..=1.3.
    /// Higher → fewer tiny charts, more stretch in them.
    pub scrap_cone_rad: f32,
    /// Angle in radians between shading normals from which an edge is hard and ends a chart, 0.02..=3.2.
    pub crease_rad: f32,
}

impl UnwrapSettings {
    /// The usual settings for texels of `texel_m` metres.
    pub fn with_texel_m(texel_m: f32) -> Self {
        Self {
            texel_m,
            gutter_texels: 2,
            max_block_texels: 2048,
            lod_align_texels: 4,
            chart_cone_rad: 0.75,
            scrap_cone_rad: 1.13,
            crease_rad: 0.7,
        }
    }

    /// Checks every field's range.
    pub(super) fn check(&self) -> Result<(), UnwrapError> {
        let bad = |field, reason| Err(UnwrapError::BadSetting { field, reason });
        if !(self.texel_m.is_finite() && self.texel_m >= 1e-12) {
            return bad("texel_m", "must be a finite length of at least 1e-12 m");
        }
        if self.gutter_texels > 64 {
            return bad("gutter_texels", "must be at most 64");
        }
        if !(1..=64).contains(&self.lod_align_texels) {
            return bad("lod_align_texels", "must be in 1..=64");
        }
        if !(64..=16384).contains(&self.max_block_texels) {
            return bad("max_block_texels", "must be in 64..=16384");
        }
        if self.tile_texels() < 16 {
            return bad("max_block_texels", "leaves less than 16 texels beside gutter and alignment");
        }
        if !(0.05..=1.2).contains(&self.chart_cone_rad) {
            return bad("chart_cone_rad", "must be in 0.05..=1.2");
        }
        if !(self.chart_cone_rad..=1.3).contains(&self.scrap_cone_rad) {
            return bad("scrap_cone_rad", "must be in chart_cone_rad..=1.3");
        }
        if !(0.02..=3.2).contains(&self.crease_rad) {
            return bad("crease_rad", "must be in 0.02..=3.2");
        }
        Ok(())
    }

    /// Free texels at a block's edge.
    pub(super) fn border_texels(&self) -> u32 {
        self.gutter_texels.div_ceil(2)
    }

    /// Largest chart side that fits a block at any lattice phase, a multiple of the alignment; 0 when none does.
    pub(super) fn tile_texels(&self) -> u32 {
        let lost = 2 * self.border_texels() + 2 * self.lod_align_texels;
        let side = self.max_block_texels.saturating_sub(lost);
        side - side % self.lod_align_texels
    }
}
