//! METHOD.md §4.1: a closed scene of albedo a and emission e has radiance e/(1 − a) everywhere.

use glam::Vec3;
use lightkiln_proto::scene::SceneCamera;

use super::rooms::{site, sites_on_walls};
use super::*;

const SIZE: Vec3 = Vec3::new(2.0, 1.0, 3.0);

#[test]
fn furnace_has_emission_over_one_minus_albedo_within_its_standard_error() {
    let precision = Precision { rel_error: 0.005, paths_max: 1 << 14 };
    for albedo in [0.1_f32, 0.3, 0.5, 0.7, 0.9] {
        let room = Room::new().walls(SIZE, albedo, 1.0).built();
        let sites = sites_on_walls(SIZE, 1.0);
        let found = irradiance(&room, &emitters(), &sites, precision);
        let wanted = PI / (1.0 - f64::from(albedo));
        let (mut sum, mut variance, mut chi) = (0.0, 0.0, 0.0);
        for estimate in &found {
            assert_sure(&estimate.indirect, wanted, 5.0, "a site of the furnace");
            assert_eq!(estimate.direct.mean, glam::DVec3::ZERO);
            sum += estimate.indirect.mean.y;
            variance += estimate.indirect.error.y.powi(2);
            chi += ((estimate.indirect.mean.y - wanted) / estimate.indirect.error.y).powi(2);
        }
        let count = found.len() as f64;
        let (mean, error) = (sum / count, variance.sqrt() / count);
        assert!((mean - wanted).abs() < 4.0 * error, "albedo {albedo}: {mean} ± {error}, wanted {wanted}");
        // The stated errors are the true ones: χ² per site is 1 within a few of its own deviations √(2/n).
        let ratio = chi / count;
        assert!((0.3..2.0).contains(&ratio), "albedo {albedo}: χ²/n = {ratio} over {count} sites");
    }
}

#[test]
fn furnace_seen_by_a_camera_has_the_same_radiance() {
    let room = Room::new().walls(SIZE, 0.6, 2.0).built();
    let camera = SceneCamera {
        name: String::new(),
        eye_m: [1.0, 0.5, 0.2],
        target_m: [1.1, 0.4, 3.0],
        up: [0.0, 1.0, 0.0],
        fov_y_rad: 1.2,
        orthographic_half_height_m: None,
    };
    let size = PictureSize { width: 12, height: 8, grid: 12 };
    let film = room.under(&emitters()).picture(&camera, &size, &Progress::new()).unwrap();
    let values: Vec<f64> = film.radiance.iter().map(|pixel| f64::from(pixel[1])).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let spread = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
    let error = (spread / values.len() as f64).sqrt();
    assert!(error < 0.01 * mean && (mean - 5.0).abs() < 4.0 * error, "{mean} ± {error}");
}

#[test]
fn furnace_of_sky_around_a_white_plate_is_the_sky() {
    // A double-sided plate of albedo a under an even sky L: E = πL on both sides, it leaves aL; no energy is gained.
    let corners = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::Z];
    let room = Room::new().mesh(corners, vec![[0, 2, 1], [0, 3, 2]], 0.9, 0.0, true).built();
    let kind = lightkiln_proto::scene::LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] };
    let sky = lightkiln_proto::scene::SceneLight { name: "sky".into(), kind, strength: [2.0; 3] };
    let lighting = Lighting { lights: vec![sky], ..Lighting::default() };
    let centre = Vec3::new(0.5, 0.0, 0.5);
    let precision = Precision { rel_error: 0.002, paths_max: 1 << 16 };
    for normal in [Vec3::Y, -Vec3::Y] {
        let found = irradiance(&room, &lighting, &[site(centre, normal)], precision);
        assert_sure(&found[0].indirect, 2.0 * PI, 4.0, "a side of the plate");
    }
}
