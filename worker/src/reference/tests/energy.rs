//! Walls absorb the energy that lamps send.

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::rooms::sites_on_walls;
use super::*;

const SIZE: Vec3 = Vec3::new(3.0, 2.0, 4.0);

/// Mean E_dir and E_ind over the walls.
fn means(room: &Room, lighting: &Lighting) -> (f64, f64, usize) {
    let sites = sites_on_walls(SIZE, 24.0);
    let found = irradiance(room, lighting, &sites, Precision { rel_error: 0.1, paths_max: 512 });
    let count = found.len() as f64;
    let direct = found.iter().map(|e| e.direct.mean.y).sum::<f64>() / count;
    (direct, found.iter().map(|e| e.indirect.mean.y).sum::<f64>() / count, found.len())
}

#[test]
fn power_of_a_point_light_and_of_a_rectangle_is_absorbed_by_the_walls() {
    let albedo = 0.7_f32;
    let area_m2 = f64::from(2.0 * (SIZE.x * SIZE.y + SIZE.y * SIZE.z + SIZE.z * SIZE.x));
    let room = Room::new().walls(SIZE, albedo, 0.0).built();
    let kind = LightKind::Point { position_m: [1.0, 0.8, 2.5], range_m: None };
    let point = SceneLight { name: "point".into(), kind, strength: [5.0; 3] };
    let rect = rect([1.5, 1.0, 2.0], [0.0, 0.0, 1.0], [0.8, 0.6], 4.0);
    let lights = [
        (Lighting { lights: vec![point], ..Lighting::default() }, 4.0 * PI * 5.0),
        // Φ = π L A.
        (Lighting { lights: vec![rect], ..Lighting::default() }, PI * 4.0 * 4.0 * 0.4 * 0.3),
    ];
    for (lighting, power_w) in lights {
        let (direct, indirect, count) = means(&room, &lighting);
        assert!(count > 1000);
        // All of Φ falls on the walls once; of what falls on them, a share ρ comes back: Σ ρᵏ = ρ/(1 − ρ).
        let wanted = power_w / area_m2;
        assert!((direct / wanted - 1.0).abs() < 0.01, "E_dir {direct}, wanted {wanted}");
        let bounced = wanted * f64::from(albedo) / (1.0 - f64::from(albedo));
        assert!((indirect / bounced - 1.0).abs() < 0.01, "E_ind {indirect}, wanted {bounced}");
    }
}

#[test]
fn back_of_a_single_sided_wall_blocks_light_and_returns_none() {
    // The plate's back looks at the lit room's half; its front is unlit and never seen.
    let room = Room::new()
        .walls(SIZE, 0.0, 0.0)
        .rectangle(Vec3::new(1.0, 0.1, 1.0), Vec3::Z, Vec3::X, 0.9, 7.0)
        .built();
    // u × v = z × x = +y: the plate's front looks up. From the floor only its back is seen.
    let below = rooms::site(Vec3::new(1.5, 0.0, 1.5), Vec3::Y);
    let found = irradiance(&room, &emitters(), &[below], Precision::default());
    assert_eq!(found[0].indirect.mean, DVec3::ZERO);
    let above = rooms::site(Vec3::new(1.5, 2.0, 1.5), -Vec3::Y);
    let found = irradiance(&room, &emitters(), &[above], Precision::default());
    assert!(found[0].indirect.mean.y > 0.1, "{found:?}");
}
