//! Object space to world space: positions, normals, winding, and the triangles that vanish on the way.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::Opening;
use super::error::{ImportError, Result};
use super::primitives::LocalMesh;
use super::warnings::Warnings;

/// A triangle whose doubled area is below this share of its longest edge squared has no area: positions are f32, so
/// a smaller height is rounding.
const MIN_RELATIVE_AREA: f64 = 1e-8;

/// Distance of a squared normal length from 1 from which on it deserves a warning; 8-bit normals stay within it.
const UNIT_TOLERANCE: f32 = 0.05;

/// Fate of a primitive under a node.
pub(super) struct Placed {
    /// The mesh in world space, with unit normals.
    pub(super) mesh: LocalMesh,
    /// Triangles dropped because they have no area.
    pub(super) degenerate_count: u64,
}

/// Puts a mesh into the world: transforms it, keeps triangles counter-clockwise from their front under mirroring,
/// drops triangles without area unless the mesh is to move, and gives every vertex a unit normal.
///
/// Errors on positions that leave f32's range.
pub(super) fn place_in_world(
    mut mesh: LocalMesh,
    world_from_object: DAffine3,
    opening: Opening,
    warnings: &mut Warnings,
    place: &dyn Fn() -> String,
) -> Result<Placed> {
    for (vertex, position) in mesh.positions.iter_mut().enumerate() {
        *position = world_from_object.transform_point3(position.as_dvec3()).as_vec3();
        if !position.is_finite() {
            return Err(ImportError::NonFinitePosition { place: place(), vertex });
        }
    }
    if world_from_object.matrix3.determinant() < 0.0 {
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }
    let triangle_count = mesh.triangles.len();
    let positions = &mesh.positions;
    if opening == Opening::Still {
        mesh.triangles.retain(|triangle| face_normal(positions, triangle).is_some());
    }
    let degenerate_count = (triangle_count - mesh.triangles.len()) as u64;
    warnings.add_many("degenerate-triangles-dropped", degenerate_count, || {
        format!("{} has triangles without area", place())
    });
    match mesh.normals.take() {
        Some(normals) => set_normals(&mut mesh, normals, world_from_object.matrix3, warnings, place),
        None => split_flat(&mut mesh),
    }
    Ok(Placed { mesh, degenerate_count })
}

/// Unit normal of a triangle and twice its area, or `None` if it has no area.
fn face_normal(positions: &[Vec3], triangle: &[u32; 3]) -> Option<(DVec3, f64)> {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
    let (ab, ac) = (b - a, c - a);
    let cross = ab.cross(ac);
    let longest_squared = ab.length_squared().max(ac.length_squared()).max((c - b).length_squared());
    let doubled_area = cross.length();
    (doubled_area > MIN_RELATIVE_AREA * longest_squared).then(|| (cross / doubled_area, doubled_area))
}

/// Gives each triangle its own three vertices with its face normal.
fn split_flat(mesh: &mut LocalMesh) {
    let corners: Vec<usize> = mesh.triangles.iter().flatten().map(|&vertex| vertex as usize).collect();
    let face =
        |triangle| face_normal(&mesh.positions, triangle).map_or(Vec3::Y, |(normal, _)| normal.as_vec3());
    mesh.normals = Some(mesh.triangles.iter().flat_map(|triangle| [face(triangle); 3]).collect());
    mesh.positions = gather(&mesh.positions, &corners);
    mesh.uv0 = gather(&mesh.uv0, &corners);
    mesh.uv1 = gather(&mesh.uv1, &corners);
    mesh.colours = gather(&mesh.colours, &corners);
    mesh.triangles = (0..mesh.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
}

fn gather<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
    if values.is_empty() { Vec::new() } else { indices.iter().map(|&index| values[index]).collect() }
}

/// Transforms stated normals by the inverse transpose, makes them unit, and replaces those that are none.
fn set_normals(
    mesh: &mut LocalMesh,
    mut normals: Vec<Vec3>,
    object_to_world: DMat3,
    warnings: &mut Warnings,
    place: &dyn Fn() -> String,
) {
    let normal_matrix = normal_matrix(object_to_world);
    let (mut scaled_count, mut bad) = (0, Vec::new());
    for (vertex, normal) in normals.iter_mut().enumerate() {
        scaled_count += u64::from((normal.length_squared() - 1.0).abs() > UNIT_TOLERANCE);
        match (normal_matrix * normal.as_dvec3()).try_normalize() {
            Some(unit) => *normal = unit.as_vec3(),
            None => bad.push(vertex),
        }
    }
    warnings.add_many("normals-not-unit", scaled_count, || {
        format!("{} has normals of other length than 1, which were scaled", place())
    });
    let mut replaced_count = 0;
    if !bad.is_empty() {
        let from_faces = normals_from_faces(mesh);
        for vertex in bad {
            replaced_count += u64::from(from_faces[vertex].is_some());
            normals[vertex] = from_faces[vertex].unwrap_or(Vec3::Y);
        }
    }
    warnings.add_many("normals-replaced", replaced_count, || {
        format!("{} has zero or infinite normals, which were taken from its triangles", place())
    });
    mesh.normals = Some(normals);
}

/// The inverse transpose up to a positive factor: the cofactors, which exist also when a node is scaled flat.
pub(super) fn normal_matrix(m: DMat3) -> DMat3 {
    let cofactors =
        DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { -cofactors } else { cofactors }
}

/// Per vertex, the mean of its triangles' normals weighted by area, or the first one where they cancel; `None` for
/// vertices without triangles.
fn normals_from_faces(mesh: &LocalMesh) -> Vec<Option<Vec3>> {
    let mut sums = vec![DVec3::ZERO; mesh.positions.len()];
    let mut firsts = vec![None; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let Some((normal, doubled_area)) = face_normal(&mesh.positions, triangle) else { continue };
        for &vertex in triangle {
            sums[vertex as usize] += normal * doubled_area;
            firsts[vertex as usize].get_or_insert(normal);
        }
    }
    let choose = |(sum, first): (DVec3, Option<DVec3>)| sum.try_normalize().or(first).map(|n| n.as_vec3());
    sums.into_iter().zip(firsts).map(choose).collect()
}
