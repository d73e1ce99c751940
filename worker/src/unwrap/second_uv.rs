//! Adopting the unwrap that a mesh brings as its second UV set.

use glam::{DVec2, Vec2, Vec3};
use thiserror::Error;

use super::overlap::{any_cell, penetration};
use super::soup::Soup;
use super::{MAX_INSTANCE_TEXELS, Unwrap, UnwrapBlock, UnwrapError, UnwrapSettings, UnwrappedTriangle};

/// How far outside 0..=1 a coordinate may lie: rounding of what exporters write.
const RANGE_SLACK: f32 = 1e-5;

/// Texels of one triangle may be this many times finer or coarser than the median.
const MAX_UNEVENNESS: f64 = 4.0;

/// Share of the surface that may be more uneven than that.
const MAX_UNEVEN_SHARE: f64 = 0.05;

/// Penetration in texels that counts as touching, for triangles large enough.
const PENETRATION_TEXELS: f64 = 0.05;

/// Penetration that counts as touching, as a part of the smaller triangle's height.
const PENETRATION_SHARE: f64 = 0.25;

/// Penetration in texels below which `f32` rounding decides.
const ROUNDING_TEXELS: f64 = 5e-4;

/// More triangles in one cell of the overlap test mean that the set is folded onto itself.
const MAX_CELL_TRIANGLES: usize = 512;

/// Why a second UV set is no lightmap unwrap.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Uv1Rejected {
    /// Not one coordinate pair per vertex.
    #[error("{uv_count} second UV coordinates for {vertex_count} vertices")]
    CountMismatch {
        /// Coordinates given.
        uv_count: usize,
        /// Vertices given.
        vertex_count: usize,
    },
    /// A coordinate outside 0..=1 or not finite: a tiling texture's set.
    #[error("second UV set leaves 0..=1 at triangle {triangle}")]
    OutOfRange {
        /// First such triangle.
        triangle: u32,
    },
    /// A triangle with an area in the world and none in the UV set.
    #[error("triangle {triangle} has no area in the second UV set")]
    ZeroArea {
        /// First such triangle.
        triangle: u32,
    },
    /// Two triangles share texels.
    #[error("triangles {first} and {second} overlap in the second UV set")]
    Overlap {
        /// Lower index of the first pair found.
        first: u32,
        /// Higher index of it.
        second: u32,
    },
    /// Charts lie closer than a texel at the resolution that the texel size asks for.
    #[error("charts of triangles {first} and {second} lie less than one texel apart at {side_texels} texels")]
    GutterTooSmall {
        /// A triangle of one chart.
        first: u32,
        /// A triangle of the other.
        second: u32,
        /// Side of the block.
        side_texels: u32,
    },
    /// Texel sizes differ too much over the surface.
    #[error(
        "{percent} % of the surface has texels over {MAX_UNEVENNESS} times finer or coarser than the median"
    )]
    TexelSizeTooUneven {
        /// Share of the surface, in percent.
        percent: u32,
    },
    /// The block would exceed the longest side allowed.
    #[error("second UV set needs {side_texels} texels a side, over the limit of {limit}")]
    TooLarge {
        /// Side that the texel size asks for.
        side_texels: u64,
        /// [`UnwrapSettings::max_block_texels`].
        limit: u32,
    },
    /// No triangle has an area.
    #[error("no triangle has an area")]
    Empty,
    /// The settings or the mesh are refused for any unwrap.
    #[error("instance cannot be unwrapped")]
    Refused(#[source] UnwrapError),
}

/// Adopts a second UV set as one square block whose median texel has the set size, if it is a valid unwrap.
///
/// Coordinates are taken as they are: these texels lie on the UV set's own lattice, not on the world's. Charts are
/// the sets of triangles that join in both position and UV.
///
/// # Errors
/// The first reason found against the set, see [`Uv1Rejected`]; fall back to a generated unwrap.
pub fn unwrap_from_second_uv(
    positions_m: &[Vec3],
    uv1: &[Vec2],
    triangles: &[[u32; 3]],
    settings: &UnwrapSettings,
) -> Result<Unwrap, Uv1Rejected> {
    settings.check().map_err(Uv1Rejected::Refused)?;
    if uv1.len() != positions_m.len() {
        return Err(Uv1Rejected::CountMismatch { uv_count: uv1.len(), vertex_count: positions_m.len() });
    }
    let soup = Soup::new(positions_m, triangles);
    let live: Vec<u32> = (0..soup.len() as u32).filter(|&t| soup.is_live(t)).collect();
    let uv_of = |t: u32| triangles[t as usize].map(|v| uv1[v as usize]);
    check_range(&live, uv_of)?;
    let side_texels = side_texels(&soup, &live, uv_of, settings)?;
    let scaled =
        |t: u32| uv_of(t).map(|uv| uv.as_dvec2().clamp(DVec2::ZERO, DVec2::ONE) * f64::from(side_texels));
    let corners: Vec<[DVec2; 3]> = live.iter().map(|&t| scaled(t)).collect();
    check_overlap(&live, &corners, side_texels)?;
    let charts = charts(&soup, &live, uv_of);
    check_gutter(&live, &corners, &charts, side_texels)?;
    let unwrapped = live.iter().enumerate().map(|(i, &source_triangle)| UnwrappedTriangle {
        source_triangle,
        chart: charts[i],
        uv_texels: corners[i].map(|p| p.as_vec2()),
        piece_corners: None,
    });
    let texel_m = settings.texel_m;
    let block =
        UnwrapBlock { texel_m, width: side_texels, height: side_texels, triangles: unwrapped.collect() };
    Ok(Unwrap { blocks: vec![block] })
}

fn check_range(live: &[u32], uv_of: impl Fn(u32) -> [Vec2; 3]) -> Result<(), Uv1Rejected> {
    let range = -RANGE_SLACK..=1.0 + RANGE_SLACK;
    let is_inside = |uv: Vec2| range.contains(&uv.x) && range.contains(&uv.y);
    match live.iter().find(|&&t| !uv_of(t).into_iter().all(is_inside)) {
        Some(&triangle) => Err(Uv1Rejected::OutOfRange { triangle }),
        None => Ok(()),
    }
}

/// Side at which the texel of median size (over the surface's area) is `texel_m`; checks that sizes are even.
fn side_texels(
    soup: &Soup,
    live: &[u32],
    uv_of: impl Fn(u32) -> [Vec2; 3],
    settings: &UnwrapSettings,
) -> Result<u32, Uv1Rejected> {
    let mut sizes: Vec<(f64, f64)> = Vec::with_capacity(live.len());
    for &triangle in live {
        let [a, b, c] = uv_of(triangle).map(|p| p.as_dvec2());
        let uv_area = 0.5 * (b - a).perp_dot(c - a).abs();
        if uv_area == 0.0 {
            return Err(Uv1Rejected::ZeroArea { triangle });
        }
        let area_m2 = soup.area_m2[triangle as usize];
        sizes.push(((area_m2 / uv_area).sqrt(), area_m2));
    }
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all_m2: f64 = sizes.iter().map(|s| s.1).sum();
    let mut below_m2 = 0.0;
    let median = sizes.iter().find(|(_, area_m2)| {
        below_m2 += area_m2;
        below_m2 >= 0.5 * all_m2
    });
    let Some(&(median_m, _)) = median else { return Err(Uv1Rejected::Empty) };
    let is_even = |size: f64| size < median_m * MAX_UNEVENNESS && size > median_m / MAX_UNEVENNESS;
    let uneven_m2: f64 = sizes.iter().filter(|s| !is_even(s.0)).map(|s| s.1).sum();
    if uneven_m2 > MAX_UNEVEN_SHARE * all_m2 {
        return Err(Uv1Rejected::TexelSizeTooUneven { percent: (100.0 * uneven_m2 / all_m2) as u32 });
    }
    let side = (median_m / f64::from(settings.texel_m)).round().max(1.0) as u64;
    let limit = settings.max_block_texels;
    if side > u64::from(limit) || side.saturating_mul(side) > MAX_INSTANCE_TEXELS {
        return Err(Uv1Rejected::TooLarge { side_texels: side, limit });
    }
    Ok(side as u32)
}

/// Penetration at which two triangles overlap, relative to the thinner one.
fn allowed_penetration(a: &[DVec2; 3], b: &[DVec2; 3]) -> f64 {
    let least_height = |t: &[DVec2; 3]| {
        let longest = (0..3).map(|i| t[i].distance(t[(i + 1) % 3])).fold(0.0, f64::max);
        (t[1] - t[0]).perp_dot(t[2] - t[0]).abs() / longest
    };
    (PENETRATION_SHARE * least_height(a).min(least_height(b))).clamp(ROUNDING_TEXELS, PENETRATION_TEXELS)
}

/// Finds overlapping triangles through a grid with about as many cells as triangles.
fn check_overlap(live: &[u32], corners: &[[DVec2; 3]], side_texels: u32) -> Result<(), Uv1Rejected> {
    let cells_per_side = (live.len() as f64).sqrt().ceil().clamp(1.0, 2048.0) as usize;
    let cell = f64::from(side_texels) / cells_per_side as f64;
    let mut grid: Vec<Vec<u32>> = vec![Vec::new(); cells_per_side * cells_per_side];
    for (i, uv) in corners.iter().enumerate() {
        let mut other = None;
        any_cell(uv, cell, 1e-6, |x, y| {
            let (x, y) =
                ((x.max(0) as usize).min(cells_per_side - 1), (y.max(0) as usize).min(cells_per_side - 1));
            let list = &mut grid[y * cells_per_side + x];
            let overlaps = |&&j: &&u32| {
                let theirs = &corners[j as usize];
                penetration(uv, theirs) > allowed_penetration(uv, theirs)
            };
            other = list.iter().find(overlaps).copied();
            if list.len() >= MAX_CELL_TRIANGLES && other.is_none() {
                other = list.first().copied();
            }
            list.push(i as u32);
            other.is_some()
        });
        if let Some(other) = other {
            return Err(Uv1Rejected::Overlap { first: live[other as usize], second: live[i] });
        }
    }
    Ok(())
}

/// Chart of each live triangle: joined over edges with equal ends in position and UV, numbered as they come.
fn charts(soup: &Soup, live: &[u32], uv_of: impl Fn(u32) -> [Vec2; 3]) -> Vec<u32> {
    let mut edges = Vec::with_capacity(3 * live.len());
    for (i, &triangle) in live.iter().enumerate() {
        let (points, uv) = (soup.corners[triangle as usize], uv_of(triangle));
        let end = |k: usize| (points[k], (uv[k] + Vec2::ZERO).to_array().map(f32::to_bits));
        for edge in 0..3 {
            let (a, b) = (end(edge), end((edge + 1) % 3));
            edges.push((a.min(b), a.max(b), i as u32));
        }
    }
    edges.sort_unstable();
    let mut parents: Vec<u32> = (0..live.len() as u32).collect();
    for pair in edges.windows(2).filter(|w| (w[0].0, w[0].1) == (w[1].0, w[1].1)) {
        let (a, b) = (root(&mut parents, pair[0].2), root(&mut parents, pair[1].2));
        parents[a.max(b) as usize] = a.min(b);
    }
    let mut chart_of_root = vec![u32::MAX; live.len()];
    let mut chart_count = 0;
    (0..live.len() as u32)
        .map(|i| {
            let chart = &mut chart_of_root[root(&mut parents, i) as usize];
            if *chart == u32::MAX {
                *chart = chart_count;
                chart_count += 1;
            }
            *chart
        })
        .collect()
}

/// Root of a disjoint set, with path halving.
fn root(parents: &mut [u32], mut node: u32) -> u32 {
    while parents[node as usize] != node {
        parents[node as usize] = parents[parents[node as usize] as usize];
        node = parents[node as usize];
    }
    node
}

/// Checks that texels of different charts never touch.
fn check_gutter(
    live: &[u32],
    corners: &[[DVec2; 3]],
    charts: &[u32],
    side_texels: u32,
) -> Result<(), Uv1Rejected> {
    let side = side_texels as usize;
    let mut owner = vec![u32::MAX; side * side];
    let clash = |a: u32, b: u32| a != u32::MAX && b != u32::MAX && charts[a as usize] != charts[b as usize];
    let too_small = |a: u32, b: u32| Uv1Rejected::GutterTooSmall {
        first: live[a as usize],
        second: live[b as usize],
        side_texels,
    };
    for (i, uv) in corners.iter().enumerate() {
        let mut other = u32::MAX;
        any_cell(uv, 1.0, 1e-4, |x, y| {
            let texel =
                &mut owner[(y.max(0) as usize).min(side - 1) * side + (x.max(0) as usize).min(side - 1)];
            other = std::mem::replace(texel, i as u32);
            clash(other, i as u32)
        });
        if clash(other, i as u32) {
            return Err(too_small(other, i as u32));
        }
    }
    for y in 0..side {
        for x in 0..side {
            let here = owner[y * side + x];
            for (dx, dy) in [(1, 0), (0, 1), (1, 1), (-1, 1)] {
                let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                if nx < side && ny < side && clash(here, owner[ny * side + nx]) {
                    return Err(too_small(here, owner[ny * side + nx]));
                }
            }
        }
    }
    Ok(())
}
