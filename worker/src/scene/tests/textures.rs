//! Sampling in linear light.

use glam::{Vec2, Vec3};

use super::document_builder::png;
use crate::geometry::Geometry;
use crate::scene::model::{Glass, Material, MeshInstance, Scene, SceneImage, TextureUse, Wrap};
use crate::scene::surface::{Footprint, MAX_ALBEDO, surface_at};
use crate::scene::texture::DecodedImages;

const WHITE: [u8; 4] = [255; 4];
const BLACK: [u8; 4] = [0, 0, 0, 255];

fn scene(width: u32, height: u32, pixels: &[[u8; 4]]) -> Scene {
    let texture = TextureUse {
        image_index: 0,
        uv_set: 0,
        uv_transform: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        wrap: [Wrap::Repeat; 2],
    };
    let material = Material {
        name: "m".to_owned(),
        base_colour: [1.0, 1.0, 0.5, 1.0],
        base_colour_texture: Some(texture),
        emissive: [3.0, 0.0, 0.0],
        emissive_texture: None,
        alpha_cutoff: Some(0.5),
        glass: None,
        normal_map: None,
        specular: None,
        double_sided: false,
    };
    let instance = MeshInstance {
        path: "i".to_owned(),
        material_index: 0,
        positions_m: vec![Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 2.0],
        normals: vec![Vec3::Z; 3],
        uv0: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
        uv1: Vec::new(),
        colours: vec![[1.0, 0.5, 1.0, 1.0]; 3],
        triangles: vec![[0, 1, 2]],
        world_from_object: glam::Mat4::IDENTITY,
        lit_by: None,
    };
    let image = SceneImage {
        name: "image".to_owned(),
        media_type: "image/png".to_owned(),
        bytes: png(width, height, pixels),
        size_px: [width, height],
    };
    Scene { instances: vec![instance], materials: vec![material], images: vec![image], ..Scene::default() }
}

fn texture(scene: &Scene) -> TextureUse {
    scene.materials[0].base_colour_texture.clone().unwrap()
}

fn checkers(width: u32, height: u32) -> Vec<[u8; 4]> {
    let pixel = |i: u32| if (i % width + i / width).is_multiple_of(2) { WHITE } else { BLACK };
    (0..width * height).map(pixel).collect()
}

fn assert_near(found: [f32; 4], wanted: [f32; 4], tolerance: f32) {
    let is_near = found.iter().zip(wanted).all(|(a, b)| (a - b).abs() <= tolerance);
    assert!(is_near, "{found:?} is not near {wanted:?}");
}

#[test]
fn texel_centres_give_their_colour_in_linear_light() {
    let scene = scene(2, 1, &[[188, 0, 255, 51], BLACK]);
    let images = DecodedImages::decode(&scene).unwrap();
    let sample = images.sample_bilinear(&texture(&scene), [0.25, 0.5]);
    assert_near(sample, [0.502_886, 0.0, 1.0, 0.2], 1e-5);
}

#[test]
fn blending_of_two_texels_happens_after_decoding() {
    let scene = scene(2, 1, &[WHITE, BLACK]);
    let images = DecodedImages::decode(&scene).unwrap();
    assert_near(images.sample_bilinear(&texture(&scene), [0.5, 0.5]), [0.5, 0.5, 0.5, 1.0], 1e-6);
}

#[test]
fn wrap_modes_differ_beyond_the_edge() {
    let scene = scene(4, 1, &[WHITE, BLACK, BLACK, BLACK]);
    let images = DecodedImages::decode(&scene).unwrap();
    let red_at = |wrap, u| {
        let texture = TextureUse { wrap: [wrap, Wrap::Repeat], ..texture(&scene) };
        images.sample_bilinear(&texture, [u, 0.5])[0]
    };
    assert_eq!(
        [red_at(Wrap::Repeat, 1.125), red_at(Wrap::Clamp, 1.125), red_at(Wrap::Mirror, 1.125)],
        [1.0, 0.0, 0.0]
    );
    assert_eq!(
        [red_at(Wrap::Repeat, -0.125), red_at(Wrap::Clamp, -0.125), red_at(Wrap::Mirror, -0.125)],
        [0.0, 1.0, 1.0]
    );
    assert_eq!(red_at(Wrap::Mirror, 1.875), 1.0);
}

#[test]
fn odd_coordinates_give_finite_colours() {
    let scene = scene(3, 5, &checkers(3, 5));
    let images = DecodedImages::decode(&scene).unwrap();
    for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
        let texture = TextureUse { wrap: [wrap; 2], ..texture(&scene) };
        for bad in [f32::NAN, f32::INFINITY, f32::MAX, -f32::MAX, 1e20] {
            let sample = images.sample_footprint(&texture, [bad, 0.3], [bad, 0.0], [0.0, bad]);
            assert!(sample.iter().all(|channel| (0.0..=1.0).contains(channel)), "{bad} {sample:?}");
        }
    }
}

#[test]
fn footprint_over_the_whole_image_is_its_mean_also_for_odd_sizes() {
    for (width, height) in [(64, 64), (5, 3), (7, 1), (1, 9), (33, 17)] {
        let pixels = checkers(width, height);
        let white_share = pixels.iter().filter(|pixel| **pixel == WHITE).count() as f32 / pixels.len() as f32;
        let scene = scene(width, height, &pixels);
        let images = DecodedImages::decode(&scene).unwrap();
        let mean = images.sample_footprint(&texture(&scene), [0.5, 0.5], [1.0, 0.0], [0.0, 1.0]);
        assert_near(mean, [white_share, white_share, white_share, 1.0], 0.03);
    }
}

#[test]
fn footprint_over_one_half_sees_little_of_the_other() {
    let pixels: Vec<[u8; 4]> = (0..64 * 64).map(|i| if i % 64 < 32 { WHITE } else { BLACK }).collect();
    let scene = scene(64, 64, &pixels);
    let images = DecodedImages::decode(&scene).unwrap();
    let mean_at = |u| images.sample_footprint(&texture(&scene), [u, 0.5], [0.25, 0.0], [0.0, 0.25])[0];
    assert!(mean_at(0.25) > 0.999 && mean_at(0.75) < 0.001);
    assert!((mean_at(0.5) - 0.5).abs() < 1e-3);
}

#[test]
fn long_thin_footprint_does_not_blur_across() {
    let pixels: Vec<[u8; 4]> =
        (0..64 * 64).map(|i| if (i / 64) / 8 % 2 == 0 { WHITE } else { BLACK }).collect();
    let scene = scene(64, 64, &pixels);
    let images = DecodedImages::decode(&scene).unwrap();
    let mean_at = |v| images.sample_footprint(&texture(&scene), [0.5, v], [1.0, 0.0], [0.0, 1.0 / 64.0])[0];
    assert!(mean_at(4.0 / 64.0) > 0.99 && mean_at(12.0 / 64.0) < 0.01);
}

#[test]
fn surface_multiplies_factor_texture_and_vertex_colour_and_caps_albedo() {
    let mut scene = scene(1, 1, &[[255, 255, 255, 128]]);
    scene.materials[0].alpha_cutoff = None;
    scene.materials[0].glass = Some(Glass { blends: true, transmission: 0.0, transmission_texture: None });
    let images = DecodedImages::decode(&scene).unwrap();
    for footprint in [Footprint::POINT, Footprint::square(&scene.instances[0], 0, 0.5)] {
        let sample = surface_at(&scene, &images, 0, 0, [1.0 / 3.0; 3], &footprint);
        assert_eq!(sample.albedo[0], MAX_ALBEDO);
        assert!((sample.albedo[1] - 0.5).abs() < 1e-6 && (sample.albedo[2] - 0.5).abs() < 1e-6);
        assert_eq!(sample.emission, [3.0, 0.0, 0.0]);
        assert!((sample.stopped - 128.0 / 255.0).abs() < 1e-6);
    }
}

#[test]
fn holes_of_masks_stop_nothing_and_what_is_left_everything() {
    for (alpha, stopped) in [(127, 0.0), (128, 1.0)] {
        let scene = scene(1, 1, &[[255, 255, 255, alpha]]);
        let images = DecodedImages::decode(&scene).unwrap();
        let found = surface_at(&scene, &images, 0, 0, [1.0, 0.0, 0.0], &Footprint::POINT);
        assert_eq!(found.stopped, stopped, "{alpha}");
    }
}

#[test]
fn transmission_takes_light_from_what_is_reflected_by_its_texture_and_lets_it_pass_tinted() {
    let mut scene = scene(1, 1, &[[255, 255, 255, 51]]);
    let texture = scene.materials[0].base_colour_texture.take();
    scene.instances[0].colours.clear();
    let material = &mut scene.materials[0];
    (material.alpha_cutoff, material.base_colour) = (None, [0.5, 0.5, 0.5, 0.3]);
    material.glass = Some(Glass { blends: false, transmission: 0.5, transmission_texture: texture });
    let images = DecodedImages::decode(&scene).unwrap();
    let found = surface_at(&scene, &images, 0, 0, [1.0, 0.0, 0.0], &Footprint::POINT);
    // A tenth is transmitted, half of it lost to the tint: 0.05 pass, 0.9 · 0.5 are reflected.
    assert!((found.stopped - 0.95).abs() < 1e-6, "{found:?}");
    assert!((found.stopped * found.albedo[0] - 0.45).abs() < 1e-6, "{found:?}");
    // Rays are stopped as much.
    let geometry = Geometry::new(scene).unwrap();
    let (above, below) = (Vec3::new(0.2, 0.2, 1.0), Vec3::new(0.2, 0.2, -1.0));
    assert!((geometry.tracer.passed(above, below) - 0.05).abs() < 1e-6);
}

#[test]
fn opaque_materials_have_full_coverage_whatever_the_texture_says() {
    let mut scene = scene(1, 1, &[[255, 255, 255, 0]]);
    scene.materials[0].alpha_cutoff = None;
    let images = DecodedImages::decode(&scene).unwrap();
    assert_eq!(surface_at(&scene, &images, 0, 0, [1.0, 0.0, 0.0], &Footprint::POINT).stopped, 1.0);
}

#[test]
fn square_footprint_has_the_stated_size_in_the_plane() {
    let scene = scene(1, 1, &[WHITE]);
    let instance = &scene.instances[0];
    let footprint = Footprint::square(instance, 0, 0.25);
    let [along, across] = footprint.sides.map(|side| -> Vec3 {
        instance.positions_m.iter().zip(side).map(|(position, weight)| *position * weight).sum()
    });
    assert!((along.length() - 0.25).abs() < 1e-6 && (across.length() - 0.25).abs() < 1e-6);
    assert!(along.dot(across).abs() < 1e-6);
}
