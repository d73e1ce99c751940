//! Near hits: in narrow places, light is read at the very points that a receiver's rays meet, and not at the middles of the
//! texels that they lie on. Between the slats of a shutter light falls on strips of millimetres, and a texel there is lit
//! or dark as a whole.
//!
//! `N(r) = π/N Σ_n ρ/π · (E_dir(y_n) + E_ind(t_n))` over the rays n that meet something, y_n on the texel t_n, closer than
//! the reach; of that sum a few hits are kept that are spread evenly over all. Those shut in by surfaces all around are dark, and left out.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::content::{BlockKey, NearHits, NearSurface, Texel};

use super::{Row, TracedSettings};
use crate::emitters::EmitterSet;
use crate::geometry::Geometry;
use crate::lightmap::{Found, Lightmap, Numbering, Receiver, Surface, World};
use crate::rays::Hit;
use crate::rays::sampling::{R2, uniform_hemisphere};

/// Share of its rays that must end within the reach for a place to be narrow: more than those beside a wall.
const NARROW_SHARE: f32 = 0.25;
/// Cells of a texel's side that tell the places of hits apart when they are put in order.
const ORDER_CELLS: f32 = 64.0;
/// Rays that tell whether a kept hit is shut in, uniform over the hemisphere, as gaps are open along their walls. Open places let
/// go one of the first few.
const SHUT_RAYS: u32 = 64;
/// Rays of those that may go farther than the width of a thin thing, along it.
const SHUT_RAYS_FAR: u32 = 16;
/// Width of a thin thing in texels: less than the filter of a shadow map reaches, a few metres from a lamp.
const THIN_TEXELS: f32 = 0.25;

/// A hit close to a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearHit {
    /// Receiver of the texel that it lies on.
    pub receiver: u32,
    /// A wall stands between the hit and the middles of all texels around: none has its light.
    pub is_own: bool,
    /// Place in metres.
    pub position_m: Vec3,
    /// Unit normal of the side that was met.
    pub face_normal: Vec3,
}

impl NearHit {
    /// A hit as it is kept, `found` being the texels that stand for it; `None` where no texel has its albedo.
    pub fn of(world: &World, hit: &Hit, found: &Found, position_m: Vec3) -> Option<Self> {
        let (receiver, is_own) = match (found.linked, found.own) {
            (Surface::Receiver(linked), _) => (linked, false),
            (_, Surface::Receiver(own)) => (own, true),
            _ => return None,
        };
        Some(Self { receiver, is_own, position_m, face_normal: world.geometry.side_normal(hit) })
    }

    /// Receiver of the texel that has its light, if one does.
    pub fn texel(&self) -> Option<u32> {
        (!self.is_own).then_some(self.receiver)
    }

    /// Whether this is the inside of a thin thing, that no lamp outside reaches: no ray from here gets farther than the reach of
    /// near hits, few go farther than a map of shadows can tell, and none meets an emitter. Such a map cannot tell the inside from
    /// the outside, a millimetre away. In a gap that is open somewhere more rays go far, and lamps may shine into it.
    fn is_shut(&self, geometry: &Geometry, emitters: &EmitterSet, reach: Reach, seed: u64) -> bool {
        let Self { position_m, face_normal, .. } = *self;
        let origin_m = geometry.lifted(position_m, face_normal);
        let points = R2::new(seed);
        let mut far = 0;
        (0..SHUT_RAYS).all(|ray| {
            let (direction, _) = uniform_hemisphere(face_normal, points.point(ray));
            let hit = geometry.tracer.met(origin_m, direction, reach.near_m);
            far += u32::from(hit.is_some_and(|hit| hit.t > reach.thin_m));
            hit.is_some_and(|hit| !emitters.is_emissive(hit.triangle)) && far <= SHUT_RAYS_FAR
        })
    }
}

/// Distances about a near hit, in metres.
#[derive(Clone, Copy)]
struct Reach {
    /// Up to which hits are near.
    near_m: f32,
    /// Width of a thin thing.
    thin_m: f32,
}

/// Leaves out kept hits that no light from outside reaches; their share of the receiver's hemisphere is dark.
pub fn drop_shut(
    row: &mut Row,
    (world, emitters): (&World, &EmitterSet),
    settings: &TracedSettings,
    receiver: u32,
) {
    let lightmap = &world.lightmap;
    let texel_m = lightmap.texel_m_of(receiver);
    let reach = Reach { near_m: reach_m(settings, texel_m), thin_m: THIN_TEXELS * texel_m };
    let seed = lightmap.seed_of(&lightmap.receivers[receiver as usize], 10);
    row.near.retain(|hit| !hit.is_shut(&world.geometry, emitters, reach, seed));
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
        (hit.is_own, block, [y, x], place_order(hit.position_m, texel_m))
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
    let own = rows.iter().flat_map(|row| &row.near).filter(|hit| hit.is_own);
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
            let normal = if hit.is_own { hit.face_normal } else { normal };
            near.offset.push(offset(world, from_m, hit, normal, near.reach_m));
            near.surface.push(if hit.is_own {
                NearSurface::Own { albedo, normal: normal.to_array() }
            } else {
                NearSurface::Texel { block: blocks.place_u16(lightmap.block_key(hit.receiver)), texel }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::model::{Material, MeshInstance, Scene};

    /// Rectangles of the sides of a box without thickness, those along x first, then y, then z.
    fn sides(size_m: Vec3) -> [[Vec3; 4]; 6] {
        let at = |x: u8, y: u8, z: u8| Vec3::new(x.into(), y.into(), z.into()) * size_m;
        [
            [at(0, 0, 0), at(0, 1, 0), at(0, 1, 1), at(0, 0, 1)],
            [at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1)],
            [at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
            [at(0, 1, 0), at(1, 1, 0), at(1, 1, 1), at(0, 1, 1)],
            [at(0, 0, 0), at(1, 0, 0), at(1, 1, 0), at(0, 1, 0)],
            [at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
        ]
    }

    /// Whether the middle of the lower side's inside is shut in, in a world with those sides; `emission` is theirs.
    fn is_shut(sides: &[[Vec3; 4]], middle_m: Vec3, emission: [f32; 3]) -> bool {
        let mut instance = MeshInstance::default();
        for corners in sides {
            let base = instance.positions_m.len() as u32;
            instance.positions_m.extend(corners);
            instance.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
        instance.normals = vec![Vec3::Y; instance.positions_m.len()];
        let material =
            Material { double_sided: true, emissive: emission, ..Material::opaque("side", [0.5; 3]) };
        let scene = Scene { instances: vec![instance], materials: vec![material], ..Scene::default() };
        let geometry = Geometry::new(scene).unwrap();
        let hit = NearHit { receiver: 0, is_own: false, position_m: middle_m, face_normal: Vec3::Y };
        hit.is_shut(&geometry, &EmitterSet::new(&geometry), Reach { near_m: 0.2, thin_m: 0.025 }, 7)
    }

    #[test]
    fn insides_of_bars_are_shut_and_gaps_and_lamps_are_not() {
        let size_m = Vec3::new(0.3, 0.008, 0.008);
        let (bar, middle_m) = (sides(size_m), Vec3::new(0.15, 0.0, 0.004));
        assert!(is_shut(&bar, middle_m, [0.0; 3]));
        assert!(!is_shut(&bar, middle_m, [1.0; 3]), "its sides shine");
        assert!(!is_shut(&bar[..5], middle_m, [0.0; 3]), "one side is open");
        // Two sheets a bar's thickness apart, with a wall behind: open along their length.
        let gap = sides(Vec3::new(0.3, 0.008, 0.03));
        assert!(!is_shut(&gap[..5], Vec3::new(0.15, 0.0, 0.015), [0.0; 3]), "a gap that is open on one side");
        // A drawer is no thin thing: rays go far in it.
        let drawer = sides(Vec3::new(0.15, 0.1, 0.15));
        assert!(!is_shut(&drawer, Vec3::new(0.075, 0.0, 0.075), [0.0; 3]));
    }
}
