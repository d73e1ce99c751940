//! Reads a `.glb` the way any other program would, and checks its triangles.

use std::collections::BTreeMap;

use glam::{Mat4, Vec3};

/// One triangle in world space.
pub struct Triangle {
    pub node: String,
    pub corners_m: [Vec3; 3],
    pub normals: [Vec3; 3],
}

/// Parses and validates a file.
pub fn parse(bytes: &[u8]) -> gltf::Gltf {
    gltf::Gltf::from_slice(bytes).expect("a valid glTF file")
}

/// Every triangle that the file's scene shows.
pub fn triangles(file: &gltf::Gltf) -> Vec<Triangle> {
    let mut found = Vec::new();
    for node in file.default_scene().expect("a default scene").nodes() {
        collect(file, &node, Mat4::IDENTITY, &mut found);
    }
    found
}

fn collect(file: &gltf::Gltf, node: &gltf::Node, world_from_parent: Mat4, found: &mut Vec<Triangle>) {
    let world_from_node = world_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
    for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
        let reader = primitive.reader(|_| file.blob.as_deref());
        let read = |values: Vec<[f32; 3]>| values.into_iter().map(Vec3::from).collect::<Vec<_>>();
        let positions_m = read(reader.read_positions().expect("positions").collect());
        let normals = read(reader.read_normals().expect("normals").collect());
        let indices: Vec<usize> =
            reader.read_indices().expect("indices").into_u32().map(|index| index as usize).collect();
        for corners in indices.chunks_exact(3) {
            let corners = [corners[0], corners[1], corners[2]];
            found.push(Triangle {
                node: node.name().expect("a name").to_owned(),
                corners_m: corners.map(|corner| world_from_node.transform_point3(positions_m[corner])),
                normals: corners.map(|corner| world_from_node.transform_vector3(normals[corner])),
            });
        }
    }
    for child in node.children() {
        collect(file, &child, world_from_node, found);
    }
}

/// Fault of a triangle by itself: no area, normals that are not unit, or a winding that contradicts them.
pub fn fault(triangle: &Triangle) -> Option<&'static str> {
    let [a, b, c] = triangle.corners_m;
    let across = (b - a).cross(c - a);
    if across.length() < 1e-8 {
        return Some("no area");
    }
    if triangle.normals.iter().any(|normal| (normal.length() - 1.0).abs() > 1e-4) {
        return Some("a normal is not unit");
    }
    let facing = across.normalize();
    let agrees = triangle.normals.iter().all(|normal| normal.dot(facing) > 0.0);
    (!agrees).then_some("winding contradicts a normal")
}

/// How many directed edges lack their opposite, corners welded at 10 µm. Zero for a closed surface whose
/// triangles are wound alike.
pub fn open_edges<'a>(triangles: impl Iterator<Item = &'a Triangle>) -> usize {
    let weld = |point: Vec3| (point * 1e5).round().as_i64vec3().to_array();
    let mut balance: BTreeMap<_, i32> = BTreeMap::new();
    for triangle in triangles {
        let corners = triangle.corners_m.map(weld);
        for i in 0..3 {
            let (from, to) = (corners[i], corners[(i + 1) % 3]);
            let (key, step) = if from < to { ((from, to), 1) } else { ((to, from), -1) };
            *balance.entry(key).or_default() += step;
        }
    }
    balance.values().filter(|&&count| count != 0).count()
}
