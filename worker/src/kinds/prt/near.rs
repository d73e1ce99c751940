//! Near hits: in narrow places, light is read at the very points that a receiver's rays meet, and not at the middles of the
//! texels that they lie on. Between the slats of a shutter light falls on strips of millimetres, and a texel there is lit
//! or dark as a whole.
//!
//! `N(r) = π/N Σ_n ρ/π · (E_dir(y_n) + E_ind(t_n))` over the rays n that meet something, y_n on the texel t_n, closer than
//! the reach; of that sum a few hits are kept that are spread evenly over all.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::content::{BlockKey, NearHits, NearSurface, Texel};

use super::{Row, TracedSettings};
use crate::lightmap::{Found, Lightmap, Numbering, Receiver, Surface, World};
use crate::rays::Hit;

/// Share of its rays that must end within the reach for a place to be narrow: more than those beside a wall.
const NARROW_SHARE: f32 = 0.25;
/// Cells of a texel's side that tell the places of hits apart when they are put in order.
const ORDER_CELLS: f32 = 64.0;

/// A hit close to a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearHit {
    /// Receiver of the texel that it lies on.
    receiver: u32,
    /// Normal of its own, where a wall stands between the hit and the middles of all texels around: none has its light.
    own_normal: Option<Vec3>,
    /// Place in metres.
    position_m: Vec3,
}

impl NearHit {
    /// A hit as it is kept, `found` being the texels that stand for it; `None` where no texel has its albedo.
    pub fn of(world: &World, hit: &Hit, found: &Found, position_m: Vec3) -> Option<Self> {
        let (receiver, own_normal) = match (found.linked, found.own) {
            (Surface::Receiver(linked), _) => (linked, None),
            (_, Surface::Receiver(own)) => (own, Some(world.geometry.side_normal(hit))),
            _ => return None,
        };
        Some(Self { receiver, own_normal, position_m })
    }

    /// Place in metres.
    pub fn position_m(&self) -> Vec3 {
        self.position_m
    }

    /// Receiver of the texel that has its light, if one does.
    pub fn texel(&self) -> Option<u32> {
        self.own_normal.is_none().then_some(self.receiver)
    }
}

/// Distance in metres up to which a hit is near; 0 where none is.
pub fn reach_m(settings: &TracedSettings, texel_m: f32) -> f32 {
    if settings.patches.near_hits == 0 { 0.0 } else { settings.patches.near_texels * texel_m }
}

/// Side in metres of the longest texel of some receivers.
pub fn longest_texel_m(lightmap: &Lightmap, receivers: &[u32]) -> f32 {
    receivers.iter().map(|&receiver| lightmap.texel_m_of(receiver)).fold(0.0, f32::max)
}

/// Whether so many near hits of a receiver are those of a narrow place.
pub fn is_narrow(hits: usize, settings: &TracedSettings) -> bool {
    hits as f32 >= NARROW_SHARE * settings.transport.transport_rays as f32
}

/// Gives a row its near hits: at most `near_hits` that stand for all.
pub fn keep(
    row: &mut Row,
    mut hits: Vec<NearHit>,
    settings: &TracedSettings,
    lightmap: &Lightmap,
    texel_m: f32,
) {
    let kept = hits.len().min(settings.patches.near_hits as usize);
    if kept == 0 {
        return;
    }
    hits.sort_by_cached_key(|hit| {
        let (block, [x, y]) = lightmap.name_of(hit.receiver);
        (hit.own_normal.is_some(), block, [y, x], place_order(hit.position_m, texel_m))
    });
    let share = hits.len() as f32 / (settings.transport.transport_rays as usize * kept) as f32;
    row.near_weight = PI * share.min(1.0);
    row.near = (0..kept).map(|k| hits[(2 * k + 1) * hits.len() / (2 * kept)]).collect();
}

/// Morton code of the place's cell: near places have near codes.
fn place_order(position_m: Vec3, texel_m: f32) -> u64 {
    let spread = |value: i64| (0..21).fold(0, |bits, bit| bits | (value as u64 >> bit & 1) << (3 * bit));
    let [x, y, z] = (position_m / texel_m * ORDER_CELLS).floor().as_i64vec3().to_array().map(spread);
    x | y << 1 | z << 2
}

/// Receivers that the hits of [`of_rows`] with surfaces of their own have the albedo of, in their order.
pub fn own_of_rows(lightmap: &Lightmap, rows: &[&Row]) -> Vec<(BlockKey, Texel)> {
    let own = rows.iter().flat_map(|row| &row.near).filter(|hit| hit.own_normal.is_some());
    own.map(|hit| lightmap.name_of(hit.receiver)).collect()
}

/// The near hits of some rows as a chunk has them, with the receiver of each row.
pub fn of_rows(world: &World, settings: &TracedSettings, receivers: &[u32], rows: &[&Row]) -> NearHits {
    let lightmap = &world.lightmap;
    if rows.iter().all(|row| row.near.is_empty()) {
        return NearHits::default();
    }
    let on_texels = rows.iter().flat_map(|row| &row.near).filter_map(NearHit::texel);
    let blocks = Numbering::of(on_texels.map(|texel| lightmap.block_key(texel)));
    // Places are told as shares of one reach: that of the longest texels here.
    let texel_m = longest_texel_m(lightmap, receivers);
    let mut near = NearHits { reach_m: reach_m(settings, texel_m), ..NearHits::default() };
    for (&receiver, row) in receivers.iter().zip(rows) {
        let from_m = lightmap.receivers[receiver as usize].position_m;
        near.count.push(row.near.len() as u8);
        near.weight.push(if row.near.is_empty() { 0.0 } else { row.near_weight });
        for hit in &row.near {
            let Receiver { texel, albedo, normal, .. } = lightmap.receivers[hit.receiver as usize];
            near.offset.push(offset(world, from_m, hit, hit.own_normal.unwrap_or(normal), near.reach_m));
            near.surface.push(match hit.own_normal {
                Some(normal) => NearSurface::Own { albedo, normal: normal.to_array() },
                None => {
                    NearSurface::Texel { block: blocks.place_u16(lightmap.block_key(hit.receiver)), texel }
                }
            });
        }
    }
    near.blocks = blocks.into_values();
    near
}

/// Longer than the way from a hit to its stored place, for what the receiver's own place is rounded by.
const CLEAR_WAY: f32 = 1.25;
/// Longest such way in stored steps, and a little more: a diagonal, and the step by which places are raised.
const CLEAR_STEPS: f32 = 4.0;

/// Distance in metres from a hit within which walls decide where its stored place is, `texel_m` being the longest texel of its cell.
pub fn clear_way_m(settings: &TracedSettings, texel_m: f32) -> f32 {
    CLEAR_STEPS * f32::from(NearHits::STEPS_STORED) / f32::from(NearHits::STEPS) * reach_m(settings, texel_m)
}

/// Offset of a hit from its receiver as it is stored: of the eight roundings the nearest that no wall parts from the hit, as
/// light is read there and a millimetre may be the whole of a wall. If walls part all, the nearest.
fn offset(world: &World, from_m: Vec3, hit: &NearHit, normal: Vec3, reach_m: f32) -> [i16; 3] {
    let lifted_m = world.geometry.lifted(hit.position_m, normal);
    let [from, to, up] = [from_m, hit.position_m, normal].map(|vector| vector.to_array());
    let way_m = |offset| Vec3::from(NearHits::position_of(offset, from, up, reach_m)) - lifted_m;
    let mut offsets = NearHits::offsets_around(from, to, reach_m);
    offsets.sort_by(|&a, &b| way_m(a).length_squared().total_cmp(&way_m(b).length_squared()));
    let is_clear = |&offset: &[i16; 3]| world.is_linked(lifted_m, lifted_m + CLEAR_WAY * way_m(offset));
    offsets.into_iter().find(is_clear).unwrap_or(offsets[0])
}
