//! Normal maps held against geometry: panels that lie flat under a map that says a slope, beside the path tracer's light on panels that
//! really lean so.

use std::f32::consts::PI;

use glam::{Quat, Vec3};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::preview::{Backend, SurfaceDetails, View, render};
use lightkiln_proto::kinds::{captured, cloud, grid};
use lightkiln_proto::scene::SceneCamera;
use lightkiln_tests::harness::{Recipe, bake};
use lightkiln_tests::scenes::glb::{Glb, Surface};
use lightkiln_tests::scenes::mesh::Mesh;
use lightkiln_tests::scenes::texture::slope;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::reference::{Lighting, Precision, Reference};
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::Progress;
use serde_json::json;

use super::setup::luminance;

/// Angle of the slopes.
const SLOPE_RAD: f32 = 0.349;
/// Sides of a panel.
const SIDE_M: f32 = 0.4;
const ALBEDO: f32 = 0.6;

/// Middles of panels, and the ways in which they lean.
fn panels() -> [(Vec3, Vec3); 4] {
    [
        (Vec3::new(-1.1, 0.7, -1.0), Vec3::X),
        (Vec3::new(1.1, 0.7, -1.0), Vec3::NEG_Z),
        (Vec3::new(-1.1, 0.7, 1.0), Vec3::Z),
        (Vec3::new(1.1, 0.7, 1.0), Vec3::NEG_X),
    ]
}

/// A normal that leans from straight up.
fn leaning(way: Vec3) -> Vec3 {
    Vec3::Y * SLOPE_RAD.cos() + way * SLOPE_RAD.sin()
}

/// A room of 4 × 3 × 4 m, a red and a green wall, a lamp at the ceiling, and four panels that lean, or lie under maps that say so.
fn room(lean: bool) -> Vec<u8> {
    let mut glb = Glb::new("slopes");
    let [grey, red, green] = [("grey", [0.7; 3]), ("red", [0.6, 0.05, 0.05]), ("green", [0.1, 0.5, 0.1])]
        .map(|(name, albedo)| glb.material(Surface::diffuse(name, albedo)));
    let (low, high) = (Vec3::new(-2.0, 0.0, -2.0), Vec3::new(2.0, 3.0, 2.0));
    let [x, y, z] = [Vec3::X * 4.0, Vec3::Y * 3.0, Vec3::Z * 4.0];
    let walls = [
        ("floor", low, z, x, grey),
        ("ceiling", high, -x, -z, grey),
        ("left", low, y, z, red),
        ("right", high, -z, -y, green),
        ("back", low, x, y, grey),
        ("front", high, -y, -x, grey),
    ];
    for (name, corner, u, v, material) in walls {
        let mut mesh = Mesh::default();
        mesh.rectangle(corner, u, v);
        glb.object(name, &mesh, material);
    }
    let lamp = glb.material(Surface::diffuse("lamp", [0.0; 3]).emitting([8.0; 3]));
    let mut mesh = Mesh::default();
    mesh.rectangle(Vec3::new(0.5, 2.98, 0.9), Vec3::X * -0.7, Vec3::Z * -0.7);
    glb.object("lamp", &mesh, lamp);
    for (index, (middle, way)) in panels().into_iter().enumerate() {
        let name = format!("panel {index}");
        let mut surface = Surface::diffuse(&name, [ALBEDO; 3]).double_sided();
        let mut turn = Quat::IDENTITY;
        if lean {
            turn = Quat::from_rotation_arc(Vec3::Y, leaning(way));
        } else {
            let normal = leaning(way);
            let map = glb.texture(&name, &slope(Vec3::new(normal.x, -normal.z, normal.y)));
            surface = surface.bent(map);
        }
        let material = glb.material(surface);
        let (u, v) = (turn * Vec3::X * SIDE_M, turn * Vec3::NEG_Z * SIDE_M);
        let mut mesh = Mesh::default();
        mesh.rectangle(middle - 0.5 * (u + v), u, v);
        glb.object(&name, &mesh, material);
    }
    glb.finish()
}

/// Irradiance of the leaning panels' middles by the path tracer, luminance in W·m⁻².
fn traced() -> Vec<f64> {
    let limits = Limits::default();
    let scene = import(&Bundle::from_bytes(room(true), &limits).unwrap(), &limits).unwrap().scene;
    let geometry = Geometry::new(scene).unwrap();
    let reference =
        Reference::new(&geometry, &Lighting { emitter_scale: 1.0, ..Lighting::default() }).unwrap();
    let site = |(position_m, way): (Vec3, Vec3)| {
        let normal = leaning(way);
        Site { position_m, normal, face_normal: normal }
    };
    let precision = Precision { rel_error: 0.01, paths_max: 1 << 15 };
    let found = reference.irradiance(&panels().map(site), &precision, &Progress::new()).unwrap();
    found.iter().map(|of| of.indirect.luminance()).collect()
}

/// Irradiance at the middles of the flat panels as pictures show it, with and without their maps.
fn shown(kind: &'static str, folder: &std::path::Path) -> [Vec<f64>; 2] {
    let settings = json!({ "preset": "draft", "field_spacing_m": 0.5, "probe_rays": 1024 });
    let mut recipe = Recipe { kind, settings };
    if kind != captured::NAME {
        recipe = recipe.with("texel_m", 0.1).with("transport_rays", 512).with("emitter_rays", 64);
    }
    bake(room(false), &recipe).unwrap().write(folder).unwrap();
    let bake = LoadedBake::load(&Source::bundle(folder).unwrap(), &lightkiln_client::kinds::all()).unwrap();
    let at = |middle: Vec3, details| {
        let camera = SceneCamera {
            name: "down".to_owned(),
            eye_m: (middle + Vec3::Y).into(),
            target_m: middle.into(),
            up: [0.0, 0.0, -1.0],
            fov_y_rad: 0.5,
            orthographic_half_height_m: Some(0.25 * SIDE_M),
        };
        let mut view = View { width: 8, height: 8, samples: 1, details, ..View::new(camera, Vec::new()) };
        view.emitter_scale = vec![1.0];
        let linear = render(&bake, &view, Backend::Cpu).unwrap().linear;
        let mean = linear.iter().map(|radiance| luminance(*radiance)).sum::<f32>() / linear.len() as f32;
        f64::from(mean * PI / ALBEDO)
    };
    [SurfaceDetails::default(), SurfaceDetails::NONE]
        .map(|details| panels().into_iter().map(|(middle, _)| at(middle, details)).collect())
}

#[test]
fn map_that_says_a_slope_has_the_light_of_one() {
    let wanted = traced();
    for (kind, most) in [(grid::NAME, 0.06), (cloud::NAME, 0.06), (captured::NAME, 0.12)] {
        let folder = tempfile::tempdir().unwrap();
        let [mapped, plain] = shown(kind, folder.path());
        let error = |found: &[f64]| {
            let apart = found.iter().zip(&wanted).map(|(found, wanted)| (found / wanted - 1.0).abs());
            apart.sum::<f64>() / wanted.len() as f64
        };
        let [with, without] = [&mapped, &plain].map(|found| error(found));
        println!(
            "{kind}: error {with:.3} with maps, {without:.3} without; {mapped:.3?} {plain:.3?}, traced {wanted:.3?}"
        );
        assert!(with < most && with < 0.6 * without, "{kind}: {with} with maps, {without} without");
    }
}
