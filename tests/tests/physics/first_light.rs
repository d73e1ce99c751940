//! The overview of a bake: near to all of its light, at few bytes, and dark where no light can come.

use glam::Vec3;
use lightkiln_proto::manifest::{CLUSTERS, OVERVIEW};
use lightkiln_tests::harness::{Lighting, bake, beside_the_whole, first_light};
use lightkiln_tests::scenes;

use super::leaks::is_enclosed;
use super::setup::{luminance, small, tracer, with_texels};

/// A lamp under the ceiling of the Cornell box, and a sky that comes in at its front; its own lamp is off.
#[test]
fn first_light_comes_near_to_all_of_it() {
    let scene = scenes::cornell();
    let bake = bake(scene.clone(), &with_texels("prt", 0.125, 256)).unwrap();
    let [all, overview] = [CLUSTERS, OVERVIEW].map(|role| bake.manifest.bytes_of(role));
    let rays = tracer(&scene);
    let lamp_m = Vec3::new(0.3, 4.0, 0.2);
    let lamp = |position_m: Vec3, normal: Vec3| {
        let to_lamp = lamp_m - position_m;
        let cosine = normal.dot(to_lamp.normalize()).max(0.0);
        let is_lit = cosine > 0.0 && !rays.is_occluded(position_m + normal * 1e-3, lamp_m);
        [if is_lit { 100.0 * cosine / to_lamp.length_squared() } else { 0.0 }; 3]
    };
    let dark = |_: Vec3, _: Vec3| [0.0; 3];
    let under_lamp = Lighting { direct: &lamp, sky: [[0.0; 3]; 2] };
    let under_sky = Lighting { direct: &dark, sky: [[1.0; 3]; 2] };
    for (name, lighting) in [("lamp", under_lamp), ("sky", under_sky)] {
        let [error, energy] = beside_the_whole(&first_light(&bake, &lighting).unwrap());
        println!("{name}: error {error:.3}, energy {energy:.3}; {overview} bytes of {all}");
        assert!(error < 0.25, "{name}: {error}");
        assert!((energy - 1.0).abs() < 0.05, "{name}: {energy}");
    }
    // Small bakes have the larger overviews: patches of eight texels are a large part of them.
    assert!(overview * 8 < all, "{overview} bytes of {all}");
}

/// No receiver stands for one beyond a wall, and none is blended with one.
#[test]
fn sealed_box_is_exactly_dark_inside_at_first_light() {
    let scene = scenes::sealed_box(0.1);
    let bake = bake(scene.clone(), &small("prt", 3000)).unwrap();
    let rays = tracer(&scene);
    let sun = |position_m: Vec3, normal: Vec3| {
        let to_sun = Vec3::new(0.3, 0.8, 0.2).normalize();
        let start_m = position_m + normal * 1e-4;
        let cosine = normal.dot(to_sun).max(0.0);
        [if rays.is_occluded(start_m, start_m + to_sun * 100.0) { 0.0 } else { 1000.0 * cosine }; 3]
    };
    let found = first_light(&bake, &Lighting { direct: &sun, sky: [[100.0; 3]; 2] }).unwrap();
    let (dark, lit): (Vec<_>, Vec<_>) = found.iter().partition(|light| is_enclosed(&rays, &light.whole));
    assert!(dark.len() > 100 && lit.len() > 100, "{} inside, {} outside", dark.len(), lit.len());
    let first = lit.iter().map(|light| luminance(light.first)).sum::<f32>() / lit.len() as f32;
    assert!(first > 1.0, "the outside is dark: the test shows nothing");
    for light in dark {
        assert_eq!(light.first, [0.0; 3], "light inside at {}", light.whole.position_m);
    }
}
