//! The same result by other ways: other strategies, other numbers of threads.

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::rooms::{site, sites_on_walls};
use super::*;

/// A room with a window, a lamp, a rectangle that hangs free, and a sky outside.
fn room() -> (Room, Lighting) {
    let size = Vec3::new(2.0, 2.0, 2.0);
    let mut room = Room::new();
    // Without the wall at z = 2: the window.
    for (index, (corner, u, v)) in Room::sides(size).into_iter().enumerate() {
        if index != 3 {
            room = room.rectangle(corner, u, v, 0.6, 0.0);
        }
    }
    let room = room.rectangle(Vec3::new(0.6, 1.9, 0.6), Vec3::X * 0.5, Vec3::Z * 0.5, 0.3, 5.0).built();
    let sky = LightKind::Sky { zenith: [2.0, 3.0, 4.0], horizon: [1.0; 3] };
    let lamp = LightKind::Point { position_m: [1.5, 1.0, 1.2], range_m: None };
    let light = |name: &str, kind| SceneLight { name: name.into(), kind, strength: [1.0; 3] };
    let rect = rect([0.3, 1.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.4], 3.0);
    let lighting = Lighting {
        lights: vec![light("sky", sky), light("lamp", lamp), rect],
        emitter_scale: 1.0,
        ..Lighting::default()
    };
    (room, lighting)
}

fn sites() -> Vec<Site> {
    vec![
        site(Vec3::new(1.0, 0.0, 1.0), Vec3::Y),
        site(Vec3::new(0.9, 2.0, 1.7), -Vec3::Y),
        site(Vec3::new(2.0, 1.2, 0.7), -Vec3::X),
    ]
}

#[test]
fn sampling_lamps_directions_or_both_gives_the_same_mean() {
    let (room, lighting) = room();
    let precision = Precision { rel_error: 0.006, paths_max: 1 << 17 };
    let by = |strategy| {
        let reference = room.under(&lighting).with_strategy(strategy);
        reference.irradiance(&sites(), &precision, &Progress::new()).unwrap()
    };
    let both = by(Strategy::Both);
    for strategy in [Strategy::Lamps, Strategy::Directions] {
        for (one, other) in both.iter().zip(by(strategy)) {
            for (a, b) in [(one.direct, other.direct), (one.indirect, other.indirect)] {
                let error = (a.luminance_error.powi(2) + b.luminance_error.powi(2)).sqrt();
                assert!(
                    error < 0.02 * a.luminance().max(b.luminance()),
                    "{strategy:?}: {a:?} {b:?} show nothing"
                );
                let off = (a.luminance() - b.luminance()).abs();
                assert!(
                    off < 4.0 * error + 1e-9,
                    "{strategy:?}: {} and {}, ± {error}",
                    a.luminance(),
                    b.luminance()
                );
            }
        }
    }
}

#[test]
fn light_of_several_points_is_their_mean_in_both_halves() {
    let (room, lighting) = room();
    let reference = room.under(&lighting);
    let precision = Precision { rel_error: 0.006, paths_max: 1 << 17 };
    let each = reference.irradiance(&sites(), &precision, &Progress::new()).unwrap();
    let target = Target { points: sites(), ..Target::of(sites()[0]) };
    let found = reference.mean_irradiance(&[target], &precision, &Progress::new()).unwrap()[0];
    let mean = each.iter().map(|one| one.indirect.mean).sum::<DVec3>() / 3.0;
    let direct = each.iter().map(|one| one.direct.mean).sum::<DVec3>() / 3.0;
    let light = luminance(mean);
    assert!(
        each.iter().any(|one| (one.indirect.luminance() / light - 1.0).abs() > 0.12),
        "{each:?} are alike"
    );
    for half in found.halves {
        assert!((luminance(half) / light - 1.0).abs() < 0.03, "{half} of {mean}");
    }
    assert!((luminance(found.direct.mean) / luminance(direct) - 1.0).abs() < 0.03, "{found:?} {direct}");
}

#[test]
fn weights_share_out_the_paths_of_a_mean() {
    let (room, lighting) = room();
    let reference = room.under(&lighting);
    let precision = Precision { rel_error: 0.005, paths_max: 1 << 17 };
    let target = |weight: f64| Target { weight, ..Target::of(sites()[0]) };
    let found =
        reference.mean_irradiance(&[target(0.25), target(4.0)], &precision, &Progress::new()).unwrap();
    let paths: Vec<u32> = found.iter().map(|found| found.paths).collect();
    assert!((8..=32).contains(&(paths[1] / paths[0])), "{paths:?}");
}

#[test]
fn result_is_the_same_bits_on_one_and_on_many_threads() {
    let (room, lighting) = room();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sites = sites_on_walls(Vec3::splat(2.0), 2.0);
            let precision = Precision { rel_error: 0.01, paths_max: 2048 };
            irradiance(&room, &lighting, &sites, precision)
        })
    };
    let (one, many) = (on(1), on(5));
    assert_eq!(one, many);
    assert!(one.iter().any(|estimate| estimate.paths > 512), "nothing was refined: the test shows little");
}

#[test]
fn order_and_company_of_sites_do_not_change_their_random_numbers() {
    let (room, lighting) = room();
    let precision = Precision { rel_error: 0.0, paths_max: 512 };
    let mut sites = sites();
    let forwards = irradiance(&room, &lighting, &sites, precision);
    sites.reverse();
    let mut backwards = irradiance(&room, &lighting, &sites, precision);
    backwards.reverse();
    assert_eq!(forwards, backwards);
}
