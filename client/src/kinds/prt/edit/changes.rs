//! Surfaces that two scenes do not have in common, as boxes.

use std::collections::{BTreeMap, BTreeSet, HashSet};

use glam::{IVec3, Vec3};
use lightkiln_proto::manifest::TEXTURES;

use crate::scene::LoadedScene;

/// Low and high corner in metres.
pub(super) type Bounds = [Vec3; 2];

/// Cells along the scene's diagonal that changed surfaces are marked in. More → finer marks, more of them.
const CELLS: f32 = 128.0;
/// Most cells of one triangle; a larger one is a box of its own.
const TRIANGLE_CELLS_MAX: i32 = 512;

/// A triangle as rays see it: bits of its corners, and what its material lets through there.
type Triangle = ([[u32; 3]; 3], String);

/// Boxes around surfaces that one scene has and the other has not.
#[derive(Debug, Default)]
pub(super) struct Changes {
    boxes: Vec<Bounds>,
    /// The part of them that are cells, and a cell's side.
    cells: HashSet<[i32; 3]>,
    cell_m: f32,
    /// Boxes that are no cells.
    large: Vec<Bounds>,
}

impl Changes {
    /// Between two scenes.
    pub(super) fn between(before: &LoadedScene, after: &LoadedScene) -> Self {
        let mut triangles: BTreeMap<Triangle, i64> = BTreeMap::new();
        for (scene, step) in [(before, 1), (after, -1)] {
            for draw in &scene.draws.draws {
                let material = &scene.manifest.materials[draw.material as usize];
                let passes = material.alpha_cutoff.is_some() || material.glass.is_some();
                let image = material.base_colour_texture.as_ref().filter(|_| passes).map(|of| {
                    let chunk = scene.manifest.chunks(TEXTURES).get(of.texture as usize);
                    (chunk.map(|chunk| chunk.digest), of.wrap)
                });
                let alike = (material.double_sided, material.alpha_cutoff, material.glass.as_ref(), image);
                let colour = passes.then_some(material.base_colour);
                let of_material = format!("{alike:?} {colour:?}");
                for corners in &draw.triangles {
                    // The same triangle, whichever corner comes first.
                    let [a, b, c] = *corners;
                    let turns = [[a, b, c], [b, c, a], [c, a, b]];
                    let bits = |corner: u32| draw.vertices[corner as usize].position_m.map(f32::to_bits);
                    let corners = turns.into_iter().min_by_key(|turn| turn.map(bits)).unwrap_or([a, b, c]);
                    let passed = match passes {
                        true => {
                            let at = corners.map(|corner| &draw.vertices[corner as usize]);
                            format!("{of_material} {:?}", at.map(|vertex| (vertex.uv, vertex.colour)))
                        }
                        false => of_material.clone(),
                    };
                    *triangles.entry((corners.map(bits), passed)).or_default() += step;
                }
            }
        }
        let cell_m =
            [before, after].map(LoadedScene::diagonal_m).into_iter().fold(f32::MIN_POSITIVE, f32::max)
                / CELLS;
        let (mut cells, mut large) = (BTreeSet::new(), Vec::new());
        for ((corners, _), _) in triangles.iter().filter(|(_, count)| **count != 0) {
            let [a, b, c] = corners.map(|corner| Vec3::from(corner.map(f32::from_bits)));
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            let [first, last] = [low, high].map(|corner| (corner / cell_m).floor().as_ivec3());
            let size = last - first + 1;
            if size.max_element() > TRIANGLE_CELLS_MAX || size.element_product() > TRIANGLE_CELLS_MAX {
                large.push([low, high]);
                continue;
            }
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    cells.extend((first.x..=last.x).map(|x| [z, y, x]));
                }
            }
        }
        let bounds = |[z, y, x]: [i32; 3]| [0, 1].map(|end| (IVec3::new(x, y, z) + end).as_vec3() * cell_m);
        let boxes = large.iter().copied().chain(cells.iter().copied().map(bounds)).collect();
        Self { boxes, cells: cells.into_iter().collect(), cell_m, large }
    }

    /// Whether something has changed within bounds.
    pub(super) fn meet(&self, [low, high]: Bounds) -> bool {
        let is_met = |[from, to]: &Bounds| low.cmple(*to).all() && from.cmple(high).all();
        let [first, last] = [low, high].map(|corner| (corner / self.cell_m).floor().as_ivec3());
        let cells = (last - first + 1).as_vec3().element_product();
        if cells > self.cells.len() as f32 {
            return self.boxes.iter().any(is_met);
        }
        let mut along = (first.z..=last.z).flat_map(|z| (first.y..=last.y).map(move |y| [z, y]));
        let has_cell = |[z, y]: [i32; 2]| (first.x..=last.x).any(|x| self.cells.contains(&[z, y, x]));
        self.large.iter().any(is_met) || along.any(has_cell)
    }

    /// Whether something has changed on a way from within one box to within another.
    pub(super) fn part(&self, a: Bounds, b: Bounds) -> bool {
        self.boxes.iter().any(|changed| is_between(a, b, *changed))
    }
}

/// Whether the box that moves and grows evenly from `a` to `b` meets another on its way.
fn is_between(a: Bounds, b: Bounds, met: Bounds) -> bool {
    let mut way = [0.0_f32, 1.0];
    // Its low end must not lie above the other's high end, nor its high end below.
    let mut keep = |at: f32, to: f32| {
        // at + t (to − at) ≤ 0
        let step = to - at;
        if step > 0.0 {
            way[1] = way[1].min(-at / step);
        } else if step < 0.0 {
            way[0] = way[0].max(-at / step);
        } else if at > 0.0 {
            way = [1.0, 0.0];
        }
    };
    for axis in 0..3 {
        keep(a[0][axis] - met[1][axis], b[0][axis] - met[1][axis]);
        keep(met[0][axis] - a[1][axis], met[0][axis] - b[1][axis]);
    }
    way[0] <= way[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::scene;

    #[test]
    fn box_between_two_others_is_met_and_one_beside_the_way_is_not() {
        let cube = |x: f32, y: f32| [Vec3::new(x, y, 0.0), Vec3::new(x + 1.0, y + 1.0, 1.0)];
        for (x, y, is_met) in [
            (5.0, 0.0, true),
            (5.0, 5.0, true),
            (5.0, 7.2, false),
            (12.1, 10.0, false),
            (-0.5, 0.5, true),
            (5.0, 2.7, false),
        ] {
            let to = if y == 0.0 { cube(10.0, 0.0) } else { cube(10.0, 10.0) };
            assert_eq!(is_between(cube(0.0, 0.0), to, cube(x, y)), is_met, "{x} {y}");
            assert_eq!(is_between(to, cube(0.0, 0.0), cube(x, y)), is_met, "{x} {y} from the other end");
        }
    }

    #[test]
    fn scene_differs_from_itself_in_nothing_and_from_one_with_a_moved_mesh_where_that_was_and_is() {
        let (before, mut after) = (scene("prt"), scene("prt"));
        assert!(Changes::between(&before, &after).boxes.is_empty());
        let draw = after.draws.draws.last_mut().unwrap();
        let was = Vec3::from(draw.vertices[0].position_m);
        draw.vertices.iter_mut().for_each(|vertex| vertex.position_m[1] += 7.0);
        let changes = Changes::between(&before, &after);
        let around = |at: Vec3| [at - 0.01, at + 0.01];
        assert!(changes.meet(around(was)) && changes.meet(around(was + 7.0 * Vec3::Y)));
        assert!(!changes.meet(around(was + 70.0)));
        // So does one whose material lets light through otherwise.
        let mut other = scene("prt");
        other.manifest.materials[0].double_sided ^= true;
        assert!(!Changes::between(&before, &other).boxes.is_empty());
        // And so does one that is cut out otherwise; another colour of a surface that stops all light is no change.
        let [mut cut, mut other] = [scene("prt"), scene("prt")];
        other.manifest.materials[0].base_colour[3] = 0.3;
        assert!(Changes::between(&cut, &other).boxes.is_empty());
        for scene in [&mut cut, &mut other] {
            scene.manifest.materials[0].alpha_cutoff = Some(0.5);
        }
        assert!(!Changes::between(&cut, &other).boxes.is_empty());
        // Corners that are listed in another order are the same triangle.
        let mut turned = scene("prt");
        turned.draws.draws[0].triangles.iter_mut().for_each(|corners| corners.rotate_left(1));
        assert!(Changes::between(&before, &turned).boxes.is_empty());
    }
}
