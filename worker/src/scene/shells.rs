//! Triangles that reach from shell to shell of a scene's core, cut at the borders: each piece then lies in one shell, has texels
//! of that shell's size, and no coordinates much larger than its distance, which rays would round by.

use std::collections::BTreeMap;

use glam::Vec3;

use super::core::Core;
use super::model::{MeshInstance, Scene};

/// Most triangles that cutting may add. A scene that would need more has too many huge triangles to have a core.
const ADDED_MAX: usize = 1 << 20;

/// A plane across an axis.
#[derive(Clone, Copy)]
struct Plane {
    axis: usize,
    at_m: f32,
}

/// Finds the scene's core and cuts the triangles about it; changes nothing in a scene of one scale.
///
/// Errors when `check` does, which is asked again and again.
pub fn cut_about_core<E>(scene: &mut Scene, check: impl Fn() -> Result<(), E>) -> Result<(), E> {
    let Some(core) = Core::of(scene) else { return Ok(()) };
    let planes = planes(&core);
    let mut room = ADDED_MAX;
    let mut cut: Vec<(usize, MeshInstance)> = Vec::new();
    for (index, instance) in scene.instances.iter().enumerate() {
        check()?;
        let low = instance.positions_m.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = instance.positions_m.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let across = planes.iter().filter(|plane| {
            let Plane { axis, at_m } = **plane;
            low[axis] < at_m && at_m < high[axis]
        });
        let across: Vec<Plane> = across.copied().collect();
        if across.is_empty() {
            continue;
        }
        let mut pieces = instance.clone();
        if !Cut::new(&mut pieces, &across).all(&mut room, &check)? {
            return Ok(());
        }
        cut.push((index, pieces));
    }
    for (index, pieces) in cut {
        scene.instances[index] = pieces;
    }
    scene.core = Some(core);
    Ok(())
}

/// The sides of all cubes but the outermost, which holds everything.
fn planes(core: &Core) -> Vec<Plane> {
    let cubes = (0..core.shells).map(|shell| core.bounds_of(shell));
    let sides = cubes.flat_map(|corners| (0..3).map(move |axis| (axis, corners)));
    sides.flat_map(|(axis, corners)| corners.map(|corner| Plane { axis, at_m: corner[axis] })).collect()
}

/// The cuts of an instance by some planes.
struct Cut<'a> {
    instance: &'a mut MeshInstance,
    planes: &'a [Plane],
    /// Vertex where the edge between two vertices crosses a plane, by the plane's number.
    crossings: BTreeMap<(usize, [u32; 2]), u32>,
}

impl<'a> Cut<'a> {
    fn new(instance: &'a mut MeshInstance, planes: &'a [Plane]) -> Self {
        Self { instance, planes, crossings: BTreeMap::new() }
    }

    /// Cuts every triangle that a plane crosses; the pieces stand where it stood. False where they are more than there is
    /// `room` for.
    fn all<E>(&mut self, room: &mut usize, check: &impl Fn() -> Result<(), E>) -> Result<bool, E> {
        let triangles = std::mem::take(&mut self.instance.triangles);
        let mut pieces = Vec::with_capacity(triangles.len());
        for triangle in triangles {
            check()?;
            let before = pieces.len();
            for polygon in self.polygons(triangle) {
                pieces.extend((2..polygon.len()).map(|last| [polygon[0], polygon[last - 1], polygon[last]]));
            }
            let Some(left) = room.checked_sub((pieces.len() - before).saturating_sub(1)) else {
                return Ok(false);
            };
            *room = left;
        }
        pieces.retain(|piece| self.has_area(*piece));
        self.instance.triangles = pieces;
        Ok(true)
    }

    /// The parts of a triangle between the planes: whole ones, as triangles of one part would be cut again by all planes after.
    fn polygons(&mut self, triangle: [u32; 3]) -> Vec<Vec<u32>> {
        let mut polygons = vec![triangle.to_vec()];
        for plane in 0..self.planes.len() {
            let mut after = Vec::with_capacity(polygons.len());
            for polygon in polygons {
                let sides: Vec<i8> = polygon.iter().map(|&vertex| self.side_of(vertex, plane)).collect();
                if sides.contains(&1) && sides.contains(&-1) {
                    after.extend([-1, 1].map(|side| self.kept(&polygon, &sides, plane, side)));
                } else {
                    after.push(polygon);
                }
            }
            polygons = after;
        }
        polygons
    }

    /// Sutherland–Hodgman: the corners of a polygon on one side of a plane, and those where its edges cross that.
    fn kept(&mut self, polygon: &[u32], sides: &[i8], plane: usize, side: i8) -> Vec<u32> {
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for corner in 0..polygon.len() {
            let next = (corner + 1) % polygon.len();
            if sides[corner] != -side {
                kept.push(polygon[corner]);
            }
            if sides[corner] * sides[next] == -1 {
                kept.push(self.crossing(polygon[corner], polygon[next], plane));
            }
        }
        kept
    }

    /// Rounding leaves none to some slivers.
    fn has_area(&self, triangle: [u32; 3]) -> bool {
        let [a, b, c] = triangle.map(|vertex| self.instance.positions_m[vertex as usize].as_dvec3());
        (b - a).cross(c - a).length_squared() > 0.0
    }

    /// −1 before the plane, 1 beyond it, 0 on it.
    fn side_of(&self, vertex: u32, plane: usize) -> i8 {
        let Plane { axis, at_m } = self.planes[plane];
        let away_m = self.instance.positions_m[vertex as usize][axis] - at_m;
        i8::from(away_m > 0.0) - i8::from(away_m < 0.0)
    }

    /// The vertex where an edge crosses the plane: the same point for every triangle at the edge, whatever vertices it has.
    fn crossing(&mut self, from: u32, to: u32, plane: usize) -> u32 {
        let bits = |vertex: u32| self.instance.positions_m[vertex as usize].to_array().map(f32::to_bits);
        let [from, to] = if bits(from) <= bits(to) { [from, to] } else { [to, from] };
        if let Some(&known) = self.crossings.get(&(plane, [from, to])) {
            return known;
        }
        let Plane { axis, at_m } = self.planes[plane];
        let [a, b] = [from, to].map(|vertex| vertex as usize);
        let MeshInstance { positions_m, normals, uv0, uv1, colours, .. } = &mut *self.instance;
        let [from_m, to_m] = [a, b].map(|vertex| positions_m[vertex].as_dvec3());
        let share = (f64::from(at_m) - from_m[axis]) / (to_m[axis] - from_m[axis]);
        let mut point_m = from_m.lerp(to_m, share).as_vec3();
        point_m[axis] = at_m;
        let vertex = positions_m.len() as u32;
        positions_m.push(point_m);
        let share = share as f32;
        push_between(normals, [a, b], |a, b| a.lerp(b, share).normalize_or(a));
        push_between(uv0, [a, b], |a, b| a.lerp(b, share));
        push_between(uv1, [a, b], |a, b| a.lerp(b, share));
        push_between(colours, [a, b], |a, b| {
            [0, 1, 2, 3].map(|channel: usize| a[channel] + (b[channel] - a[channel]) * share)
        });
        self.crossings.insert((plane, [from, to]), vertex);
        vertex
    }
}

/// Adds what lies between two of the values, if there are any.
fn push_between<T: Copy>(values: &mut Vec<T>, [a, b]: [usize; 2], between: impl Fn(T, T) -> T) {
    if let (Some(&a), Some(&b)) = (values.get(a), values.get(b)) {
        values.push(between(a, b));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::convert::Infallible;

    use glam::Vec2;

    use super::*;

    /// A room's worth of triangles at the origin, and a plane of 100 km through it.
    fn room_on_a_plain() -> Scene {
        let quad = |half_m: f32, y: f32| MeshInstance {
            positions_m: [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
                .map(|[x, z]| Vec3::new(x * half_m, y, z * half_m))
                .into(),
            normals: vec![Vec3::Y; 4],
            uv0: [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]].map(Vec2::from).into(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..MeshInstance::default()
        };
        let instances = (0..6).map(|wall| quad(2.0, wall as f32)).chain([quad(5e4, 0.0)]).collect();
        Scene { instances, ..Scene::default() }
    }

    #[test]
    fn pieces_of_a_plain_are_the_plain_and_each_lies_in_one_shell() {
        let mut scene = room_on_a_plain();
        cut_about_core(&mut scene, || Ok::<(), Infallible>(())).unwrap();
        let core = scene.core.unwrap();
        assert_eq!(scene.instances[..6], room_on_a_plain().instances[..6]);
        let plain = &scene.instances[6];
        let mut area_m2 = 0.0;
        for triangle in &plain.triangles {
            let corners = triangle.map(|vertex| plain.positions_m[vertex as usize]);
            let [a, b, c] = corners.map(|corner| corner.as_dvec3());
            let doubled = (b - a).cross(c - a);
            assert!(doubled.y > 0.0, "{corners:?} lies on its face");
            area_m2 += 0.5 * doubled.length();
            let shell = core.shell_of_triangle(corners);
            for corner in corners {
                let away_m = (corner - core.middle_m).abs().max_element();
                assert!(away_m <= core.half_of(shell), "{corners:?} in shell {shell}");
                assert!(shell == 0 || away_m >= 0.0);
            }
        }
        assert!((area_m2 / 1e10 - 1.0).abs() < 1e-6, "{area_m2}");
        assert!((500..5000).contains(&plain.triangles.len()), "{}", plain.triangles.len());
        // Attributes follow the points.
        for (position_m, uv) in plain.positions_m.iter().zip(&plain.uv0) {
            assert!((*uv - Vec2::new(position_m.x, position_m.z) / 5e4).length() < 1e-6, "{position_m} {uv}");
        }
        assert_eq!(plain.normals.len(), plain.positions_m.len());
        // Nothing is cracked: every edge but those of the rim has two triangles.
        let mut edges = BTreeSet::new();
        let bits =
            |vertex: u32| plain.positions_m[vertex as usize].to_array().map(|axis| (axis + 0.0).to_bits());
        for triangle in &plain.triangles {
            for corner in 0..3 {
                assert!(edges.insert([bits(triangle[corner]), bits(triangle[(corner + 1) % 3])]));
            }
        }
        let is_rim = |bits: [u32; 3]| [0, 2].into_iter().any(|axis| f32::from_bits(bits[axis]).abs() == 5e4);
        for [from, to] in &edges {
            assert!(edges.contains(&[*to, *from]) || (is_rim(*from) && is_rim(*to)), "a crack");
        }
    }

    #[test]
    fn cutting_stops_when_it_is_told_to() {
        let mut scene = room_on_a_plain();
        assert_eq!(cut_about_core(&mut scene, || Err("enough")), Err("enough"));
    }

    #[test]
    fn scene_of_huge_triangles_alone_is_left_as_it_is() {
        let mut scene = room_on_a_plain();
        let plain = scene.instances.pop().unwrap();
        let triangles = plain.triangles.repeat(1000);
        scene.instances.push(MeshInstance { triangles, ..plain });
        // Many rooms outweigh it.
        let rooms = scene.instances[..6].to_vec();
        (0..20).for_each(|_| scene.instances.extend(rooms.clone()));
        let before = scene.clone();
        cut_about_core(&mut scene, || Ok::<(), Infallible>(())).unwrap();
        assert!(scene == before && Core::of(&scene).is_some());
    }
}
