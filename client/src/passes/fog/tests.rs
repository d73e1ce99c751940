use glam::Vec4;

use super::reference::Froxels;
use super::*;
use crate::lights::Sky;
use crate::passes::shadow::ShadowPlan;
use crate::passes::shadow::reference::ShadowMaps;

const BOUNDS_M: [[f32; 3]; 2] = [[0.0; 3], [8.0, 4.0, 8.0]];
const SIZE: [u32; 2] = [40, 30];

fn fog() -> Fog {
    Fog { per_m: 0.3, albedo: 1.0, g: 0.4, height_m: None }
}

fn camera(half_height_m: Option<f32>) -> SceneCamera {
    SceneCamera {
        name: "test".to_owned(),
        eye_m: [1.0, 2.0, 7.5],
        target_m: [4.0, 1.5, 0.0],
        up: [0.0, 1.0, 0.0],
        fov_y_rad: 0.9,
        orthographic_half_height_m: half_height_m,
    }
}

/// Froxels without lights, and the depth in the picture of a point.
fn froxels(
    fog: &Fog,
    camera: &SceneCamera,
    mean_radiance: &(dyn Fn(Vec3) -> Vec3 + Sync),
) -> (Froxels, impl Fn(Vec3) -> ([f32; 2], f32) + use<>) {
    let view = ShadeView::new(camera, SIZE, BOUNDS_M, Sky::default(), [0.0; 2]).unwrap();
    let numbers = FogNumbers::new(fog, camera, &view, SIZE, BOUNDS_M);
    let plan = ShadowPlan::new(&[], BOUNDS_M, 64, None).unwrap();
    let projection = view.projection();
    let seen = move |point: Vec3| {
        let clip = projection * point.extend(1.0);
        let ndc = clip / clip.w;
        let pixel = [0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y];
        ([pixel[0] * SIZE[0] as f32, pixel[1] * SIZE[1] as f32], ndc.z)
    };
    (Froxels::new(numbers, (&plan, &ShadowMaps::default()), mean_radiance), seen)
}

#[test]
fn light_falls_by_distance_and_a_medium_that_absorbs_nothing_keeps_even_light() {
    for half_height_m in [None, Some(3.0)] {
        let camera = camera(half_height_m);
        let absorbing = Fog { albedo: 0.0, ..fog() };
        let (dark, seen) = froxels(&absorbing, &camera, &|_| Vec3::ONE);
        let (even, _) = froxels(&fog(), &camera, &|_| Vec3::ONE);
        let light = Vec4::new(1.0, 1.0, 1.0, 0.25);
        for point in [[1.3, 2.0, 7.0], [2.0, 2.2, 5.0], [4.0, 1.5, 0.1], [3.0, 0.1, 2.0]].map(Vec3::from) {
            let (at, z) = seen(point);
            let eye = Vec3::from(camera.eye_m);
            let distance_m = match half_height_m {
                None => point.distance(eye),
                Some(_) => (point - eye).dot((Vec3::from(camera.target_m) - eye).normalize()),
            };
            let wanted = (-0.3 * distance_m).exp();
            let found = dark.over(light, at, z);
            assert!((found.x / wanted - 1.0).abs() < 0.02, "{point}: {found}, wanted {wanted}");
            assert_eq!(found.w, 0.25);
            let kept = even.over(light, at, z);
            assert!((kept - light).abs().max_element() < 1e-3, "{point}: {kept}");
        }
        // The sky lies behind all of it.
        let sky = dark.over(light, [20.0, 15.0], 0.0);
        assert!(sky.x > 0.0 && sky.x < (-0.3_f32 * 7.0).exp(), "{sky}");
    }
}

#[test]
fn a_medium_that_thins_with_height_stops_less_above() {
    let camera = camera(None);
    let thinning = Fog { height_m: Some(1.0), albedo: 0.0, ..fog() };
    let (found, seen) = froxels(&thinning, &camera, &|_| Vec3::ZERO);
    let through = |point: Vec3| {
        let (at, z) = seen(point);
        found.over(Vec4::ONE, at, z).x
    };
    let [low, high] = [0.1, 3.5].map(|y| through(Vec3::new(3.0, y, 2.0)));
    assert!(high > 1.2 * low, "{low} below, {high} above");
}

#[test]
fn light_behind_what_is_seen_is_not_scattered_before_it() {
    // It looks straight at the wall before the light.
    let camera = SceneCamera { eye_m: [3.0, 1.0, 7.5], target_m: [3.0, 1.0, 0.0], ..camera(None) };
    let behind = |point: Vec3| if point.z < 2.0 { Vec3::splat(1e4) } else { Vec3::ZERO };
    let (found, seen) = froxels(&fog(), &camera, &behind);
    for step in 0..40 {
        let point = Vec3::new(3.0 + 0.002 * step as f32, 1.0, 2.001 + 0.01 * step as f32);
        let (at, z) = seen(point);
        let light = found.over(Vec4::ZERO, at, z);
        assert_eq!(light, Vec4::ZERO, "{point}");
    }
    let (at, z) = seen(Vec3::new(3.3, 1.0, 1.0));
    assert!(found.over(Vec4::ZERO, at, z).x > 10.0);
}

#[test]
fn words_are_read_and_faults_named() {
    let read = Fog::from_text("density=0.05 albedo=0.8 g=0.3 height=2").unwrap();
    assert_eq!(read, Fog { per_m: 0.05, albedo: 0.8, g: 0.3, height_m: Some(2.0) });
    assert_eq!(Fog::from_text(&read.to_string()).unwrap(), read);
    for (text, wanted) in [
        ("", "'density' is missing"),
        ("g=0.3", "'density' is missing"),
        ("thick", "is not name=value"),
        ("density=much", "is no number"),
        ("density=nan", "is no number"),
        ("density=-1", "0 to 1000 per metre"),
        ("density=1,2", "is no number"),
        ("density=1 albedo=2", "0 to 1 are possible"),
        ("density=1 g=1", "-0.95 to 0.95"),
        ("density=1 height=0", "metres are possible"),
        ("density=1 colour=1", "none of density"),
    ] {
        let error = Fog::from_text(text).unwrap_err().to_string();
        assert!(error.contains(wanted), "{text}: {error}");
    }
}

#[test]
fn light_is_turned_as_g_says_and_none_is_lost() {
    for g in [-0.6, 0.0, 0.4, 0.9] {
        let camera = camera(None);
        let view = ShadeView::new(&camera, SIZE, BOUNDS_M, Sky::default(), [0.0; 2]).unwrap();
        let numbers = FogNumbers::new(&Fog { g, ..fog() }, &camera, &view, SIZE, BOUNDS_M);
        let steps = 200_000;
        let cosine = |step: u32| 2.0 * (step as f64 + 0.5) / f64::from(steps) - 1.0;
        let around = 4.0 * std::f64::consts::PI / f64::from(steps);
        let (mut all, mut mean) = (0.0, 0.0);
        for cosine in (0..steps).map(cosine) {
            let share = f64::from(numbers.phase(cosine as f32)) * around;
            (all, mean) = (all + share, mean + share * cosine);
        }
        // The ray looks towards the light where its cosine is 1: light goes on forwards.
        assert!((all - 1.0).abs() < 1e-3 && (mean - f64::from(g)).abs() < 1e-3, "{g}: {all}, {mean}");
    }
}

#[test]
fn light_has_no_step_where_a_slice_ends() {
    let camera = camera(None);
    let lamp = |point: Vec3| Vec3::splat(1.0 / point.distance_squared(Vec3::new(3.4, 1.5, 3.0)).max(0.01));
    let (found, seen) = froxels(&fog(), &camera, &lamp);
    let eye = Vec3::from(camera.eye_m);
    let along = (Vec3::from(camera.target_m) - eye).normalize();
    let at = |step: u32| {
        let (at, z) = seen(eye + along * (0.5 + 0.002 * step as f32));
        found.over(Vec4::ZERO, at, z).x
    };
    let all: Vec<f32> = (0..3500).map(at).collect();
    let most = all.iter().copied().fold(0.0, f32::max);
    let step = all.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f32::max);
    assert!(step < 0.004 * most, "a step of {step} of {most}");
}
