//! Closed things that are turned inside out: their single-sided faces look in, and from outside they are black.
//!
//! A room is built so, too. So a mesh is told only where nobody can be in it: it is closed, nothing of the scene lies in
//! it, and the file has a camera or a lamp, all of which are elsewhere.

use std::cell::OnceCell;
use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use lightkiln_proto::scene::LightKind;

use super::model::{MeshInstance, Scene, Warning};

/// Largest mesh that is looked at, in triangles: larger ones are terrains, scans and whole buildings.
const TRIANGLES_MAX: usize = 200_000;
/// Most pairs of a point and a triangle that are looked at for one mesh; where more would be, nothing is said.
const PAIRS_MAX: usize = 20_000_000;

/// A warning of all meshes that are turned inside out.
pub(super) fn inside_out(scene: &Scene) -> Option<Warning> {
    let people_m = places_of_people(scene);
    if people_m.is_empty() && !scene.instances.iter().any(|instance| emits(scene, instance)) {
        return None;
    }
    let vertices = OnceCell::new();
    let others = |index: usize, bounds_m: [Vec3; 2]| {
        vertices.get_or_init(|| Vertices::of(scene)).within(index, bounds_m)
    };
    let is_found = |(index, instance): &(usize, &MeshInstance)| {
        let material = &scene.materials[instance.material_index as usize];
        !material.double_sided
            && !emits(scene, instance)
            && is_inside_out(instance, &people_m, |bounds_m| others(*index, bounds_m))
    };
    let found: Vec<&str> =
        scene.instances.iter().enumerate().filter(is_found).map(|(_, instance)| &*instance.path).collect();
    let (first, more) = found.split_first()?;
    let (meshes, they, them) = match more.len() {
        0 => (format!("closed mesh '{first}' is"), "it is", "it"),
        more => (format!("{} closed meshes, '{first}' first, are", more + 1), "they are", "them"),
    };
    Some(Warning {
        code: "inside-out".into(),
        message: format!(
            "{meshes} turned inside out: no camera, lamp or other mesh is in {them}, and from outside {they} black; flip the \
             faces, or make the material double-sided"
        ),
    })
}

/// Cameras and lamps of the file that have a place.
fn places_of_people(scene: &Scene) -> Vec<Vec3> {
    let eyes = scene.cameras.iter().map(|camera| Vec3::from(camera.eye_m));
    let lamps = scene.lights.iter().filter_map(|light| match light.kind {
        LightKind::Point { position_m, .. }
        | LightKind::Spot { position_m, .. }
        | LightKind::Rect { position_m, .. } => Some(Vec3::from(position_m)),
        LightKind::Sun { .. } | LightKind::Sky { .. } => None,
    });
    eyes.chain(lamps).collect()
}

fn emits(scene: &Scene, instance: &MeshInstance) -> bool {
    scene.materials[instance.material_index as usize].emissive != [0.0; 3]
}

/// Whether all shells of a mesh are closed and look in, and neither each other, other meshes nor people are in them.
fn is_inside_out(
    instance: &MeshInstance,
    people_m: &[Vec3],
    others_within: impl Fn([Vec3; 2]) -> Vec<Vec3>,
) -> bool {
    if instance.triangles.len() > TRIANGLES_MAX || volume_m3(instance, instance.triangles.iter()) >= 0.0 {
        return false;
    }
    let Some(shells) = closed_shells(instance) else { return false };
    if shells.iter().any(|shell| volume_m3(instance, shell.iter()) >= 0.0) {
        return false;
    }
    let bounds =
        |shell: &Vec<[u32; 3]>| bounds_m(shell.iter().flatten().map(|&v| instance.positions_m[v as usize]));
    let all: Vec<[Vec3; 2]> = shells.iter().map(bounds).collect();
    let is_nested =
        |a: usize, b: usize| a != b && is_within(all[a][0], all[b]) && is_within(all[a][1], all[b]);
    if (0..all.len()).any(|a| (0..all.len()).any(|b| is_nested(a, b))) {
        return false;
    }
    let whole = bounds_m(instance.positions_m.iter().copied());
    let mut near: Vec<Vec3> = people_m.iter().copied().filter(|&point| is_within(point, whole)).collect();
    near.extend(others_within(whole));
    near.len().saturating_mul(instance.triangles.len()) <= PAIRS_MAX
        && !near.iter().any(|&point_m| is_inside(instance, point_m))
}

/// Vertices of a scene in order along the axis that they are spread over the widest: those in a mesh are found without a look at
/// all others, of which a scene may have as many as meshes.
struct Vertices {
    axis: usize,
    /// Place along the axis, instance, place.
    sorted: Vec<(f32, usize, Vec3)>,
}

impl Vertices {
    fn of(scene: &Scene) -> Self {
        let all = || {
            let instances = scene.instances.iter().enumerate();
            instances
                .flat_map(|(index, instance)| instance.positions_m.iter().map(move |at_m| (index, *at_m)))
        };
        let [low, high] = bounds_m(all().map(|(_, at_m)| at_m));
        let axis = (high - low).max_position();
        let mut sorted: Vec<_> = all().map(|(index, at_m)| (at_m[axis], index, at_m)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { axis, sorted }
    }

    /// Those of all instances but one in some bounds.
    fn within(&self, but: usize, bounds_m: [Vec3; 2]) -> Vec<Vec3> {
        let [low, high] = bounds_m.map(|corner| corner[self.axis]);
        let first = self.sorted.partition_point(|(at, ..)| *at < low);
        let slab = self.sorted[first..].iter().take_while(|(at, ..)| *at <= high);
        let others = slab.filter(|(_, index, at_m)| *index != but && is_within(*at_m, bounds_m));
        others.map(|(.., at_m)| *at_m).collect()
    }
}

fn bounds_m(points: impl Iterator<Item = Vec3>) -> [Vec3; 2] {
    points.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], point| [low.min(point), high.max(point)])
}

fn is_within(point: Vec3, [low, high]: [Vec3; 2]) -> bool {
    point.cmpge(low).all() && point.cmple(high).all()
}

/// Signed volume Σ a·(b × c)/6: above 0 where faces look out.
fn volume_m3<'a>(instance: &MeshInstance, triangles: impl Iterator<Item = &'a [u32; 3]>) -> f64 {
    // About one of its own points, as far from the origin digits would be lost.
    let origin = instance.positions_m.first().map_or(DVec3::ZERO, |point| point.as_dvec3());
    let corner = |v: u32| instance.positions_m[v as usize].as_dvec3() - origin;
    triangles.map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
}

/// Whether closed shells wind about a point: the sum of their solid angles is ±4π inside and 0 outside.
fn is_inside(instance: &MeshInstance, point_m: Vec3) -> bool {
    let corner = |v: u32| (instance.positions_m[v as usize] - point_m).as_dvec3();
    let angle = |&[a, b, c]: &[u32; 3]| {
        let [a, b, c] = [a, b, c].map(corner);
        let [x, y, z] = [a.length(), b.length(), c.length()];
        let below = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
        2.0 * libm::atan2(a.dot(b.cross(c)), below)
    };
    let whole: f64 = instance.triangles.iter().map(angle).sum();
    whole.abs() > 2.0 * std::f64::consts::PI
}

/// The triangles of each connected part, if all are closed: every edge is run along once each way.
fn closed_shells(instance: &MeshInstance) -> Option<Vec<Vec<[u32; 3]>>> {
    let corners = welded(instance);
    let mut edges: Vec<[u32; 2]> = Vec::with_capacity(3 * instance.triangles.len());
    for triangle in &instance.triangles {
        let [a, b, c] = triangle.map(|v| corners[v as usize]);
        edges.extend([[a, b], [b, c], [c, a]]);
    }
    edges.sort_unstable();
    let is_once = edges.windows(2).all(|pair| pair[0] != pair[1]);
    let has_way_back = |[from, to]: &[u32; 2]| from != to && edges.binary_search(&[*to, *from]).is_ok();
    if !is_once || !edges.iter().all(has_way_back) {
        return None;
    }
    let mut root: Vec<u32> = (0..corners.len() as u32).collect();
    for [a, b] in edges {
        let (a, b) = (root_of(&mut root, a), root_of(&mut root, b));
        root[a.max(b) as usize] = a.min(b);
    }
    let mut shells: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for triangle in &instance.triangles {
        shells.entry(root_of(&mut root, corners[triangle[0] as usize])).or_default().push(*triangle);
    }
    Some(shells.into_values().collect())
}

/// The first vertex in the place of each.
fn welded(instance: &MeshInstance) -> Vec<u32> {
    let mut first: BTreeMap<[u32; 3], u32> = BTreeMap::new();
    // Adding 0 makes one of the two zeros.
    let place = |point: &Vec3| (*point + Vec3::ZERO).to_array().map(f32::to_bits);
    (0..).zip(&instance.positions_m).map(|(v, point)| *first.entry(place(point)).or_insert(v)).collect()
}

fn root_of(root: &mut [u32], mut of: u32) -> u32 {
    while root[of as usize] != of {
        root[of as usize] = root[root[of as usize] as usize];
        of = root[of as usize];
    }
    of
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::scene::SceneCamera;

    use super::super::model::Material;
    use super::*;

    fn wall() -> Material {
        Material::opaque("wall", [0.5; 3])
    }

    /// A cube about `middle` whose faces look out, or in.
    fn cube(path: &str, middle: Vec3, half: f32, looks_out: bool) -> MeshInstance {
        let corner = |bits: u32| {
            middle + half * Vec3::from([0, 1, 2].map(|axis| if bits >> axis & 1 == 1 { 1.0 } else { -1.0 }))
        };
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        // As exporters write them: each face has vertices of its own.
        let mut instance = MeshInstance { path: path.into(), ..MeshInstance::default() };
        for quad in quads {
            let first = instance.positions_m.len() as u32;
            instance.positions_m.extend(quad.map(corner));
            for [b, c] in [[1, 2], [2, 3]] {
                let [b, c] = if looks_out { [b, c] } else { [c, b] };
                instance.triangles.push([first, first + b, first + c]);
            }
        }
        instance
    }

    fn seen(instances: Vec<MeshInstance>, eyes: &[Vec3]) -> Scene {
        let camera = |eye: &Vec3| SceneCamera {
            name: "eye".into(),
            eye_m: (*eye).into(),
            target_m: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov_y_rad: 1.0,
            orthographic_half_height_m: None,
        };
        let cameras = eyes.iter().map(camera).collect();
        Scene { instances, cameras, materials: vec![wall()], ..Scene::default() }
    }

    fn room() -> MeshInstance {
        cube("room", Vec3::ZERO, 3.0, false)
    }

    const EYE: Vec3 = Vec3::new(2.0, 1.0, 2.0);

    #[test]
    fn thing_that_looks_in_is_named_and_the_room_about_it_is_not() {
        let thing = |path: &str, x, looks_out| cube(path, Vec3::new(x, 0.0, 0.0), 0.5, looks_out);
        let found = inside_out(&seen(vec![room(), thing("crate", -1.0, false)], &[EYE])).unwrap();
        assert!(found.message.starts_with("closed mesh 'crate' is turned inside out"), "{}", found.message);
        let two = vec![room(), thing("crate", -1.0, false), thing("chest", 1.0, false)];
        let found = inside_out(&seen(two, &[EYE])).unwrap();
        assert!(found.message.starts_with("2 closed meshes, 'crate' first"), "{}", found.message);
        assert_eq!(inside_out(&seen(vec![room(), thing("crate", -1.0, true)], &[EYE])), None);
    }

    #[test]
    fn mesh_that_may_be_a_room_is_left_alone() {
        let alone = seen(vec![room()], &[]);
        assert_eq!(inside_out(&alone), None, "nobody says from where it is seen");
        let from_outside = cube("yard", Vec3::new(20.0, 0.0, 0.0), 2.0, true);
        let furnished = vec![room(), cube("table", Vec3::ZERO, 0.5, true), from_outside];
        assert_eq!(inside_out(&seen(furnished, &[Vec3::new(9.0, 0.0, 0.0)])), None, "it has a table");
        assert_eq!(inside_out(&seen(vec![room()], &[EYE])), None, "the camera is in it");
        let mut both = room();
        let table = cube("table", Vec3::ZERO, 0.5, true);
        let first = both.positions_m.len() as u32;
        both.positions_m.extend(&table.positions_m);
        both.triangles.extend(table.triangles.iter().map(|triangle| triangle.map(|v| first + v)));
        assert_eq!(inside_out(&seen(vec![both], &[9.0 * EYE])), None, "its table is of one mesh with it");
    }

    #[test]
    fn vertices_in_a_mesh_are_those_of_the_others_in_its_bounds() {
        let row = (0..40).map(|i| cube(&format!("{i}"), Vec3::new(0.7 * i as f32, 0.1, 0.0), 0.5, true));
        let scene = seen(row.collect(), &[]);
        let vertices = Vertices::of(&scene);
        let order = |points: &mut Vec<Vec3>| points.sort_by_key(|point| point.to_array().map(f32::to_bits));
        for (index, instance) in scene.instances.iter().enumerate() {
            let whole = bounds_m(instance.positions_m.iter().copied());
            let others = scene.instances.iter().enumerate().filter(|(other, _)| *other != index);
            let others = others.flat_map(|(_, other)| other.positions_m.iter().copied());
            let mut wanted: Vec<Vec3> = others.filter(|&point| is_within(point, whole)).collect();
            let mut found = vertices.within(index, whole);
            order(&mut wanted);
            order(&mut found);
            assert!(!wanted.is_empty() && found == wanted, "{index}");
        }
    }

    #[test]
    fn open_double_sided_and_emissive_meshes_are_left_alone() {
        let crate_of = |change: fn(&mut Scene)| {
            let mut scene = seen(vec![cube("crate", Vec3::ZERO, 0.5, false)], &[EYE]);
            change(&mut scene);
            inside_out(&scene).is_some()
        };
        assert!(crate_of(|_| ()));
        assert!(!crate_of(|scene| scene.instances[0].triangles.truncate(11)));
        assert!(!crate_of(|scene| scene.materials[0].double_sided = true));
        assert!(!crate_of(|scene| scene.materials[0].emissive = [1.0; 3]));
    }
}
