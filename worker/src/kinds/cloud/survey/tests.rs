//! Placements in a room that a sheet with a gap beside it halves: lit on one side, a solid box on the other.

use glam::Vec3;
use lightkiln_proto::kinds::cloud::Settings;
use serde_json::json;

use super::*;
use crate::kinds::field::is_inside;
use crate::scene::model::{Material, MeshInstance, Scene};

/// The sides of a box, their fronts outwards.
fn sides([low, high]: [Vec3; 2]) -> Vec<[Vec3; 4]> {
    let (x, y, z) = (Vec3::X * (high - low).x, Vec3::Y * (high - low).y, Vec3::Z * (high - low).z);
    let side = |corner: Vec3, u: Vec3, v: Vec3| [corner, corner + u, corner + u + v, corner + v];
    vec![
        side(low, x, z),
        side(low + y, z, x),
        side(low, y, x),
        side(low + z, x, y),
        side(low, z, y),
        side(low + x, y, z),
    ]
}

fn add(scene: &mut Scene, sides: &[[Vec3; 4]], emission: f32) {
    for corners in sides {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        scene.instances.push(MeshInstance {
            path: format!("side {}", scene.instances.len()),
            material_index: scene.materials.len() as u32,
            positions_m: corners.to_vec(),
            normals: vec![normal; 4],
            uv0: Vec::new(),
            uv1: Vec::new(),
            colours: Vec::new(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            world_from_object: glam::Mat4::IDENTITY,
            lit_by: None,
        });
    }
    scene.materials.push(Material {
        name: String::new(),
        base_colour: [0.7, 0.7, 0.7, 1.0],
        base_colour_texture: None,
        emissive: [emission; 3],
        emissive_texture: None,
        alpha_cutoff: None,
        glass: None,
        normal_map: None,
        specular: None,
        double_sided: false,
    });
}

fn room(emission: f32) -> Geometry {
    let mut scene = Scene::default();
    let inwards = sides([Vec3::ZERO, Vec3::new(4.0, 2.0, 2.0)]).into_iter().map(|[a, b, c, d]| [a, d, c, b]);
    add(&mut scene, &inwards.collect::<Vec<_>>(), 0.0);
    add(&mut scene, &sides([Vec3::new(1.95, 0.0, 0.0), Vec3::new(2.05, 2.0, 1.5)]), 0.0);
    add(&mut scene, &sides([Vec3::new(2.9, 0.0, 0.3), Vec3::new(3.6, 1.1, 1.0)]), 0.0);
    add(&mut scene, &sides([Vec3::new(0.8, 1.9, 0.8), Vec3::new(1.2, 1.95, 1.2)])[..1], emission);
    Geometry::new(scene).unwrap()
}

fn surveyed(
    geometry: &Geometry,
    (placement, leak_edges): (u32, u32),
    spacing_m: f32,
    progress: &Progress,
) -> Result<Survey, TaskError> {
    let settings = json!({
        "field_placement": placement, "field_leak_edges": leak_edges, "field_spacing_m": spacing_m,
        "field_probes_max": 400
    });
    let settings = Settings::from_json(&settings).unwrap();
    survey(geometry, (&settings.field, &settings.cloud), progress)
}

fn count(survey: &Survey, name: &str) -> u64 {
    survey
        .account
        .iter()
        .find(|(of, _)| of == name)
        .unwrap_or_else(|| panic!("{name}: {:?}", survey.account))
        .1
}

#[test]
fn placements_are_the_same_on_any_number_of_threads_and_of_free_places() {
    let geometry = room(10.0);
    for way in [(0, 0), (0, 1), (1, 0), (2, 0), (3, 1)] {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| surveyed(&geometry, way, 0.5, &Progress::new()).unwrap())
        };
        let found = on(1);
        assert_eq!(found, on(3), "{way:?}");
        assert!(found.probes.len() > 20, "{way:?}: {} probes", found.probes.len());
        assert!(found.probes.windows(2).all(|pair| pair[0].0 < pair[1].0), "{way:?}");
        assert!(!found.tessellation.as_ref().unwrap().tetrahedra.is_empty());
        for at_m in found.positions_m() {
            assert!(!is_inside(&geometry, at_m), "{way:?}: {at_m}");
        }
    }
}

#[test]
fn error_has_about_as_many_probes_as_even_placement_and_others_places() {
    let geometry = room(0.0);
    let [even, error] = [0, 1].map(|way| surveyed(&geometry, (way, 0), 0.4, &Progress::new()).unwrap());
    let ratio = error.probes.len() as f32 / even.probes.len() as f32;
    assert!((0.8..1.25).contains(&ratio), "{} for {}", error.probes.len(), even.probes.len());
    let sizes = [48, 24, 12, 6, 3].map(|size| count(&error, &format!("cells_of_{size}_twelfths")));
    assert!(sizes.iter().filter(|cells| **cells > 0).count() > 2, "{sizes:?}");
}

#[test]
fn light_spawns_merges_and_draws_probes() {
    let geometry = room(10.0);
    let spawned = surveyed(&geometry, (2, 0), 0.5, &Progress::new()).unwrap();
    assert!(count(&spawned, "spawned_1") > 0 && count(&spawned, "merged_2") > 0, "{:?}", spawned.account);
    let moved = surveyed(&geometry, (3, 0), 0.5, &Progress::new()).unwrap();
    assert!(count(&moved, "moved_1") > count(&moved, "moved_32"), "{:?}", moved.account);
    // Probes of the lit half are drawn to its surfaces.
    let beside = |survey: &Survey| {
        let lit: Vec<Vec3> = survey.positions_m().into_iter().filter(|at_m| at_m.x < 1.95).collect();
        let away = |at_m: &Vec3| (*at_m - Vec3::ZERO).min(Vec3::new(1.95, 2.0, 2.0) - *at_m).min_element();
        lit.iter().filter(|at_m| away(at_m) < 0.15).count() as f32 / lit.len() as f32
    };
    let even = surveyed(&geometry, (0, 0), 0.5, &Progress::new()).unwrap();
    assert!(beside(&moved) > 0.5, "{} of probes, evenly {}", beside(&moved), beside(&even));
}

#[test]
fn leak_edges_put_probes_on_both_sides_of_a_wall() {
    let geometry = room(0.0);
    let found = surveyed(&geometry, (0, 1), 0.7, &Progress::new()).unwrap();
    assert!(
        count(&found, "edges_leaking_1") > 0 && count(&found, "leak_probes_1") > 0,
        "{:?}",
        found.account
    );
    let all = found.positions_m();
    let beside = |x: f32| all.iter().filter(|at_m| (at_m.x - x).abs() < 0.06 && at_m.z < 1.5).count();
    assert!(beside(1.91) > 0 && beside(2.09) > 0, "{all:?}");
}

#[test]
fn narrow_space_between_walls_has_probes() {
    let mut scene = Scene::default();
    let inwards = sides([Vec3::ZERO, Vec3::new(4.0, 2.0, 2.0)]).into_iter().map(|[a, b, c, d]| [a, d, c, b]);
    add(&mut scene, &inwards.collect::<Vec<_>>(), 0.0);
    // Narrower than two clearances of even places, 6 cm each.
    add(&mut scene, &sides([Vec3::new(1.85, 0.0, 0.0), Vec3::new(1.95, 2.0, 2.0)]), 0.0);
    add(&mut scene, &sides([Vec3::new(2.05, 0.0, 0.0), Vec3::new(2.15, 2.0, 2.0)]), 0.0);
    let geometry = Geometry::new(scene).unwrap();
    let found = surveyed(&geometry, (0, 0), 0.6, &Progress::new()).unwrap();
    let between: Vec<Vec3> =
        found.positions_m().into_iter().filter(|at_m| (at_m.x - 2.0).abs() < 0.05).collect();
    assert!(between.len() >= 4, "{between:?}");
    assert!(between.iter().all(|at_m| (at_m.x - 2.0).abs() < 0.021), "{between:?}");
}

#[test]
fn scenes_without_light_and_too_many_probes_are_refused() {
    let wrong = |geometry: &Geometry, way: u32, spacing_m: f32| {
        surveyed(geometry, (way, 0), spacing_m, &Progress::new()).unwrap_err().to_string()
    };
    let dark = room(0.0);
    assert!(wrong(&dark, 2, 0.5).contains("has none; add lights"));
    assert!(wrong(&dark, 3, 0.5).contains("has none; add lights"));
    let lit = room(1.0);
    assert!(wrong(&lit, 2, 0.2).contains("field_probes_max is 400"), "{}", wrong(&lit, 2, 0.2));
}

/// Asks for the light around points of the box around a cloud; each thousandth is looked for in all tetrahedra.
fn asked(count: u32) {
    let geometry = room(0.0);
    let found = surveyed(&geometry, (0, 0), 0.3, &Progress::new()).unwrap();
    let probes: Vec<_> = (0..found.probes.len()).map(|index| found.probe(index)).collect();
    let part = FieldPart { spacing_m: found.step_m, probes, ..FieldPart::default() };
    let set = found.tetrahedra().unwrap();
    let table = TetrahedraTable::of(&[part], &set).unwrap();
    let [low_m, high_m] = set.box_m.map(Vec3::from);
    let place = |vertex: u32| table.places_m[vertex as usize].truncate();
    let nearest = |point_m: Vec3| {
        let shares = |vertices: &[u32; 4]| {
            let [first, a, b, c] = vertices.map(place);
            let [a, b, c, to] = [a, b, c, point_m].map(|at| at.as_dvec3() - first.as_dvec3());
            let of = [to.dot(b.cross(c)), to.dot(c.cross(a)), to.dot(a.cross(b))];
            let of = of.map(|part| part / a.dot(b.cross(c)));
            (1.0 - of.iter().sum::<f64>()).min(of[0]).min(of[1]).min(of[2])
        };
        table.vertices.iter().max_by(|a, b| shares(a).total_cmp(&shares(b))).unwrap()
    };
    (0..count).into_par_iter().for_each(|index| {
        let along = |axis: u64| seed_of(&[u64::from(index), axis]) as u32 as f32 / u32::MAX as f32;
        let point_m = low_m + (high_m - low_m) * Vec3::new(along(0), along(1), along(2));
        let around = table.around(point_m);
        let shares: f32 = around.iter().map(|(_, share)| share).sum();
        if shares > 1.0 - 1e-6 {
            // Light that changes evenly is read as it is.
            let read: Vec3 = around.iter().map(|&(probe, share)| place(probe) * share).sum();
            assert!(read.distance(point_m) < 1e-4, "{read} at {point_m}");
        }
        if index % 1000 == 0 {
            let wanted = nearest(point_m);
            let is_of = |(probe, share): &(u32, f32)| wanted.contains(probe) || *share < 1e-4;
            assert!(around.iter().all(is_of), "{around:?} at {point_m}, wanted {wanted:?}");
            let corners = wanted.iter().filter(|vertex| **vertex as usize >= found.probes.len()).count();
            assert!(corners > 0 || (shares - 1.0).abs() < 1e-4, "{around:?} at {point_m}");
        }
    });
}

#[test]
fn points_are_found_in_their_tetrahedra() {
    asked(100_000);
}

#[test]
#[ignore = "takes a minute"]
fn ten_million_points_are_found_in_their_tetrahedra() {
    asked(10_000_000);
}

#[test]
fn cancelled_surveys_stop() {
    let geometry = room(10.0);
    for way in [(0, 1), (1, 0), (2, 0), (3, 0)] {
        for check in [1, 100, 1000] {
            let progress = Progress::cancelled_at(check);
            let found = surveyed(&geometry, way, 0.5, &progress);
            assert!(found.is_err(), "{way:?} ran on after check {check}");
        }
    }
}
