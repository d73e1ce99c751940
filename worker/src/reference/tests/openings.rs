//! Light that few paths find: small lit patches, and a low sun through a window with a deep reveal.

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::rooms::{site, sites_on_walls};
use super::*;

fn lit(kind: LightKind, strength: f32) -> Lighting {
    let lamp = SceneLight { name: "lamp".into(), kind, strength: [strength; 3] };
    Lighting { lights: vec![lamp], ..Lighting::default() }
}

/// A black room of 3 m whose ceiling, of albedo 0.8, has a spot's disc on it, and a grid of sites on its floor.
fn disc() -> (Room, Lighting, Vec<Site>) {
    let mut room = Room::new();
    for (corner, u, v) in Room::sides(Vec3::splat(3.0)) {
        let albedo = if u.cross(v).y < 0.0 { 0.8 } else { 0.0 };
        room = room.rectangle(corner, u, v, albedo, 0.0);
    }
    let outer_rad = 0.05;
    let kind = LightKind::Spot {
        position_m: [1.5, 2.0, 1.5],
        direction: [0.0, 1.0, 0.0],
        inner_rad: outer_rad,
        outer_rad,
        range_m: None,
    };
    let at = |index: u32| Vec3::new(0.2 + 0.13 * (index % 20) as f32, 0.0, 0.2 + 0.13 * (index / 20) as f32);
    (room.built(), lit(kind, 100.0), (0..400).map(|index| site(at(index), Vec3::Y)).collect())
}

/// E on the floor by the disc: flux I · 2π(1 − cos γ) (cos θ ≈ 1 across it), radiance ρ/π of it, from 3 m below.
fn by_disc(site: &Site) -> f64 {
    let flux = 100.0 * 2.0 * PI * (1.0 - 0.05_f64.cos());
    let way = DVec3::new(1.5, 3.0, 1.5) - site.position_m.as_dvec3();
    0.8 / PI * flux * way.y.powi(2) / way.length().powi(4)
}

#[test]
fn places_where_the_first_paths_find_nothing_are_not_taken_as_dark() {
    let (room, lighting, sites) = disc();
    // Without a guide: a path finds the disc in one of some 3,000 tries.
    let reference = room.under(&lighting).with_strategy(Strategy::Lamps);
    let precision = Precision { rel_error: 0.1, paths_max: 1 << 14 };
    let found = reference.irradiance(&sites, &precision, &Progress::new()).unwrap();
    let (mut off, mut variance, mut wanted) = (0.0, 0.0, 0.0);
    for (site, found) in sites.iter().zip(&found) {
        off += found.indirect.luminance() - by_disc(site);
        variance += found.indirect.luminance_error.powi(2);
        wanted += by_disc(site);
    }
    assert!(variance.sqrt() < 0.1 * wanted, "{} of {wanted} shows nothing", variance.sqrt());
    assert!(off.abs() < 3.0 * variance.sqrt(), "{off} ± {} of {wanted}", variance.sqrt());
    // No place is sure of the nothing that it found.
    assert!(found.iter().all(|found| found.indirect.luminance_error > 0.0));
}

#[test]
fn guide_finds_a_small_lit_patch_with_few_paths() {
    let (room, lighting, sites) = disc();
    let precision = Precision { rel_error: 0.0, paths_max: 512 };
    let found = irradiance(&room, &lighting, &sites, precision);
    for (site, found) in sites.iter().zip(&found) {
        let (wanted, error) = (by_disc(site), found.indirect.luminance_error);
        assert!(error < 0.08 * wanted, "{site:?}: {error} of {wanted}");
        assert!(
            (found.indirect.luminance() - wanted).abs() < 5.0 * error + 0.01 * wanted,
            "{site:?} {found:?}"
        );
    }
}

/// A kitchen's kind of room, 4 × 2.6 × 5 m, albedo 0.6: a window of 0.5 × 0.6 m at the end of a reveal 0.8 m deep.
fn kitchen() -> Room {
    let size = Vec3::new(4.0, 2.6, 5.0);
    let mut room = Room::new();
    for (index, (corner, u, v)) in Room::sides(size).into_iter().enumerate() {
        if index != 4 {
            room = room.rectangle(corner, u, v, 0.6, 0.0);
        }
    }
    // The wall at x = 0 round the opening, and the opening's four sides, fronts inwards.
    let (low, high) = (Vec3::new(0.0, 1.0, 2.0), Vec3::new(0.0, 1.6, 2.5));
    let (y, z) = (Vec3::Y, Vec3::Z);
    let wall =
        |room: Room, corner: Vec3, up: f32, along: f32| room.rectangle(corner, y * up, z * along, 0.6, 0.0);
    room = wall(room, Vec3::ZERO, low.y, size.z);
    room = wall(room, Vec3::new(0.0, high.y, 0.0), size.y - high.y, size.z);
    room = wall(room, Vec3::new(0.0, low.y, 0.0), high.y - low.y, low.z);
    room = wall(room, Vec3::new(0.0, low.y, high.z), high.y - low.y, size.z - high.z);
    let depth = Vec3::NEG_X * 0.8;
    let (up, along) = (y * (high.y - low.y), z * (high.z - low.z));
    room = room.rectangle(low, along, -depth, 0.6, 0.0).rectangle(low + up + depth, along, depth, 0.6, 0.0);
    room = room.rectangle(low + depth, -depth, up, 0.6, 0.0);
    room.rectangle(low + along, depth, up, 0.6, 0.0).built()
}

/// Sites deep in the room that 256 paths without a guide find nothing from.
#[test]
fn places_where_pilots_find_nothing_agree_with_their_own_long_run() {
    let room = kitchen();
    let lighting = lit(LightKind::Sun { direction: [0.92, -0.3, 0.25] }, 50.0);
    let unguided = room.under(&lighting).with_strategy(Strategy::Lamps);
    let few = Precision { rel_error: 0.0, paths_max: 256 };
    let all = sites_on_walls(Vec3::new(4.0, 2.6, 5.0), 4.0);
    let found = unguided.irradiance(&all, &few, &Progress::new()).unwrap();
    let dark = all.iter().zip(&found).filter(|(_, found)| found.indirect.mean == DVec3::ZERO);
    let sites: Vec<Site> = dark.map(|(site, _)| *site).take(20).collect();
    assert_eq!(sites.len(), 20);
    let one = irradiance(&room, &lighting, &sites, Precision::default());
    let long = Precision { rel_error: 0.0, paths_max: 1 << 18 };
    let long = unguided.irradiance(&sites, &long, &Progress::new()).unwrap();
    for (one, long) in one.iter().zip(&long) {
        let [one, long] = [one, long].map(|found| found.indirect);
        let both = one.luminance_error.hypot(long.luminance_error);
        println!(
            "{:.5} ± {:.5}, long {:.5} ± {:.5}",
            one.luminance(),
            one.luminance_error,
            long.luminance(),
            long.luminance_error
        );
        assert!((one.luminance() - long.luminance()).abs() < 3.0 * both, "{one:?} {long:?}");
    }
}

#[test]
fn low_sun_through_a_deep_reveal_agrees_with_a_long_run_that_nothing_guides() {
    let room = kitchen();
    let lighting = lit(LightKind::Sun { direction: [0.92, -0.3, 0.25] }, 50.0);
    let sites: Vec<Site> = sites_on_walls(Vec3::new(4.0, 2.6, 5.0), 0.25)
        .into_iter()
        .filter(|site| site.face_normal.x <= 0.0)
        .collect();
    assert!(sites.len() >= 15);
    let guided = irradiance(&room, &lighting, &sites, Precision { rel_error: 0.0, paths_max: 1 << 11 });
    let reference = room.under(&lighting).with_strategy(Strategy::Lamps);
    let long = Precision { rel_error: 0.0, paths_max: 1 << 14 };
    let long = reference.irradiance(&sites, &long, &Progress::new()).unwrap();
    let mut gain = 0.0;
    let (mut off, mut variance, mut total) = (0.0, 0.0, 0.0);
    for (one, other) in guided.iter().zip(&long) {
        let errors = [one, other].map(|found| found.indirect.luminance_error);
        let both = errors[0].hypot(errors[1]);
        let difference = one.indirect.luminance() - other.indirect.luminance();
        assert!(difference.abs() < 4.5 * both, "{difference} ± {both}");
        // Variance of one path of either: the squared error times the paths.
        gain += (errors[1] / errors[0]).powi(2) * 8.0 / sites.len() as f64;
        (off, variance, total) =
            (off + difference, variance + both * both, total + other.indirect.luminance());
    }
    assert!(variance.sqrt() < 0.03 * total, "{} of {total} shows nothing", variance.sqrt());
    assert!(off.abs() < 3.0 * variance.sqrt(), "{off} ± {} of {total}", variance.sqrt());
    assert!(gain > 8.0, "a path that is guided is worth {gain:.1} others");
}
