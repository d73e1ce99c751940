//! Even placement: places of free space in the order of their identities, those beside surfaces first, each left out where one before it
//! is near and sees it.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use lightkiln_proto::kinds::field::ProbeKey;
use rayon::prelude::*;

use super::Ground;
use crate::geometry::Geometry;
use crate::kinds::field::{Survey, points};
use crate::rays::sampling::seed_of;
use crate::task::Cancelled;

/// Nearest that a probe that it sees may be, over the distance between probes: so that there is about one probe in each cube of its edge.
pub const NEAREST: f32 = 0.9;
/// Nearest that a surface may be, likewise.
const CLEARANCE: f32 = 0.1;
/// How near a surface is to places beside one, in steps between places.
const BESIDE: f32 = 1.4;

/// A place that a probe may stand at, and the distance that is to be between probes there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stand {
    /// Identity.
    pub key: ProbeKey,
    /// In metres.
    pub spacing_m: f32,
}

/// Places of the volume, those beside surfaces first, each group in the order of hashes: between probes beside surfaces light is told,
/// beyond the outermost it is guessed.
pub fn places(ground: &Ground<'_>) -> Result<Vec<Stand>, Cancelled> {
    let (low, size) = ground.places;
    let [x, y] = [size.x as u64, size.y as u64];
    let point =
        |index: u64| low + IVec3::new((index % x) as i32, (index / x % y) as i32, (index / (x * y)) as i32);
    let stands = (0..points(size)).into_par_iter().filter_map(|index| {
        let key = ProbeKey::of(point(index) * ground.stride)?;
        Some(Stand { key, spacing_m: ground.spacing_m })
    });
    ordered(ground, stands)
}

/// Places of the volume among some, in the order in which they become probes.
pub fn ordered(
    ground: &Ground<'_>,
    stands: impl ParallelIterator<Item = Stand>,
) -> Result<Vec<Stand>, Cancelled> {
    let placed = |stand: Stand| {
        ground.progress.check()?;
        let at_m = ground.position_m(stand.key);
        let reach_m = BESIDE * stand.spacing_m / super::PLACES as f32;
        // Hashes of even places are the same whatever the lattice.
        let point = stand.key.point();
        let is_even = point % ground.stride == IVec3::ZERO;
        let identity = ProbeKey::of(point / ground.stride).filter(|_| is_even).unwrap_or(stand.key);
        let order = || {
            let is_inner = !is_beside(ground.geometry, at_m, reach_m);
            ((is_inner, seed_of(&[identity.0, 13]), stand.key), stand)
        };
        Ok(ground.volume.holds(at_m).then(order))
    };
    let all = stands.map(placed).filter_map(Result::transpose);
    let mut order: Vec<((bool, u64, ProbeKey), Stand)> = all.collect::<Result<_, Cancelled>>()?;
    order.par_sort_unstable_by_key(|(order, _)| *order);
    Ok(order.into_iter().map(|(_, stand)| stand).collect())
}

/// Adds probes at places where they may stand, in their order, that no probe of this call is near and sees; says how many.
pub fn thin(
    ground: &Ground<'_>,
    survey: &mut Survey,
    places: &[Stand],
    mut may_stand: impl FnMut(&Stand, Vec3) -> bool,
) -> Result<usize, Cancelled> {
    let Ground { geometry, progress, .. } = ground;
    let before = survey.probes.len();
    // Probes of this call, by cubes of the distance between them.
    let mut kept: HashMap<IVec3, Vec<Vec3>> = HashMap::new();
    for stand in places {
        progress.check()?;
        progress.advance(1);
        let at_m = ground.position_m(stand.key);
        let cell = (at_m / ground.spacing_m).floor().as_ivec3();
        let nearest_m = NEAREST * stand.spacing_m;
        let reach = (nearest_m / ground.spacing_m).ceil() as i32;
        let along = move || -reach..=reach;
        let around =
            along().flat_map(move |z| along().flat_map(move |y| along().map(move |x| IVec3::new(x, y, z))));
        let near = around.filter_map(|by| kept.get(&(cell + by))).flatten();
        let is_near = |other: &&Vec3| other.distance_squared(at_m) < nearest_m.powi(2);
        if near.filter(is_near).any(|&other_m| !geometry.tracer.is_occluded(other_m, at_m)) {
            continue;
        }
        if may_stand(stand, at_m) {
            kept.entry(cell).or_default().push(at_m);
            survey.probes.push((stand.key.0, [0; 3]));
        }
    }
    survey.probes.sort_unstable();
    Ok(survey.probes.len() - before)
}

/// Nearest that a surface may be to a place, in metres.
pub fn clearance_m(ground: &Ground<'_>, stand: &Stand) -> f32 {
    CLEARANCE * stand.spacing_m.min(ground.spacing_m)
}

/// A surface is nearer than so much along an axis or a diagonal.
fn is_beside(geometry: &Geometry, at_m: Vec3, reach_m: f32) -> bool {
    (0..27).filter(|way| *way != 13).any(|way: i32| {
        let way = IVec3::new(way % 3, way / 3 % 3, way / 9) - 1;
        geometry.tracer.is_occluded(at_m, at_m + reach_m * way.as_vec3().normalize())
    })
}
