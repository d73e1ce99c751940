//! The points of receivers' texels that E_dir is the mean over: those of `Receivers::coverage`, where the meshes have them.

use std::collections::HashSet;

use glam::{UVec2, Vec2, Vec2Swizzles, Vec3};
use lightkiln_proto::content::{COVERAGE_POINTS, COVERAGE_SIDE};
use lightkiln_proto::relight::{ReceiverTable, SlotTable};

use crate::scene::{DrawTable, LightmapLayout, LoadedDraw, Vertex};

/// Points that are looked at first: a square turned to the lattice, whose rows and columns all differ.
pub const FEW_POINTS: usize = 4;
/// Share of a light from which on a point counts as lit.
pub const ALL_LIT: f32 = 0.999;

/// Bits of the coverage in the order of the points: the first four, then the others by rows.
const ORDER: [u8; COVERAGE_POINTS as usize] = [1, 7, 8, 14, 0, 2, 3, 4, 5, 6, 9, 10, 11, 12, 13, 15];

/// Points in the middle of a texel that stand for it where its receiver is not there.
const MIDDLE: [u8; 2] = [5, 10];
/// Bit of the order of points of other texels.
const OF_OTHERS: u32 = 1 << 31;

/// Numbers that put the points of many texels in an order whose first few lie far apart.
fn spread(block: u32, [x, y]: [u16; 2], bit: u8) -> u32 {
    let place = (block ^ (u32::from(y) << 16 | u32::from(x))).wrapping_mul(0x9E37_79B1) ^ u32::from(bit);
    (place ^ place >> 15).wrapping_mul(0x85EB_CA77) >> 1
}

/// Points of all texels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelPoints {
    /// First point of each slot, and the end.
    pub starts: Vec<u32>,
    /// Offset from the receiver x, y and z as snorm16 of `reach_m`, octahedral normal as two snorm8.
    pub points: Vec<[u32; 2]>,
    /// Longest offset along an axis, in metres.
    pub reach_m: f32,
}

/// Points of one texel.
#[derive(Clone, Copy, Debug)]
pub struct OfTexel<'a> {
    points: &'a [[u32; 2]],
    reach_m: f32,
    from_m: Vec3,
}

/// A point of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    position_m: Vec3,
    normal: Vec3,
}

impl TexelPoints {
    /// Finds the points of receivers on the meshes that read their texels.
    pub fn new(
        (draws, layout): (&DrawTable, &LightmapLayout),
        slots: &SlotTable,
        receivers: &ReceiverTable,
    ) -> Self {
        let sides = draws.draws.iter().flat_map(|draw| [(draw, draw.front, 1.0), (draw, draw.back, -1.0)]);
        let mut found: Vec<(u32, u32, Point)> = Vec::new();
        for (draw, block, side) in sides {
            let Some(placed) = layout.block(block) else { continue };
            for triangle in &draw.triangles {
                of_triangle(draw, triangle, (side, placed.size), |texel, bit, point| {
                    if let Some(slot) = slots.slot(block, texel)
                        && receivers.coverage[slot as usize] >> bit & 1 == 1
                    {
                        let order = ORDER.iter().position(|other| *other == bit).unwrap_or_default();
                        found.push((slot, order as u32, point));
                    } else if MIDDLE.contains(&bit)
                        && let Some(slot) = slots.standing_inside(block, texel)
                    {
                        found.push((slot, OF_OTHERS | spread(block, texel, bit), point));
                    }
                });
            }
        }
        found.sort_by_key(|(slot, order, _)| (*slot, *order));
        // A point on an edge lies on two triangles.
        found.dedup_by_key(|(slot, order, _)| (*slot, *order));
        // A receiver that stands for others is the mean over a point of its own and two of each of them.
        let for_others: HashSet<u32> =
            found.iter().filter(|(_, order, _)| order & OF_OTHERS != 0).map(|(slot, ..)| *slot).collect();
        let mut before = None;
        found.retain(|(slot, order, _)| {
            let is_first = before.replace(*slot) != Some(*slot);
            is_first || order & OF_OTHERS != 0 || !for_others.contains(slot)
        });
        Self::packed(&found, receivers)
    }

    /// Points of a slot's texel, whose receiver is at `from_m`.
    pub fn of(&self, slot: usize, from_m: Vec3) -> OfTexel<'_> {
        let range = self.starts[slot] as usize..self.starts[slot + 1] as usize;
        OfTexel { points: &self.points[range], reach_m: self.reach_m, from_m }
    }

    fn packed(found: &[(u32, u32, Point)], receivers: &ReceiverTable) -> Self {
        let offset = |(slot, _, point): &(u32, u32, Point)| {
            point.position_m - receivers.position_m[*slot as usize].truncate()
        };
        let reach = found.iter().map(|point| offset(point).abs().max_element());
        let reach_m = reach.fold(f32::MIN_POSITIVE, f32::max);
        let mut starts = vec![0; receivers.len() + 1];
        found.iter().for_each(|(slot, ..)| starts[*slot as usize + 1] += 1);
        for slot in 0..receivers.len() {
            starts[slot + 1] += starts[slot];
        }
        let points = found.iter().map(|point| {
            let [x, y, z] = (offset(point) / reach_m).to_array().map(|x| snorm(x, 32767.0) & 0xFFFF);
            let [u, v] = folded(point.2.normal).to_array().map(|x| snorm(x, 127.0) & 0xFF);
            [x | y << 16, z | u << 16 | v << 24]
        });
        Self { starts, points: points.collect(), reach_m }
    }
}

impl OfTexel<'_> {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// There are none: the receiver's own place is the only one.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Position in metres and unit normal of a point; twin of `texel_point` in the shader.
    pub fn point(&self, index: usize) -> (Vec3, Vec3) {
        let [first, second] = self.points[index];
        let of16 = |bits: u32| (f32::from(bits as u16 as i16) / 32767.0).max(-1.0);
        let of8 = |bits: u32| (f32::from(bits as u8 as i8) / 127.0).max(-1.0);
        let offset = Vec3::new(of16(first), of16(first >> 16), of16(second));
        (self.from_m + self.reach_m * offset, unfolded(Vec2::new(of8(second >> 16), of8(second >> 24))))
    }
}

/// Calls `met` with the texel, bit and place of each point in a block of `size` texels that the triangle holds, on its rim too.
fn of_triangle(
    draw: &LoadedDraw,
    triangle: &[u32; 3],
    (side, size): (f32, [u32; 2]),
    mut met: impl FnMut([u16; 2], u8, Point),
) {
    let corners = triangle.map(|vertex| &draw.vertices[vertex as usize]);
    let [a, b, c] = corners.map(|vertex| Vec2::from(vertex.lightmap_texel) * COVERAGE_SIDE as f32);
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let last = (UVec2::from(size) * COVERAGE_SIDE).as_vec2() - 1.0;
    let low = (a.min(b).min(c) - 0.5).ceil().clamp(Vec2::ZERO, last).as_ivec2();
    let high = (a.max(b).max(c) - 0.5).floor().clamp(Vec2::NEG_ONE, last).as_ivec2();
    let [p, q, r] = corners.map(|vertex| Vec3::from(vertex.position_m));
    let face = (q - p).cross(r - p).normalize_or(Vec3::from(corners[0].normal));
    for y in low.y..=high.y {
        for x in low.x..=high.x {
            let at = Vec2::new(x as f32, y as f32) + 0.5;
            // Each edge by itself, so that two triangles that share one leave no point between them.
            let shares = [(b, c), (c, a), (a, b)].map(|(from, to)| (to - from).perp_dot(at - from) / area);
            if !shares.iter().all(|share| *share >= 0.0) {
                continue;
            }
            let total: f32 = shares.iter().sum();
            let mixed = |of: fn(&Vertex) -> [f32; 3]| -> Vec3 {
                let weighted =
                    corners.iter().zip(shares).map(|(vertex, share)| Vec3::from(of(vertex)) * share);
                weighted.sum::<Vec3>() / total
            };
            let shading = mixed(|vertex| vertex.normal).normalize_or_zero();
            // A shading normal that points through the surface is a fault of the file.
            let normal = if shading.dot(face) > 0.05 { shading } else { face } * side;
            let step = COVERAGE_SIDE as i32;
            let texel = [(x / step) as u16, (y / step) as u16];
            let bit = (y % step * step + x % step) as u8;
            met(texel, bit, Point { position_m: mixed(|vertex| vertex.position_m), normal });
        }
    }
}

fn snorm(x: f32, most: f32) -> u32 {
    (x.clamp(-1.0, 1.0) * most).round() as i32 as u32
}

/// Unit vector → octahedral coordinates.
fn folded(n: Vec3) -> Vec2 {
    let n = n / n.abs().element_sum().max(f32::MIN_POSITIVE);
    if n.z >= 0.0 { n.truncate() } else { (1.0 - n.truncate().yx().abs()) * sign(n.truncate()) }
}

fn unfolded(folded: Vec2) -> Vec3 {
    let mut n = folded.extend(1.0 - folded.abs().element_sum());
    if n.z < 0.0 {
        n = ((1.0 - folded.yx().abs()) * sign(folded)).extend(n.z);
    }
    n.normalize()
}

fn sign(v: Vec2) -> Vec2 {
    Vec2::select(v.cmpge(Vec2::ZERO), Vec2::ONE, Vec2::NEG_ONE)
}
