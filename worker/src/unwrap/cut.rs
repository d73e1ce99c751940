//! Charts as pieces that fit a block.
//!
//! A chart longer than a block is cut along lattice lines at multiples of the tile size (world-aligned, so an edit
//! does not move them), and its triangles with it: each tile becomes a chart of its own with clipped triangles.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3, IVec2, Vec3};

use super::UnwrapSettings;
use super::grow::{Chart, footprint};
use super::overlap::any_cell;
use super::soup::Soup;
use crate::task::{Cancelled, Progress};

/// Clipped parts with less area than this, in texels, are dropped where the triangle has greater ones.
const LEAST_PART_TEXELS: f64 = 1e-7;

/// A chart, or a tile of one, on the lattice.
#[derive(Debug, Default)]
pub(super) struct Piece {
    /// Lowest texel.
    pub low: IVec2,
    /// One past the highest texel.
    pub high: IVec2,
    /// Its triangles.
    pub triangles: Vec<PieceTriangle>,
}

/// A triangle or a part of one, on the lattice.
#[derive(Clone, Debug)]
pub(super) struct PieceTriangle {
    /// Index in the mesh.
    pub source_triangle: u32,
    /// Corners in lattice texels.
    pub uv: [DVec2; 3],
    /// Corners of a part as weights of the whole's.
    pub piece_corners: Option<Box<[Vec3; 3]>>,
}

impl Piece {
    fn new(triangles: Vec<PieceTriangle>) -> Self {
        let corners = || triangles.iter().flat_map(|t| t.uv);
        let low = corners().fold(DVec2::INFINITY, DVec2::min).floor().as_ivec2();
        let high = corners().fold(DVec2::NEG_INFINITY, DVec2::max).ceil().as_ivec2();
        Self { low, high: high.max(low + 1), triangles }
    }

    /// Width and height in texels.
    pub fn size(&self) -> IVec2 {
        self.high - self.low
    }
}

/// Charts on the lattice, none larger than a tile.
pub(super) fn pieces_of_charts(
    soup: &Soup,
    charts: &[Chart],
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Vec<Piece>, Cancelled> {
    let tile_texels = settings.tile_texels() as i32;
    let mut pieces = Vec::with_capacity(charts.len());
    for chart in charts {
        progress.check()?;
        let triangles = chart.triangles.iter().map(|&t| PieceTriangle {
            source_triangle: t,
            uv: footprint(soup, &chart.frame, t).uv,
            piece_corners: None,
        });
        let whole = Piece::new(triangles.collect());
        if whole.size().max_element() <= tile_texels {
            pieces.push(whole);
        } else {
            pieces.extend(tiles(whole.triangles, tile_texels.into(), progress)?);
        }
    }
    Ok(pieces)
}

fn tiles(
    triangles: Vec<PieceTriangle>,
    tile_texels: f64,
    progress: &Progress,
) -> Result<Vec<Piece>, Cancelled> {
    let mut parts: BTreeMap<(i32, i32), Vec<PieceTriangle>> = BTreeMap::new();
    for triangle in triangles {
        progress.check()?;
        let mut reached = Vec::new();
        any_cell(&triangle.uv, tile_texels, -1e-6, |x, y| {
            reached.push(IVec2::new(x, y));
            false
        });
        let clipped = reached.iter().flat_map(|&tile| {
            clip_to_tile(&triangle, tile, tile_texels).into_iter().map(move |part| (tile, part))
        });
        let clipped: Vec<_> = clipped.collect();
        let has_area = |part: &PieceTriangle| area_texels(part) > LEAST_PART_TEXELS;
        let keep_all = !clipped.iter().any(|(_, part)| has_area(part));
        for (tile, part) in clipped {
            if keep_all || has_area(&part) {
                parts.entry((tile.y, tile.x)).or_default().push(part);
            }
        }
    }
    Ok(parts.into_values().map(Piece::new).collect())
}

fn area_texels(part: &PieceTriangle) -> f64 {
    0.5 * (part.uv[1] - part.uv[0]).perp_dot(part.uv[2] - part.uv[0]).abs()
}

/// A corner of a clipped polygon: lattice position and weights of the triangle's corners.
type Corner = (DVec2, DVec3);

/// The part of a triangle in a tile, as a fan; the triangle itself when it lies within.
fn clip_to_tile(triangle: &PieceTriangle, tile: IVec2, tile_texels: f64) -> Vec<PieceTriangle> {
    let low = tile.as_dvec2() * tile_texels;
    let high = low + tile_texels;
    if triangle.uv.iter().all(|p| p.cmpge(low).all() && p.cmple(high).all()) {
        return vec![triangle.clone()];
    }
    let mut polygon: Vec<Corner> = (0..3).map(|i| (triangle.uv[i], unit_weight(i))).collect();
    for axis in 0..2 {
        polygon = clip(&polygon, axis, low[axis], 1.0);
        polygon = clip(&polygon, axis, high[axis], -1.0);
    }
    (2..polygon.len())
        .map(|i| {
            let corners = [polygon[0], polygon[i - 1], polygon[i]];
            PieceTriangle {
                source_triangle: triangle.source_triangle,
                uv: corners.map(|c| c.0),
                piece_corners: Some(Box::new(corners.map(|c| c.1.as_vec3()))),
            }
        })
        .collect()
}

fn unit_weight(corner: usize) -> DVec3 {
    [DVec3::X, DVec3::Y, DVec3::Z][corner]
}

/// Keeps the part of a polygon on one side of a lattice line (Sutherland–Hodgman).
fn clip(polygon: &[Corner], axis: usize, line: f64, side: f64) -> Vec<Corner> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, &current) in polygon.iter().enumerate() {
        let previous = polygon[(i + polygon.len() - 1) % polygon.len()];
        let [before, after] = [previous, current].map(|c| (c.0[axis] - line) * side);
        if (before < 0.0) != (after < 0.0) {
            kept.push(crossing(previous, current, axis, line));
        }
        if after >= 0.0 {
            kept.push(current);
        }
    }
    kept
}

/// Where an edge meets a lattice line; the same from both of its sides.
fn crossing(a: Corner, b: Corner, axis: usize, line: f64) -> Corner {
    let (a, b) = if a.0[axis] <= b.0[axis] { (a, b) } else { (b, a) };
    let t = (line - a.0[axis]) / (b.0[axis] - a.0[axis]);
    let mut uv = a.0.lerp(b.0, t);
    uv[axis] = line;
    (uv, a.1.lerp(b.1, t))
}
