//! Step "share": coplanar and smoothly joined neighbours share light, whatever mesh, chart or material they belong to.
//!
//! Charts lie on one lattice, so texels of two charts may be the same square of one plane. Each would gather light at
//! points of its own, and pictures, which interpolate inside a block alone, would show a step at the border of the two.
//! - Where several charts have receivers in a square, one of them lends its light to the others, gathered from the points of all.
//! - Where a chart's surface is interpolated with a square in which it has no receiver and a neighbour has one, it gets a
//!   *guest* there: a receiver without surface, with the neighbour's light.
//! - Where the neighbour has another lattice, as a bent chart has, the guest gathers light of its own at the square's middle.
//! - Where the surface goes on bent, but shaded as one, the guest gathers light of its own at what lies under the square's middle.
//! - Of a strip between the border and a wall, however narrow, the guest has the light that the neighbour has at the border.
//!
//! So both sides of a border interpolate between the same values, or between values for the same light or that of places close by. No
//! light is shared between points that a wall parts.

use std::cell::LazyCell;
use std::cmp::Reverse;
use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::{AreaCode, TexelEdge};
use rayon::prelude::*;

use super::points::{has_better_claim, look_from};
use super::squares::{
    COPLANAR_COSINE_MIN, Faces, Found, Reading, Rim, Square, Squares, gather_alike, level_m,
};
use crate::geometry::{Geometry, Site};
use crate::lightmap::{Charts, Lightmap, Receiver, Surface, World};
use crate::rays::Hit;
use crate::task::{Cancelled, Progress};

/// Distance in texels in which the points of lenders are told apart by their distance from the middles of their squares:
/// pictures show light as if it were gathered there.
const CENTRAL_STEP: f32 = 0.125;
/// Texels by which the place in the lightmap changes at least where one steps across the border of a chart.
const BORDER_TEXELS: f32 = 0.5;
/// Cosine between faces up to which surface that is shaded as one is one, and between normals within a texel of it.
/// Below that of 60°: a pipe of six faces has these to rounding.
const BENT_COSINE_MIN: f32 = 0.45;
/// Height in texels about the plane of a face in which the surface goes on: at a place beside its rim, and at a square's middle.
const BENT_AT_RIM: f32 = 1.0 / 24.0;
const BENT_AT_MIDDLE: f32 = 0.5;
/// A guest takes its own light.
const ITSELF: u32 = u32::MAX;

/// Receivers with the light of others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SharedTexels {
    /// Those with surface of their own.
    pub borrowers: usize,
    /// Those without.
    pub guests: usize,
}

/// The lightmap with shared light, and guests among its receivers.
pub fn shared(
    geometry: &Arc<Geometry>,
    charts: &Charts,
    lightmap: Lightmap,
    progress: &Progress,
) -> Result<(Lightmap, SharedTexels), Cancelled> {
    let world = World::new(Arc::clone(geometry), charts, lightmap, progress);
    let faces = Faces::all(&world, charts);
    let of_faces: Vec<Found> = faces
        .into_par_iter()
        .map(|face| progress.casting(|| Found::of(&world, face, progress)))
        .collect::<Result<_, Cancelled>>()?;
    let squares = Squares::new(&world, of_faces.iter().flat_map(|found| &found.own));
    let light_of = lenders(&world, &squares, progress)?;
    let readings: Vec<&Reading> = of_faces.iter().flat_map(|found| &found.read).collect();
    let guest_of = |reading: &&Reading| {
        progress.check()?;
        Ok(progress.casting(|| guest_of(&world, &squares, &light_of, reading)))
    };
    let found: Vec<Option<GuestLight>> =
        readings.par_iter().map(guest_of).collect::<Result<_, Cancelled>>()?;
    let guest = |(reading, light): (Reading, Option<GuestLight>)| Some((reading, light?));
    let guests: Vec<(Reading, GuestLight)> =
        readings.into_iter().cloned().zip(found).filter_map(guest).collect();
    let borrowers = light_of.iter().zip(0..).filter(|(light_of, own)| *light_of != own).count();
    let shared = SharedTexels { borrowers, guests: guests.len() };
    Ok((with_light(world.into_lightmap(), &squares.of_receiver, &light_of, &guests), shared))
}

/// Order in which receivers of a square are asked to lend their light: points in the middle come first, then those of
/// texels of which most is on their side of every wall.
fn rank(squares: &Squares, lightmap: &Lightmap, receiver: u32) -> impl Ord + use<> {
    let own = &lightmap.receivers[receiver as usize];
    let away_m = squares.of_receiver[receiver as usize]
        .map_or(f32::INFINITY, |square| square.middle_m.distance(own.position_m));
    let away = (away_m / (CENTRAL_STEP * lightmap.texel_m_of(receiver))) as u32;
    (away, Reverse(own.coverage.count_ones()), lightmap.block_key(receiver), own.texel)
}

/// The receiver whose light each receiver takes, itself where nobody lends it any.
fn lenders(world: &World, squares: &Squares, progress: &Progress) -> Result<Vec<u32>, Cancelled> {
    let receivers = &world.lightmap.receivers;
    let mut light_of: Vec<u32> = (0..receivers.len() as u32).collect();
    let others = |own: u32| {
        if progress.is_cancelled() {
            return None;
        }
        let Receiver { block, normal, face_normal, .. } = receivers[own as usize];
        let square = squares.of_receiver[own as usize]?;
        let found = squares.receivers(world, block, &square, [normal, face_normal]);
        (found.len() > 1).then_some((own, found))
    };
    let mut sharing: Vec<(u32, Vec<u32>)> =
        (0..receivers.len() as u32).into_par_iter().filter_map(others).collect();
    sharing.sort_by_cached_key(|(own, _)| rank(squares, &world.lightmap, *own));
    // Squares are found by tolerance: only those that come earlier lend, and of them only those that borrow nothing.
    let mut is_asked = vec![false; receivers.len()];
    for (own, found) in &mut sharing {
        progress.check()?;
        found.sort_by_cached_key(|&other| rank(squares, &world.lightmap, other));
        let lends = |&&other: &&u32| {
            let may_lend = is_asked[other as usize] && light_of[other as usize] == other;
            may_lend && world.is_linked(world.raised_receiver(*own), world.raised_receiver(other))
        };
        if let Some(&lender) = progress.casting(|| found.iter().find(lends)) {
            light_of[*own as usize] = lender;
        }
        is_asked[*own as usize] = true;
    }
    progress.check()?;
    Ok(light_of)
}

/// Light of a guest.
#[derive(Clone, Copy, Debug)]
enum GuestLight {
    /// That of a receiver.
    Of(u32),
    /// That of a receiver of another square.
    Beside(u32),
    /// Its own, at a point on the surface of a receiver: the neighbour has another lattice.
    Own(Site, u32),
}

/// The light of a guest, if there is to be one: for the middle of the surface that is interpolated with it, else for a strip of
/// that surface along the border, which a wall parts from the middle.
fn guest_of(world: &World, squares: &Squares, light_of: &[u32], reading: &Reading) -> Option<GuestLight> {
    let Reading { block, square, site, rims, .. } = reading;
    let found = squares.receivers(world, *block, square, [site.normal, site.face_normal]);
    let own = if found.is_empty() { own_light(world, reading) } else { None };
    let mut lenders: Vec<u32> = found.into_iter().map(|receiver| light_of[receiver as usize]).collect();
    lenders.sort_by_cached_key(|&lender| rank(squares, &world.lightmap, lender));
    lenders.dedup();
    let at = |lender: u32| world.raised_receiver(lender);
    let sees_all = |rim: &Rim, lender: u32| suits(world, reading, rim, at(lender));
    let sees = |site: &Site, lender: u32| world.is_linked(world.raised_on(*block, site), at(lender));
    let of_middle = || lenders.iter().copied().find(|&lender| sees(site, lender));
    let of_strip =
        || rims.iter().find_map(|rim| lenders.iter().copied().find(|&lender| sees_all(rim, lender)));
    let beside = || {
        let at_border = |rim: &Rim| {
            let lender = light_of[met_across(world, *block, rim)? as usize];
            let of = &world.lightmap.receivers[lender as usize];
            let gathers_alike =
                gather_alike([of.normal, of.face_normal], [rim.site.normal, rim.site.face_normal]);
            (gathers_alike && sees_all(rim, lender)).then_some(GuestLight::Beside(lender))
        };
        rims.iter().find_map(at_border)
    };
    let of_lattice = || of_middle().or_else(of_strip).map(GuestLight::Of);
    own.or_else(of_lattice).or_else(beside).or_else(|| bent_light(world, reading))
}

/// Light at the surface under the middle of a square, else right beyond a rim, where a neighbour goes on there that is bent
/// but shaded as one with the chart, as smooth things are.
fn bent_light(world: &World, reading: &Reading) -> Option<GuestLight> {
    let Reading { block, square, site, rims, .. } = reading;
    let texel_m = world.lightmap.blocks[*block as usize].texel_m;
    let under = |at_m: Vec3, about: &Site, (height, shading_min): (f32, f32)| {
        let (hit, met) = surface_near(world, at_m, about.face_normal, height * texel_m)?;
        let found = world.geometry.site_at(&hit);
        let is_one = found.normal.dot(about.normal) >= shading_min
            && found.face_normal.dot(about.face_normal) >= BENT_COSINE_MIN;
        is_one.then_some((hit, (found, met)))
    };
    let block_of = |met: u32| world.lightmap.receivers[met as usize].block;
    let middle = LazyCell::new(|| under(square.middle_m, site, (BENT_AT_MIDDLE, BENT_COSINE_MIN)));
    rims.iter().find_map(|rim| {
        let (hit, across) = under(rim.across_m, &rim.site, (BENT_AT_RIM, COPLANAR_COSINE_MIN))?;
        if !is_other_chart(world, *block, &hit, rim) {
            return None;
        }
        // Another thing may lie under the middle.
        let goes_on = |(_, met): &(Site, u32)| [*block, block_of(across.1)].contains(&block_of(*met));
        let mut places = middle.map(|(_, middle)| middle).filter(goes_on).into_iter().chain([across]);
        let found = places.find(|(found, _)| suits(world, reading, rim, world.raised_on(*block, found)));
        found.map(|(found, met)| GuestLight::Own(found, met))
    })
}

/// Surface at a rim, and all rims in the guest's texel, sees a raised point. Of a texel that surface of the chart lies in, all of
/// that is to see the lender: it would show its light. Where corners of it do not, as rims may lie behind a wall and what is seen
/// before it, the receiver that stands for the texel is to; but a strip with the better claim, as beside a hollow, goes before it.
fn suits(world: &World, reading: &Reading, rim: &Rim, to_m: Vec3) -> bool {
    let Reading { block, texel: [x, y], rims, corners, .. } = reading;
    let sees = |site: &Site| world.is_linked(world.raised_on(*block, site), to_m);
    let keeps_texel = |standing: u32| {
        let look = |site: &Site| look_from(world, standing, site);
        let own = || look(&world.lightmap.receivers[standing as usize].site());
        !world.is_linked(world.raised_receiver(standing), to_m)
            && !corners.iter().all(sees)
            && !has_better_claim(&look(&rim.site), &own())
    };
    sees(&rim.site)
        && rims.iter().all(|rim| !rim.is_inside || sees(&rim.site))
        && !world.standing_on(*block, (*x).into(), (*y).into()).is_some_and(keeps_texel)
}

/// The receiver of another chart on whose surface a chart's goes on across a rim.
fn met_across(world: &World, block: u32, rim: &Rim) -> Option<u32> {
    let (hit, met) = surface_about(world, block, rim.across_m, &rim.site)?;
    is_other_chart(world, block, &hit, rim).then_some(met)
}

/// Surface across a rim is of another chart than the rim.
fn is_other_chart(world: &World, block: u32, hit: &Hit, rim: &Rim) -> bool {
    let key = world.lightmap.blocks[block as usize].key;
    world
        .lightmap_at(hit)
        .is_some_and(|(other, place)| other != key || place.distance(rim.across) > BORDER_TEXELS)
}

/// The surface that gathers light as a site does, at a point of its plane, and its receiver.
fn surface_about(world: &World, block: u32, at_m: Vec3, site: &Site) -> Option<(Hit, u32)> {
    let (hit, met) = surface_near(world, at_m, site.face_normal, 2.0 * level_m(world, block, at_m))?;
    let Site { normal, face_normal, .. } = world.geometry.site_at(&hit);
    gather_alike([normal, face_normal], [site.normal, site.face_normal]).then_some((hit, met))
}

/// The surface within a height of a point along a normal, and its receiver.
fn surface_near(world: &World, at_m: Vec3, normal: Vec3, height_m: f32) -> Option<(Hit, u32)> {
    let hit = world.geometry.tracer.closest_surface(at_m + normal * height_m, -normal, 2.0 * height_m)?;
    let Surface::Receiver(met) = world.surface_at(&hit) else { return None };
    Some((hit, met))
}

/// Light at the middle of a square on which a coplanar neighbour goes on, no wall between.
fn own_light(world: &World, Reading { block, square, site, .. }: &Reading) -> Option<GuestLight> {
    let (hit, met) = surface_about(world, *block, square.middle_m, site)?;
    let own = world.geometry.site_at(&hit);
    let raised = |site: &Site| world.raised_on(*block, site);
    let is_beside =
        world.lightmap.receivers[met as usize].block != *block && world.is_linked(raised(site), raised(&own));
    is_beside.then_some(GuestLight::Own(own, met))
}

/// Receivers with the light of others, and guests among them; all in the order of blocks and of their rasters.
fn with_light(
    lightmap: Lightmap,
    squares: &[Option<Square>],
    light_of: &[u32],
    guests: &[(Reading, GuestLight)],
) -> Lightmap {
    let borrowing = lightmap.receivers.iter().zip(light_of).map(|(own, &light_of)| {
        let Receiver { position_m, normal, face_normal, .. } = lightmap.receivers[light_of as usize];
        Receiver { position_m, normal, face_normal, light_of, ..*own }
    });
    let guest = |(Reading { block, texel, square, .. }, light): &(Reading, GuestLight)| {
        let of = |receiver: u32| Receiver {
            block: *block,
            texel: *texel,
            coverage: 0,
            fine: 0,
            area: AreaCode::ONE,
            light_of: receiver,
            ..lightmap.receivers[receiver as usize]
        };
        match *light {
            GuestLight::Of(lender) => {
                // Whoever lends in a square has one.
                let mirrored = squares[lender as usize].unwrap_or(*square).mirrored(square);
                let guest = of(lender);
                Receiver { edge: guest.edge.mirrored(mirrored), ..guest }
            }
            GuestLight::Beside(lender) => Receiver { edge: TexelEdge::NONE, ..of(lender) },
            GuestLight::Own(Site { position_m, normal, face_normal }, met) => {
                let edge = TexelEdge::NONE;
                Receiver { position_m, normal, face_normal, edge, light_of: ITSELF, ..of(met) }
            }
        }
    };
    let own = borrowing.zip(0..).map(|(receiver, number)| (receiver, Some(number)));
    let mut all: Vec<(Receiver, Option<u32>)> =
        own.chain(guests.iter().map(|found| (guest(found), None))).collect();
    all.sort_by_key(|(Receiver { block, texel: [x, y], .. }, _)| (*block, *y, *x));
    let mut number_of = vec![0; light_of.len()];
    for ((_, old), new) in all.iter().zip(0..) {
        if let Some(old) = old {
            number_of[*old as usize] = new;
        }
    }
    let mut blocks = lightmap.blocks;
    for slot in blocks.iter_mut().flat_map(|block| &mut block.receiver_of_texel) {
        // Entries beyond the receivers' numbers say why there is no receiver.
        *slot = number_of.get(*slot as usize).copied().unwrap_or(*slot);
    }
    let renumbered = |((receiver, _), own): ((Receiver, _), u32)| Receiver {
        light_of: number_of.get(receiver.light_of as usize).copied().unwrap_or(own),
        ..receiver
    };
    Lightmap { blocks, receivers: all.into_iter().zip(0..).map(renumbered).collect(), ..lightmap }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::content::Texel;

    use super::*;
    use crate::lightmap::{Block, NO_RECEIVER};

    fn receiver(block: u32, texel: Texel) -> Receiver {
        Receiver {
            block,
            texel,
            position_m: Vec3::new(block as f32, texel[0].into(), texel[1].into()),
            normal: Vec3::Y,
            face_normal: Vec3::Y,
            albedo: [0.1 * (block + 1) as f32; 3],
            emission: [0.0; 3],
            links: 0,
            coverage: 0b11 << block,
            fine: 0,
            edge: TexelEdge::new(0.0, 0.25),
            area: AreaCode::of(0.5),
            light_of: 0,
        }
    }

    #[test]
    fn guests_stand_in_order_and_all_have_the_light_of_those_that_lend_it() {
        let block = |key: u64, receiver_of_texel: Vec<u32>| Block {
            key,
            name: String::new(),
            texel_m: 0.1,
            size: [3, 2],
            instance: 0,
            receiver_of_texel,
        };
        let none = NO_RECEIVER;
        let lightmap = Lightmap {
            texel_m: 0.1,
            first_block: vec![0, 1],
            // The second row of the first block is read from the first.
            blocks: vec![
                block(5, vec![0, 1, none, 0, 1, none]),
                block(6, vec![none, none, none, none, none, 2]),
            ],
            receivers: vec![receiver(0, [0, 0]), receiver(0, [1, 0]), receiver(1, [2, 1])],
        };
        let square = Square { middle_m: Vec3::ZERO, right_m: Vec3::X, up_m: Vec3::Y };
        let site = receiver(0, [0, 0]).site();
        let reading = |block: u32, texel: Texel| {
            let (rims, corners) = (Vec::new(), Vec::new());
            Reading { block, texel, square, site, rims, corners }
        };
        let before = lightmap.clone();
        let guests = [
            (reading(0, [0, 1]), GuestLight::Of(0)),
            (reading(1, [0, 0]), GuestLight::Own(Site { position_m: Vec3::ONE, ..site }, 1)),
            (reading(0, [2, 0]), GuestLight::Of(1)),
        ];
        let from_behind = Square { right_m: -Vec3::X, ..square };
        let squares = [square, from_behind, square].map(Some);
        let found = with_light(lightmap, &squares, &[0, 1, 1], &guests);
        let order: Vec<(u32, Texel)> = found.receivers.iter().map(|r| (r.block, r.texel)).collect();
        assert_eq!(order, [(0, [0, 0]), (0, [1, 0]), (0, [2, 0]), (0, [0, 1]), (1, [0, 0]), (1, [2, 1])]);
        assert_eq!(found.receivers.iter().map(|r| r.light_of).collect::<Vec<_>>(), [0, 1, 1, 0, 4, 1]);
        assert_eq!([0, 1, 2, 3, 4, 5].map(|r| found.is_guest(r)), [false, false, true, true, true, false]);
        assert_eq!(found.blocks[0].receiver_of_texel, before.blocks[0].receiver_of_texel);
        assert_eq!(found.blocks[1].receiver_of_texel[5], 5);
        assert_eq!([found.receiver_at(0, 0, 1), found.receiver_at(0, 1, 1)], [Some(3), None]);
        // Whoever borrows keeps its surface; a guest has none, nor any points on it.
        let [lender, borrower, guest] = [1, 5, 2].map(|index| found.receivers[index]);
        assert_eq!([borrower.position_m, guest.position_m], [lender.position_m; 2]);
        assert_eq!((borrower.albedo, borrower.coverage), (before.receivers[2].albedo, 0b110));
        assert_eq!([guest.coverage, found.receivers[4].coverage], [0; 2]);
        // The lender of that guest lies on the plane from its back, where x runs the other way; that of the other does not.
        let behind = TexelEdge::new(std::f32::consts::PI, 0.25);
        assert_eq!(
            [3, 2, 4].map(|r| found.receivers[r].edge),
            [before.receivers[0].edge, behind, TexelEdge::NONE]
        );
        assert_eq!(found.receivers[4].position_m, Vec3::ONE);
    }
}
