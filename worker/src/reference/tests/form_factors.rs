//! Light that has not bounced, against closed forms.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};

use super::rooms::site;
use super::*;
use crate::rays::sampling::R2;

const PRECISION: Precision = Precision { rel_error: 0.002, paths_max: 1 << 16 };

/// Irradiance from a polygon of radiance 1, wholly above the horizon, by Lambert's formula ½ Σ Γᵢ·n.
fn lambert(corners: &[Vec3], at: Vec3, normal: Vec3) -> f64 {
    let towards: Vec<DVec3> = corners.iter().map(|corner| (*corner - at).as_dvec3().normalize()).collect();
    let edges = (0..towards.len()).map(|i| (towards[i], towards[(i + 1) % towards.len()]));
    let sum: DVec3 = edges.map(|(a, b)| a.cross(b).normalize() * a.dot(b).clamp(-1.0, 1.0).acos()).sum();
    0.5 * sum.dot(normal.as_dvec3()).abs()
}

#[test]
fn sphere_above_a_plane_gives_its_squared_sine() {
    // E = πL (R/d)² cosθ for a sphere wholly above the horizon.
    let (centre, radius, radiance) = (Vec3::new(0.3, 2.0, -0.2), 0.7_f32, 3.0_f32);
    let (rings, turns) = (48_u32, 96_u32);
    let mut positions = Vec::new();
    for ring in 0..=rings {
        for turn in 0..turns {
            let (sine, cosine) = (std::f32::consts::PI * ring as f32 / rings as f32).sin_cos();
            let (s, c) = (std::f32::consts::TAU * turn as f32 / turns as f32).sin_cos();
            positions.push(centre + radius * Vec3::new(sine * c, cosine, sine * s));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for turn in 0..turns {
            let (a, b) = (ring * turns + turn, ring * turns + (turn + 1) % turns);
            if ring > 0 {
                triangles.push([a, b, a + turns]);
            }
            if ring + 1 < rings {
                triangles.push([b, b + turns, a + turns]);
            }
        }
    }
    let room = Room::new().mesh(positions, triangles, 0.0, radiance, false).built();
    // Half of the many triangles, chosen by power alone, face away: it takes many paths.
    let precision = Precision { rel_error: 0.006, paths_max: 1 << 17 };
    for at in [Vec3::ZERO, Vec3::new(1.0, 0.0, 0.5), Vec3::new(-2.0, 0.0, 1.0)] {
        let found = irradiance(&room, &emitters(), &[site(at, Vec3::Y)], precision)[0].indirect;
        let to = (centre - at).as_dvec3();
        let wanted = PI * f64::from(radiance) * f64::from(radius).powi(2) * to.y / to.length().powi(3);
        // The faceted sphere is a little smaller than the round one: by some (π/96)² of its outline.
        let off = (found.mean.y / wanted - 1.0).abs();
        // The pilot knows the variance within a third, hence the error within a sixth, and this is a single site.
        assert!(found.error.y < 0.008 * wanted, "{found:?}");
        assert!(off < 4.0 * found.error.y / wanted + 0.002, "{} wanted {wanted}", found.mean.y);
    }
}

#[test]
fn parallel_plates_have_the_closed_form_at_points_and_in_the_mean() {
    let (c, plate) = (1.0_f32, [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, 1.0), Vec3::Z]);
    let lift = Vec3::Y * c;
    let room = Room::new().rectangle(plate[0] + lift, Vec3::X, Vec3::Z, 0.0, 1.0).built();
    for at in [Vec3::new(0.5, 0.0, 0.5), Vec3::new(0.1, 0.0, 0.9), Vec3::new(-1.0, 0.0, 2.0)] {
        let found = irradiance(&room, &emitters(), &[site(at, Vec3::Y)], PRECISION)[0].indirect;
        assert_sure(
            &found,
            lambert(&plate.map(|corner| corner + lift), at, Vec3::Y),
            4.0,
            "a point below a plate",
        );
    }
    // Directly opposed unit squares a unit apart ([Howell] C-11).
    let x = 1.0_f64;
    let root = (1.0 + x * x).sqrt();
    let factor = 2.0 / (PI * x * x)
        * (((1.0 + x * x).powi(2) / (1.0 + 2.0 * x * x)).sqrt().ln() + 2.0 * x * root * (x / root).atan()
            - 2.0 * x * x.atan());
    assert!((factor - 0.19982).abs() < 1e-5, "{factor}");
    assert_mean_factor(&room, factor, |s, t| site(Vec3::new(s, 0.0, t), Vec3::Y));
}

#[test]
fn corner_of_two_squares_has_the_closed_form_at_points_and_in_the_mean() {
    // The wall shines in the plane x = 0, the floor receives in y = 0; they share an edge.
    let wall = [Vec3::ZERO, Vec3::Y, Vec3::new(0.0, 1.0, 1.0), Vec3::Z];
    let room = Room::new().rectangle(Vec3::ZERO, Vec3::Y, Vec3::Z, 0.0, 1.0).built();
    for at in [Vec3::new(0.02, 0.0, 0.5), Vec3::new(0.5, 0.0, 0.1), Vec3::new(2.0, 0.0, 1.5)] {
        let found = irradiance(&room, &emitters(), &[site(at, Vec3::Y)], PRECISION)[0].indirect;
        assert_sure(&found, lambert(&wall, at, Vec3::Y), 4.0, "a point beside a wall");
    }
    // Perpendicular unit squares with a common edge ([Howell] C-14, W = H = 1).
    let factor = (0.5 * PI - 2.0_f64.sqrt() * (1.0 / 2.0_f64.sqrt()).atan() + 0.25 * 0.75_f64.ln()) / PI;
    assert!((factor - 0.20004).abs() < 1e-5, "{factor}");
    assert_mean_factor(&room, factor, |s, t| site(Vec3::new(s, 0.0, t), Vec3::Y));
}

/// The mean of E/π over a unit square is the form factor.
fn assert_mean_factor(room: &Room, wanted: f64, at: impl Fn(f32, f32) -> Site) {
    let points = R2::new(5);
    let sites: Vec<Site> = (0..1024).map(|index| points.point(index)).map(|[s, t]| at(s, t)).collect();
    let precision = Precision { rel_error: 0.05, paths_max: 512 };
    let found = irradiance(room, &emitters(), &sites, precision);
    let mean = found.iter().map(|e| e.indirect.mean.y / PI).sum::<f64>() / found.len() as f64;
    assert!((mean / wanted - 1.0).abs() < 0.004, "{mean}, wanted {wanted}");
}

#[test]
fn rectangle_shines_like_an_emissive_rectangle_but_only_from_its_front() {
    let corners = [Vec3::new(-0.5, 1.0, -1.0), Vec3::new(0.5, 1.0, -1.0), Vec3::new(0.5, 1.0, 1.0)];
    let down = rect([0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 2.0], 1.0);
    let room = Room::new().rectangle(Vec3::new(9.0, -5.0, 0.0), Vec3::X, Vec3::Y, 0.5, 0.0).built();
    let of = |rect: &SceneLight| Lighting { lights: vec![rect.clone()], ..Lighting::default() };
    let below = site(Vec3::new(0.2, 0.0, 0.3), Vec3::Y);
    let found = irradiance(&room, &of(&down), &[below], PRECISION)[0];
    let outline = [corners[0], corners[1], corners[2], Vec3::new(-0.5, 1.0, 1.0)];
    let wanted = lambert(&outline, below.position_m, Vec3::Y);
    assert_sure(&found.direct, wanted, 4.0, "a point below the rectangle");
    let shadow_rays = room.under(&of(&down)).direct_irradiance(&below, 4096);
    assert!((shadow_rays.y / wanted - 1.0).abs() < 5e-3, "{shadow_rays} wanted {wanted}");
    let turned = rect([0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0], 1.0);
    assert_eq!(irradiance(&room, &of(&turned), &[below], PRECISION)[0].direct.mean, DVec3::ZERO);
}

#[test]
fn gradient_sky_and_punctual_lights_have_their_closed_forms_on_a_plane() {
    let room = Room::new().rectangle(Vec3::new(0.0, -1.0, 0.0), Vec3::Z, Vec3::X, 0.5, 0.0).built();
    let up = site(Vec3::new(0.5, -1.0, 0.5), Vec3::Y);
    let light = |kind, strength: f32| Lighting {
        lights: vec![SceneLight { name: "light".into(), kind, strength: [strength; 3] }],
        ..Lighting::default()
    };
    let sky = light(LightKind::Sky { zenith: [3.0; 3], horizon: [1.0; 3] }, 1.0);
    let found = irradiance(&room, &sky, &[up], PRECISION)[0];
    // ∫(h + (z − h)cosθ)cosθ dω = πh + (z − h)·2π/3.
    assert_sure(&found.indirect, PI + 2.0 * TAU / 3.0, 4.0, "a plane under the sky");
    let point = light(LightKind::Point { position_m: [0.5, 1.0, 0.5], range_m: None }, 8.0);
    assert!((irradiance(&room, &point, &[up], PRECISION)[0].direct.mean.y - 2.0).abs() < 1e-5);
    let sun = light(LightKind::Sun { direction: [3.0, -4.0, 0.0] }, 10.0);
    assert!((irradiance(&room, &sun, &[up], PRECISION)[0].direct.mean.y - 8.0).abs() < 1e-5);
    let spot = |aside: f32| LightKind::Spot {
        position_m: [0.5, 1.0, 0.5],
        direction: [aside, -1.0, 0.0],
        inner_rad: 0.2,
        outer_rad: 0.4,
        range_m: None,
    };
    assert!(
        (irradiance(&room, &light(spot(0.0), 8.0), &[up], PRECISION)[0].direct.mean.y - 2.0).abs() < 1e-5
    );
    assert_eq!(irradiance(&room, &light(spot(0.6), 8.0), &[up], PRECISION)[0].direct.mean.y, 0.0);
}
