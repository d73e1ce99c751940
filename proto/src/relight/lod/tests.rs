//! Levels of detail held against hand-made planes of receivers.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};

use super::*;
use crate::content::{
    AreaCode, ClusterTransport, Patch, PatchKey, PatchSet, Receivers, Texel, TexelEdge, TransportFactors,
};
use crate::relight::{ALWAYS, Columns, Incoming, Irradiance, Limit, PatchTable, Serial, Settled, Transport};

const SIDE: u16 = 16;
const BLOCK: u64 = 50;
/// No wall parts neighbours.
const OPEN: u8 = 0b1111;

/// A patch for each half of a plane, and one for both; the first half's differs from it by level 3.
fn patch_set() -> PatchSet {
    let of = |key: PatchKey, first_leaf, leaf_count| Patch { key, first_leaf, leaf_count };
    let mut patches = vec![of(half(0), 0, 1), of(half(1), 1, 1), of(whole(), 0, 2)];
    patches.sort_by_key(|patch| patch.key);
    let half_count = u32::from(SIDE) * u32::from(SIDE) / 2;
    let texel: Vec<Texel> = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| [x, y])).collect();
    PatchSet {
        patches,
        leaf_starts: vec![0, half_count, 2 * half_count],
        blocks: vec![BLOCK],
        block: vec![0; texel.len()],
        area: vec![AreaCode::ONE; texel.len()],
        texel,
        sky_parts: 0,
    }
}

fn half(index: i32) -> PatchKey {
    PatchKey::of_cell(3, [index, 0, 0], 2, 0)
}

fn whole() -> PatchKey {
    PatchKey::of_cell(4, [0, 0, 0], 2, 0)
}

/// Clusters of some rows of texels of one plane, a metre a texel; each reads the whole and a half's difference, in two ranks.
fn transport(bands: &[[u16; 2]], links: impl Fn(Texel) -> u8) -> Transport<PatchTable> {
    let clusters: Vec<ClusterTransport> =
        bands.iter().map(|[first, end]| cluster(*first..*end, &links)).collect();
    let blocks = [(BLOCK, [u32::from(SIDE); 2])];
    Transport::join(blocks, 0, &clusters, |slots| PatchTable::new(&patch_set(), slots)).unwrap()
}

fn cluster(rows: std::ops::Range<u16>, links: impl Fn(Texel) -> u8) -> ClusterTransport {
    let texel: Vec<Texel> = rows.flat_map(|y| (0..SIDE).map(move |x| [x, y])).collect();
    let count = texel.len();
    let receivers = Receivers {
        blocks: vec![BLOCK],
        block: vec![0; count],
        position_m: texel.iter().map(|[x, y]| [f32::from(*x), 0.0, f32::from(*y)]).collect(),
        normal: vec![[0.0, 1.0, 0.0]; count],
        albedo: vec![[0.5; 3]; count],
        links: texel.iter().map(|texel| links(*texel)).collect(),
        coverage: vec![u16::MAX; count],
        edge: vec![TexelEdge::NONE; count],
        texel: texel.clone(),
        ..Receivers::default()
    };
    // Light falls off along x: a row of texels is linear in its place.
    let u = texel.iter().flat_map(|[x, _]| [1.0, 0.01 * f32::from(*x)]).collect();
    let keys = vec![whole().0, half(0).difference().0];
    let vt = vec![0.6, 0.2, 0.0, 0.5];
    let factors = TransportFactors { keys, rank: 2, u, vt, ..TransportFactors::default() };
    ClusterTransport { receivers, factors, ..ClusterTransport::default() }
}

fn table_of(transport: &Transport<PatchTable>) -> LodTable {
    LodTable::new(&transport.slots, &transport.receivers, &transport.clusters)
}

/// One level everywhere from the eye on.
fn everywhere(level: LodLevel) -> Lod {
    let mut lod = Lod::preset("balanced").unwrap();
    lod.levels = [LodLevel { distance: LodDistance::Metres(0.0), ..level }; LOD_LEVELS];
    lod
}

fn eye_at(position_m: Vec3) -> LodEye {
    LodEye { position_m, forward: Vec3::Z, view_cos: 0.7, diagonal_m: 10.0 }
}

const FULL: LodLevel = LodLevel::full(LodDistance::Metres(0.0));
/// First row of texels of each cluster, and the end.
const WHOLE: &[[u16; 2]] = &[[0, SIDE]];
const HALVES: &[[u16; 2]] = &[[0, 8], [8, SIDE]];

/// Lamps that are brighter towards high x and low y.
fn lamps(transport: &Transport<PatchTable>) -> Vec<Vec4> {
    let at = |place: &Vec4| Vec4::new(3.0 + place.x, 4.0 - 0.1 * place.z, 2.0, 0.0);
    transport.receivers.position_m.iter().map(at).collect()
}

fn settled(
    transport: &Transport<PatchTable>,
    detail: Option<(&LodTable, &LodPlan)>,
    bounces_max: u32,
) -> Settled {
    let dir = lamps(transport);
    let incoming = Incoming {
        dir: &dir,
        near: &[],
        sky: Default::default(),
        panorama: None,
        emitter_scale: &[],
        ..Incoming::default()
    };
    transport.settle_in(&Serial, &incoming, Limit { bounces_max, change_max: 1e-6 }, detail)
}

fn in_detail(transport: &Transport<PatchTable>, lod: &Lod, eye: Vec3, bounces_max: u32) -> Settled {
    let table = table_of(transport);
    let plan = table.plan(&transport.clusters, lod, eye_at(eye), None);
    settled(transport, Some((&table, &plan)), bounces_max)
}

fn energy(light: &[Vec4]) -> f32 {
    light.iter().map(|e| e.truncate().element_sum()).sum()
}

#[test]
fn all_detail_is_what_it_is_without_levels_bit_for_bit() {
    let transport = transport(HALVES, |_| OPEN);
    let (wanted, found) =
        (settled(&transport, None, 50), in_detail(&transport, &everywhere(FULL), Vec3::ZERO, 50));
    assert!(wanted.converged && wanted.ind.iter().all(|e| e.x > 0.1));
    assert_eq!((found.bounces, found.ind), (wanted.bounces, wanted.ind));
}

#[test]
fn a_quarter_of_the_receivers_is_computed_and_the_others_lie_between_them() {
    let transport = transport(WHOLE, |_| OPEN);
    let table = table_of(&transport);
    assert_eq!(table.rows, [[256, 64, 16, 4]]);
    assert_eq!(table.stand_ins.each_ref().map(Vec::len), [192, 48, 12]);
    for receivers in 1..4 {
        let lod = everywhere(LodLevel { receivers, ..FULL });
        let (wanted, found) = (settled(&transport, None, 1), in_detail(&transport, &lod, Vec3::ZERO, 1));
        let stride = 1 << receivers;
        for (texel, (found, wanted)) in found.ind.iter().zip(&wanted.ind).enumerate() {
            let x = texel as u32 % 16;
            // Linear light is exact between receivers; at the rim there is one alone.
            let is_between = x <= 16 - stride;
            assert!(
                !is_between || (*found - *wanted).length() < 1e-5,
                "{receivers}: {texel}: {found} {wanted}"
            );
            assert!(found.x > 0.5 * wanted.x, "none is dark");
        }
    }
}

#[test]
fn walls_part_receivers_from_stand_ins_and_those_without_any_are_computed() {
    // Columns 0 to 7 are one side, the others another; column 15 is linked to nothing.
    let links = |[x, _]: Texel| match x {
        7 | 14 => 0b0010,
        8 => 0b0111,
        15 => 0,
        _ => OPEN,
    };
    let transport = transport(WHOLE, links);
    let table = table_of(&transport);
    let texel_of = |slot: u32| [slot % 16, slot / 16];
    for StandIn { slot, sources, .. } in table.stand_ins.iter().flatten() {
        let side = |slot: u32| match texel_of(slot)[0] {
            0..8 => 0,
            8..15 => 1,
            _ => 2,
        };
        for other in sources.iter().filter(|other| **other != NO_STAND_IN) {
            assert_eq!(side(*slot), side(*other), "{:?} {:?}", texel_of(*slot), texel_of(*other));
        }
        assert_ne!(sources[0], NO_STAND_IN);
    }
    // All of column 15 but none of its texels is of level 3.
    assert_eq!(table.alone(&transport.slots), 16);
    assert_eq!(table.rows[0][3], 4 + 16);
    let lod = everywhere(LodLevel { receivers: 3, ..FULL });
    let (wanted, found) = (settled(&transport, None, 1), in_detail(&transport, &lod, Vec3::ZERO, 1));
    for row in 0..16 {
        assert_eq!(found.ind[16 * row + 15], wanted.ind[16 * row + 15], "computed as without levels");
    }
    assert!(found.ind.iter().all(|e| e.x > 0.1), "none is dark");
}

#[test]
fn receivers_without_stand_ins_would_be_dark() {
    let transport = transport(WHOLE, |_| OPEN);
    let mut table = table_of(&transport);
    let lod = everywhere(LodLevel { receivers: 1, ..FULL });
    let plan = table.plan(&transport.clusters, &lod, eye_at(Vec3::ZERO), None);
    table.stand_ins = Default::default();
    let found = settled(&transport, Some((&table, &plan)), 1);
    assert_eq!(found.ind.iter().filter(|e| e.x == 0.0).count(), 192);
}

#[test]
fn columns_that_are_cut_leave_the_mean_and_the_energy() {
    let transport = transport(HALVES, |_| OPEN);
    let levels = &transport.clusters.column_levels;
    assert_eq!((levels.len(), levels.iter().filter(|level| **level == ALWAYS).count()), (4, 2));
    let lod = everywhere(LodLevel { columns: 4, ..FULL });
    let wanted = settled(&transport, None, 50);
    let found = in_detail(&transport, &lod, Vec3::ZERO, 50);
    assert_ne!(found.ind, wanted.ind, "something is cut");
    let share = energy(&found.ind) / energy(&wanted.ind);
    assert!((share - 1.0).abs() < 0.05, "{share}");
    // Were the whole cut as well, light would be lost.
    let mut dark = transport;
    dark.clusters.column_levels.fill(3);
    let lost = in_detail(&dark, &lod, Vec3::ZERO, 50);
    assert!(energy(&lost.ind) < 0.1 * energy(&wanted.ind));
}

#[test]
fn clusters_take_turns_and_none_is_left_out() {
    let transport = transport(&[[0, 4], [4, 8], [8, 12], [12, SIDE]], |_| OPEN);
    let table = table_of(&transport);
    let lod = everywhere(LodLevel { interval: 4, ..FULL });
    let plan = table.plan(&transport.clusters, &lod, eye_at(Vec3::ZERO), None);
    assert_eq!(plan.cycle(), 4);
    for first in [0, 7, u32::MAX - 1] {
        for (index, detail) in plan.details.iter().enumerate() {
            let turns = (0..4).filter(|turn| detail.is_due(index, first.wrapping_add(*turn))).count();
            assert_eq!(turns, 1, "cluster {index}");
        }
    }
    let [one, all] = [1, 4].map(|bounces| settled(&transport, Some((&table, &plan)), bounces));
    let lit = |settled: &Settled| settled.ind.iter().filter(|e| e.x > 0.0).count();
    assert_eq!((lit(&one), lit(&all)), (64, 256));
    // Light that has settled is what it is without turns: no turn of a cycle is taken for the end.
    let (wanted, found) = (settled(&transport, None, 400), settled(&transport, Some((&table, &plan)), 400));
    assert!(found.converged && found.bounces > wanted.bounces, "{} {}", found.bounces, wanted.bounces);
    for (found, wanted) in found.ind.iter().zip(&wanted.ind) {
        assert!((*found - *wanted).length() < 1e-4 * wanted.length(), "{found} {wanted}");
    }
    // A cluster whose turn never came would be dark for ever.
    let mut skipped = plan.clone();
    skipped.details[2].interval = 1 << 20;
    let without = settled(&transport, Some((&table, &skipped)), 50);
    assert_eq!(lit(&without), 192);
}

#[test]
fn no_receiver_is_closer_than_its_cluster_in_any_zone() {
    let transport = transport(HALVES, |_| OPEN);
    let table = table_of(&transport);
    let lod = Lod::preset("coarse").unwrap();
    for x in -3..8 {
        for z in -3..8 {
            let position_m = Vec3::new(3.0 * x as f32, 1.5, 3.0 * z as f32);
            for forward in [Vec3::X, Vec3::Z, Vec3::NEG_Y, Vec3::new(0.6, 0.0, -0.8)] {
                let eye = LodEye { position_m, forward, ..eye_at(position_m) };
                let plan = table.plan(&transport.clusters, &lod, eye, None);
                for (cluster, bounds_m) in transport.clusters.clusters.iter().zip(&table.bounds_m) {
                    let closest_m = super::plan::closest_m(*bounds_m, &lod, eye);
                    for place in &transport.receivers.position_m[cluster.rows()] {
                        let distance_m = plan.distance_m(place.truncate());
                        assert!(
                            distance_m >= closest_m - 1e-3,
                            "{position_m} {forward}: {distance_m} {closest_m}"
                        );
                    }
                }
            }
        }
    }
    // Behind the eye is farther than before it, and beside between them.
    let [before, beside, behind] = [1.0, 0.0, -1.0].map(|cos| lod.zone(cos, 0.7));
    assert_eq!([before, beside, behind], [1.0, lod.beside, lod.behind]);
    let zones: Vec<f32> = (-100..=100).map(|step| lod.zone(step as f32 / 100.0, 0.7)).collect();
    assert!(zones.windows(2).all(|pair| pair[0] >= pair[1] && pair[0] - pair[1] < 0.05));
}

/// Distances of an eye that trembles about that of a level.
fn trembling(lod: &Lod, with_memory: bool) -> usize {
    let transport = transport(WHOLE, |_| OPEN);
    let table = table_of(&transport);
    let mut before: Option<LodPlan> = None;
    let mut changes = 0;
    for step in 0..40 {
        // The plane ends at x = 15; level 1 begins 6 m away.
        let eye = Vec3::new(15.0 + 6.0 + 0.2 * [-1.0, 1.0][step % 2], 0.0, 8.0);
        let eye = LodEye { forward: Vec3::NEG_X, ..eye_at(eye) };
        let plan = table.plan(&transport.clusters, lod, eye, before.as_ref().filter(|_| with_memory));
        changes += usize::from(before.is_some_and(|before| before.levels != plan.levels));
        before = Some(plan);
    }
    changes
}

#[test]
fn an_eye_that_trembles_changes_no_level_but_does_without_a_margin() {
    let mut lod = Lod::preset("balanced").unwrap();
    for (level, distance_m) in lod.levels.iter_mut().zip([0.0, 6.0, 100.0, 200.0]) {
        level.distance = LodDistance::Metres(distance_m);
    }
    assert_eq!(trembling(&lod, true), 0, "the finer level stays");
    assert!(trembling(&lod, false) > 30 && trembling(&Lod { margin: 0.0, ..lod }, true) > 30);
}

#[test]
fn light_goes_over_to_stand_ins_by_distance_without_a_step() {
    let transport = transport(WHOLE, |_| OPEN);
    let table = table_of(&transport);
    let mut lod = everywhere(FULL);
    for level in &mut lod.levels[1..] {
        *level = LodLevel { distance: LodDistance::Metres(12.0), receivers: 1, ..FULL };
    }
    lod.blend = 0.5;
    // The closest place is within level 0: all are computed, those beyond 12 m are all their stand-ins'.
    let eye = eye_at(Vec3::new(7.5, 0.0, -1.0));
    let plan = table.plan(&transport.clusters, &lod, eye, None);
    assert_eq!((plan.levels[0], plan.details[0].rows), (0, 256));
    let share = |z: f32| plan.share(0, Vec3::new(7.5, 0.0, z));
    assert_eq!([share(0.0), share(5.0), share(11.0), share(14.0)], [0.0, 0.0, 1.0, 1.0]);
    assert!((share(8.0) - 0.5).abs() < 1e-6);
    // Receivers of every other row are brighter: far away nothing of it is left.
    let bright = |slot: usize| 1.0 + (slot / 16 % 2) as f32;
    let ind: Vec<Vec4> = (0..256).map(|slot| Vec4::splat(bright(slot))).collect();
    let mut next = ind.clone();
    for stand_in in &table.stand_ins[0] {
        let own = super::bounce::filled((&plan, 0), stand_in, &transport.receivers, &ind, 0);
        next[stand_in.slot as usize] = own.unwrap_or(ind[stand_in.slot as usize]);
    }
    let odd_rows: Vec<f32> = (0..8).map(|row| next[16 * (2 * row + 1) + 7].x).collect();
    assert!(odd_rows.windows(2).all(|pair| pair[0] >= pair[1]), "{odd_rows:?}");
    assert_eq!((odd_rows[0], odd_rows[7]), (2.0, 1.0));
}

#[test]
fn irradiance_of_a_plan_is_counted() {
    let transport = transport(HALVES, |_| OPEN);
    let table = table_of(&transport);
    let lod = everywhere(LodLevel { columns: 4, receivers: 2, interval: 2, ..FULL });
    let plan = table.plan(&transport.clusters, &lod, eye_at(Vec3::ZERO), None);
    let count = plan.counts(&transport.clusters)[LOD_LEVELS - 1];
    let wanted = LevelCount {
        clusters: 2,
        receivers: 256,
        receivers_computed: 16,
        numbers: 8,
        numbers_read: 4,
        interval: 2,
    };
    assert_eq!(count, wanted);
    let black = vec![Vec4::ZERO; 256];
    let lit = Irradiance { dir: &lamps(&transport), emit: &black, ind: &black };
    assert!(
        (transport.columns.surface_lambda(&Serial, &transport.receivers, lit)[0].z - 1.0 / PI).abs() < 1e-5
    );
}
