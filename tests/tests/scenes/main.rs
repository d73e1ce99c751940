//! The stored test scenes are what their generators say, and sound geometry; hostile input does no harm.

mod hostile;
mod reader;

use std::collections::BTreeSet;
use std::path::Path;

use glam::{Vec2, Vec3};
use lightkiln_tests::scenes::{self, mesh::Mesh, shapes};

use reader::{Triangle, fault, open_edges, parse, triangles};

/// Most triangles a scene may have.
const TRIANGLE_BUDGETS: [(&str, usize); 11] = [
    ("atrium", 70_000),
    ("cornell", 100),
    ("cornell_glossy", 100),
    ("cornell_large", 200),
    ("furnace", 12),
    ("open_hall", 20_000),
    ("panes", 100),
    ("sealed_box", 100),
    ("two_rooms", 100),
    ("two_rooms_sheet", 100),
    ("u_corridor", 100),
];

/// Largest file kept in the repository, in bytes.
const FILE_LIMIT_BYTES: usize = 5_000_000;

#[test]
fn stored_scenes_equal_their_generators() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let mut compared = BTreeSet::new();
    for (name, generated) in scenes::all() {
        let path = folder.join(name).with_extension("glb");
        let stored = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        // Not assert_eq: a diff of megabytes helps nobody.
        assert!(stored == generated, "{name}: run `cargo run -p lightkiln-tests --bin generate-scenes`");
        assert!(stored.len() < FILE_LIMIT_BYTES, "{name} has {} bytes", stored.len());
        compared.insert(path);
    }
    let files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    for path in files.iter().filter(|path| path.extension().is_some_and(|e| e == "glb")) {
        assert!(compared.contains(path), "{} has no generator", path.display());
    }
    assert_eq!(compared.len(), TRIANGLE_BUDGETS.len());
}

#[test]
fn every_scene_has_a_camera_and_something_that_shines() {
    for (name, bytes) in scenes::all() {
        let file = parse(&bytes);
        assert!(file.cameras().count() > 0, "{name} has no camera");
        let lamps = file.lights().map_or(0, Iterator::count);
        let emitters = file.materials().filter(|m| m.emissive_factor() != [0.0; 3]).count();
        assert!(lamps + emitters > 0, "{name} is dark");
    }
}

#[test]
fn node_names_are_unique() {
    for (name, bytes) in scenes::all() {
        let mut seen = BTreeSet::new();
        for node in parse(&bytes).nodes() {
            let node = node.name().expect("a name").to_owned();
            assert!(seen.insert(node.clone()), "{name}: two nodes are called {node}");
        }
        assert!(!seen.is_empty());
    }
}

#[test]
fn triangles_have_area_and_unit_normals_that_agree_with_their_winding() {
    for (name, bytes) in scenes::all() {
        let triangles = triangles(&parse(&bytes));
        assert!(!triangles.is_empty());
        for triangle in &triangles {
            if let Some(fault) = fault(triangle) {
                panic!("{name}, {}: {fault} at {:?}", triangle.node, triangle.corners_m);
            }
        }
    }
}

#[test]
fn triangle_counts_stay_within_budget() {
    for (name, bytes) in scenes::all() {
        let (_, budget) = TRIANGLE_BUDGETS.iter().find(|(budgeted, _)| *budgeted == name).expect("a budget");
        let count = triangles(&parse(&bytes)).len();
        assert!(count <= *budget, "{name} has {count} triangles, its budget is {budget}");
    }
}

#[test]
fn closed_surfaces_have_no_open_edge() {
    let closed = |name: &str, bytes: &[u8], nodes: &[&str]| {
        let triangles = triangles(&parse(bytes));
        let chosen: Vec<_> = triangles.iter().filter(|t| nodes.iter().any(|n| t.node.ends_with(n))).collect();
        assert!(!chosen.is_empty(), "{name}: no node ends in {nodes:?}");
        assert_eq!(open_edges(chosen.into_iter()), 0, "{name}: {nodes:?} leaks");
    };
    closed("furnace", &scenes::furnace(0.5, 1.0, 4.0), &["furnace"]);
    for thickness_m in [0.02, 0.1, 0.5] {
        closed("sealed_box", &scenes::sealed_box(thickness_m), &["shell"]);
        closed("two_rooms", &scenes::two_rooms(thickness_m), &["partition"]);
        closed("two_rooms", &scenes::two_rooms(thickness_m), &["wall", "floor", "ceiling"]);
    }
    closed("two_rooms_sheet", &scenes::two_rooms(0.0), &["wall", "floor", "ceiling"]);
    closed("u_corridor", &scenes::u_corridor(), &["wall", "floor", "ceiling"]);
}

#[test]
fn checks_of_triangles_find_what_they_look_for() {
    let good = of(&shapes::cuboid(Vec3::ZERO, Vec3::ONE, &[]));
    assert_eq!(open_edges(good.iter()), 0);
    assert!(good.iter().all(|triangle| fault(triangle).is_none()));

    let open = of(&shapes::cuboid(Vec3::ZERO, Vec3::ONE, &[shapes::Side::Top]));
    assert_eq!(open_edges(open.iter()), 4);

    let mut inside_out = shapes::cuboid(Vec3::ZERO, Vec3::ONE, &[]);
    inside_out.triangles[0].swap(0, 1);
    assert_eq!(fault(&of(&inside_out)[0]), Some("winding contradicts a normal"));
    assert!(open_edges(of(&inside_out).iter()) > 0);

    let mut long_normal = shapes::cuboid(Vec3::ZERO, Vec3::ONE, &[]);
    long_normal.normals[0] *= 2.0;
    assert_eq!(fault(&of(&long_normal)[0]), Some("a normal is not unit"));

    let mut line = Mesh::default();
    let corners = [0.0, 1.0, 2.0].map(|x| line.vertex(Vec3::X * x, Vec3::Y, Vec2::ZERO));
    line.triangles.push(corners);
    assert_eq!(fault(&of(&line)[0]), Some("no area"));
}

fn of(mesh: &Mesh) -> Vec<Triangle> {
    let triangle = |corners: &[u32; 3]| Triangle {
        node: String::new(),
        corners_m: corners.map(|corner| mesh.positions_m[corner as usize]),
        normals: corners.map(|corner| mesh.normals[corner as usize]),
    };
    mesh.triangles.iter().map(triangle).collect()
}
