//! Glass in shadow maps and in pictures.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};
use lightkiln_proto::content::Draw;
use lightkiln_proto::scene::SceneCamera;

use super::light::{scene_of, shadows, sheet};
use crate::lights::Sky;
use crate::passes::shade::reference::{Lit, shade};
use crate::passes::shade::{IndirectIrradiance, ShadeView, Surface};
use crate::passes::shadow::ShadowPlan;
use crate::passes::shadow::reference::ShadowMaps;

/// Materials of the fixture: grey, glass of which a quarter is there, and glass that lets half through and reflects none.
const GREY: u32 = 0;
const QUARTER: u32 = 4;
const HALF: u32 = 5;

/// Bounds of these scenes, in metres.
const BOUNDS_M: [[f32; 3]; 2] = [[-4.0, 0.0, -4.0], [4.0, 4.0, 4.0]];

fn of(material: u32, draw: Draw) -> Draw {
    Draw { material, ..draw }
}

/// A level sheet from x = −3 to 0 at a height, its front above.
fn level(material: u32, height_m: f32) -> Draw {
    of(material, sheet(Vec3::new(-3.0, height_m, -3.0), Vec3::Z * 6.0, Vec3::X * 3.0))
}

fn floor() -> Draw {
    of(GREY, sheet(Vec3::new(-4.0, 0.0, -4.0), Vec3::Z * 8.0, Vec3::X * 8.0))
}

#[test]
fn light_behind_panes_is_the_share_that_passes_them_and_light_on_them_is_whole() {
    for light in ["point pos=0.5,3.5,0.2 power=100", "sun dir=0.1,-1,0.05 irradiance=2"] {
        let lamp = |draws: &[Draw]| shadows(draws, light, BOUNDS_M, (512, None));
        let open = lamp(&[floor()]);
        let one = lamp(&[floor(), level(QUARTER, 1.0)]);
        let two = lamp(&[level(HALF, 1.5), floor(), level(QUARTER, 1.0)]);
        let below_wall = lamp(&[floor(), level(GREY, 1.0), level(HALF, 0.5)]);
        let above_wall = lamp(&[floor(), level(GREY, 1.0), level(HALF, 1.5)]);
        let share = |of: &super::light::Lamp, at: Vec3| of.at(at, Vec3::Y) / open.at(at, Vec3::Y);
        let below = Vec3::new(-1.5, 0.0, 0.3);
        for (of, wanted) in [(&one, 0.75), (&two, 0.375), (&below_wall, 0.0), (&above_wall, 0.0)] {
            let found = share(of, below);
            assert!((found - wanted).abs() < 1e-3, "{light}: {found}, wanted {wanted}");
        }
        let beside = Vec3::new(2.5, 0.0, 0.3);
        assert!((share(&two, beside) - 1.0).abs() < 1e-5, "{light}: beside the panes");
        // On the glass itself, and on the wall below the other pane.
        let on = |height_m: f32| Vec3::new(-1.5, height_m, 0.3);
        assert!((share(&one, on(1.0)) - 1.0).abs() < 1e-3, "{light}: on the pane");
        assert!((share(&two, on(1.5)) - 1.0).abs() < 1e-3, "{light}: on the upper pane");
        assert!((share(&above_wall, on(1.0)) - 0.5).abs() < 1e-3, "{light}: on the wall");
    }
}

/// The same light everywhere, W·m⁻².
struct Even;

impl IndirectIrradiance for Even {
    fn indirect_irradiance(&self, _: &Surface) -> Vec3 {
        Vec3::splat(PI)
    }
}

/// Upright, facing +z.
fn upright(material: u32, z_m: f32) -> Draw {
    of(material, sheet(Vec3::new(-3.0, 0.0, z_m), Vec3::X * 6.0, Vec3::Y * 4.0))
}

/// The middle of a picture of these, seen along −z.
fn middle(draws: &[Draw], sky: Sky) -> Vec4 {
    let scene = scene_of(draws);
    let camera = SceneCamera {
        name: String::new(),
        eye_m: [0.1, 2.0, 3.9],
        target_m: [0.1, 2.0, 0.0],
        up: [0.0, 1.0, 0.0],
        fov_y_rad: 0.6,
        orthographic_half_height_m: None,
    };
    let plan = ShadowPlan::new(&[], BOUNDS_M, 64, None).unwrap();
    let maps = ShadowMaps { side: 64, ..ShadowMaps::default() };
    let lit = Lit {
        scene: &scene,
        plan: &plan,
        maps: &maps,
        indirect: &Even,
        panorama: None,
        emitter_scale: &[],
        fog: None,
        walked: None,
    };
    let view = ShadeView::new(&camera, [32, 24], BOUNDS_M, sky, [0.0; 2]).unwrap();
    shade(lit, &view, [32, 24])[12 * 32 + 16]
}

#[test]
fn pane_shows_its_own_light_by_the_share_that_it_stops_and_what_is_behind_by_the_rest() {
    let (wall, quarter) = (0.7, 0.4);
    // Irradiance π: surfaces have the radiance of their albedo.
    let one = middle(&[upright(QUARTER, 1.0), upright(GREY, -1.0)], Sky::default());
    assert!((one.y - (0.25 * quarter + 0.75 * wall)).abs() < 1e-4 && one.w == 1.0, "{one}");
    // In whatever order the file has them.
    let behind = 0.25 * quarter + 0.75 * wall;
    let [near_half, far_half] = [(2.0, 1.0), (1.0, 2.0)].map(|(half, quarter)| {
        [[0, 1, 2], [2, 1, 0], [1, 2, 0]].map(|order| {
            let draws = [upright(GREY, -1.0), upright(QUARTER, quarter), upright(HALF, half)];
            middle(&order.map(|index: usize| draws[index].clone()), Sky::default()).y
        })
    });
    for (near_half, far_half) in near_half.into_iter().zip(far_half) {
        assert!((near_half - 0.5 * behind).abs() < 1e-4, "{near_half}");
        assert!((far_half - (0.25 * quarter + 0.75 * 0.5 * wall)).abs() < 1e-4, "{far_half}");
    }
    // Hidden by the wall.
    let hidden = middle(&[upright(QUARTER, -2.0), upright(GREY, -1.0)], Sky::default());
    assert!((hidden.y - wall).abs() < 1e-4, "{hidden}");
}

#[test]
fn sky_behind_a_pane_counts_as_surface_by_the_share_that_the_pane_stops() {
    let sky = Sky { zenith: Vec3::splat(2.0), horizon: Vec3::splat(2.0) };
    let seen = middle(&[upright(QUARTER, 0.0)], sky);
    assert!((seen.y - (0.25 * 0.4 + 0.75 * 2.0)).abs() < 1e-4 && (seen.w - 0.25).abs() < 1e-5, "{seen}");
}

/// Glass before and behind other things, for adapter and processor.
pub(super) fn glazed() -> Vec<Draw> {
    let pane =
        |material: u32, corner: Vec3| of(material, sheet(corner, Vec3::new(1.3, 0.0, 0.4), Vec3::Y * 1.2));
    vec![
        pane(QUARTER, Vec3::new(1.2, 0.4, 2.2)),
        pane(HALF, Vec3::new(1.6, 0.6, 1.6)),
        pane(QUARTER, Vec3::new(0.8, 1.0, 1.2)),
    ]
}
