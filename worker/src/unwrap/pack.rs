//! Pieces placed in blocks.
//!
//! Pieces by falling height, on a skyline, or on shelves when there are very many. Pieces move by multiples of the
//! level-of-detail alignment only, so a texel keeps its lattice coordinates modulo that.

use glam::{IVec2, Vec2};

use super::cut::{Piece, PieceTriangle};
use super::shelves::Shelves;
use super::skyline::Skyline;
use super::{MAX_INSTANCE_TEXELS, Unwrap, UnwrapBlock, UnwrapError, UnwrapSettings, UnwrappedTriangle};
use crate::task::{Cancelled, Progress};

/// Block widths tried, as parts of the square root of the pieces' area.
const WIDTH_FACTORS: [f64; 6] = [0.75, 0.9, 1.05, 1.2, 1.4, 1.7];

/// More pieces than this go on shelves at one width: a skyline's time grows with its length for every piece.
const MANY_PIECES: usize = 4096;

/// After so many pieces in a row that do not fit, the block counts as full.
const MAX_MISSES: usize = 512;

/// Places all pieces; their number is the chart number.
pub(super) fn pack_blocks(
    pieces: Vec<Piece>,
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Unwrap, UnwrapError> {
    let gutter = i64::from(settings.gutter_texels);
    let padded = |p: &Piece| (i64::from(p.size().x) + gutter) * (i64::from(p.size().y) + gutter);
    let texels = pieces.iter().map(padded).sum::<i64>() as u64;
    if texels > MAX_INSTANCE_TEXELS {
        return Err(UnwrapError::TooLarge { texels, limit: MAX_INSTANCE_TEXELS, texel_m: settings.texel_m });
    }
    let mut order: Vec<usize> = (0..pieces.len()).collect();
    if order.len() > MANY_PIECES {
        // Rows of one phase waste no height.
        let phase = |i: usize| pieces[i].low.rem_euclid(IVec2::splat(settings.lod_align_texels as i32));
        order.sort_by_key(|&i| (-pieces[i].size().y, phase(i).y, phase(i).x, -pieces[i].size().x, i));
    } else {
        order.sort_by_key(|&i| (-pieces[i].size().y, -pieces[i].size().x, i));
    }
    let mut placement = vec![None; pieces.len()];
    let mut sizes = Vec::new();
    while !order.is_empty() {
        let layout = best_layout(&pieces, &order, texels, settings, progress)?;
        for &(piece, at) in &layout.placed {
            placement[piece] = Some((sizes.len(), at));
        }
        sizes.push(layout.size);
        order = layout.left_over;
    }
    Ok(emit(pieces, &placement, &sizes, settings.texel_m))
}

/// Pieces placed in one block.
struct Layout {
    size: IVec2,
    placed: Vec<(usize, IVec2)>,
    left_over: Vec<usize>,
}

/// The smallest block over a few widths; the fullest one when no block holds all pieces.
fn best_layout(
    pieces: &[Piece],
    order: &[usize],
    texels: u64,
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Layout, Cancelled> {
    let factors = if order.len() > MANY_PIECES { &WIDTH_FACTORS[2..3] } else { &WIDTH_FACTORS };
    let widths = factors.iter().map(|f| (f * (texels as f64).sqrt()) as i32);
    let lay_out = |width: i32| lay_out(pieces, order, width, settings, progress);
    let candidates = widths.map(lay_out).collect::<Result<Vec<Layout>, Cancelled>>()?;
    let complete = candidates.into_iter().filter(|layout| layout.left_over.is_empty());
    match complete.min_by_key(|layout| layout.size.x * layout.size.y) {
        Some(smallest) => Ok(smallest),
        None => lay_out(settings.max_block_texels as i32),
    }
}

fn lay_out(
    pieces: &[Piece],
    order: &[usize],
    width: i32,
    settings: &UnwrapSettings,
    progress: &Progress,
) -> Result<Layout, Cancelled> {
    let align = settings.lod_align_texels as i32;
    let (gutter, border) = (settings.gutter_texels as i32, settings.border_texels() as i32);
    let max_side = settings.max_block_texels as i32 / align * align;
    let widest = order.iter().map(|&i| pieces[i].size().x).max().unwrap_or(1);
    let least_width = widest + 2 * border + align;
    let width = round_up(width.max(least_width), align).min(max_side);
    let mut packer = Packer::new(order.len() > MANY_PIECES, border, width - border + gutter, align);
    let mut layout =
        Layout { size: IVec2::ZERO, placed: Vec::with_capacity(order.len()), left_over: Vec::new() };
    let mut misses = 0;
    for (position, &index) in order.iter().enumerate() {
        progress.check()?;
        if misses > MAX_MISSES {
            layout.left_over.extend(&order[position..]);
            break;
        }
        let piece = &pieces[index];
        let padded = piece.size() + gutter;
        match packer.place(padded, piece.low, max_side - border + gutter) {
            Some(at) => {
                misses = 0;
                layout.placed.push((index, at));
                layout.size = layout.size.max(at + piece.size() + border);
            }
            None => {
                misses += 1;
                layout.left_over.push(index);
            }
        }
    }
    layout.size = IVec2::new(round_up(layout.size.x, align), round_up(layout.size.y, align));
    Ok(layout)
}

/// Either way of placing rectangles.
enum Packer {
    Skyline(Skyline),
    Shelves(Shelves),
}

impl Packer {
    fn new(is_many: bool, border: i32, right: i32, align: i32) -> Self {
        if is_many {
            Self::Shelves(Shelves::new(border, right, align))
        } else {
            Self::Skyline(Skyline::new(border, right, align))
        }
    }

    fn place(&mut self, size: IVec2, phase: IVec2, max_top: i32) -> Option<IVec2> {
        match self {
            Self::Skyline(skyline) => {
                let at = skyline.lowest_place(size, phase, max_top)?;
                skyline.raise(at, size);
                Some(at)
            }
            Self::Shelves(shelves) => shelves.place(size, phase, max_top),
        }
    }
}

fn round_up(value: i32, multiple: i32) -> i32 {
    value + (multiple - value.rem_euclid(multiple)) % multiple
}

fn emit(pieces: Vec<Piece>, placement: &[Option<(usize, IVec2)>], sizes: &[IVec2], texel_m: f32) -> Unwrap {
    let block = |size: &IVec2| {
        let [width, height] = [size.x, size.y].map(|side| side as u32);
        UnwrapBlock { texel_m, width, height, triangles: Vec::new() }
    };
    let mut blocks: Vec<UnwrapBlock> = sizes.iter().map(block).collect();
    for (chart, (piece, place)) in pieces.into_iter().zip(placement).enumerate() {
        if let Some((index, at)) = *place {
            let moved = |t| placed_triangle(t, chart as u32, at - piece.low);
            blocks[index].triangles.extend(piece.triangles.into_iter().map(moved));
        }
    }
    for block in &mut blocks {
        // Stable: parts of one triangle keep their order.
        block.triangles.sort_by_key(|t| t.source_triangle);
    }
    Unwrap { blocks }
}

fn placed_triangle(triangle: PieceTriangle, chart: u32, offset: IVec2) -> UnwrappedTriangle {
    let uv_texels: [Vec2; 3] = triangle.uv.map(|p| (p + offset.as_dvec2()).as_vec2());
    let PieceTriangle { source_triangle, piece_corners, .. } = triangle;
    UnwrappedTriangle { source_triangle, chart, uv_texels, piece_corners }
}
