//! A tree of planes over tetrahedra, as Godot walks it: from the root to the side that a point is on, until a tetrahedron.

use glam::{Vec3, Vec4};

/// Marks sides on which nothing is.
pub const EMPTY: i32 = i32::MIN;

/// Distance from a plane within which a vertex counts as on it, over the tetrahedra's extent.
const ON_PLANE: f32 = 1e-5;
/// Most planes that are tried for a node.
const TRIED: usize = 48;
/// Weight of tetrahedra that a plane cuts beside those on its fuller side.
const CUT: usize = 2;

/// A node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Normal and distance from the origin.
    pub plane: Vec4,
    /// Node over the plane, or −1 − the tetrahedron there, or [`EMPTY`].
    pub over: i32,
    /// Likewise under it.
    pub under: i32,
}

/// Tetrahedra, and the tree under way.
struct Builder<'a> {
    places_m: &'a [Vec3],
    vertices: &'a [[u32; 4]],
    on_plane_m: f32,
    nodes: Vec<Node>,
}

/// The tree over some tetrahedra; its root is the first node. Those that a plane cuts are on both of its sides.
pub fn tree(places_m: &[Vec3], vertices: &[[u32; 4]]) -> Vec<Node> {
    let extent_m = places_m
        .iter()
        .fold(0.0_f32, |extent_m, place_m| extent_m.max((*place_m - places_m[0]).abs().max_element()));
    let mut builder = Builder { places_m, vertices, on_plane_m: ON_PLANE * extent_m, nodes: Vec::new() };
    let all: Vec<u32> = (0..vertices.len() as u32).collect();
    // Even one tetrahedron takes a node, as walks begin in one.
    let root = builder.side(&all);
    if builder.nodes.is_empty() {
        builder.nodes.push(Node { plane: Vec4::Y, over: root, under: root });
    }
    builder.nodes
}

/// Tetrahedra on the sides of a plane.
#[derive(Default)]
struct Sides {
    over: Vec<u32>,
    under: Vec<u32>,
}

impl Builder<'_> {
    /// A node of some tetrahedra, or −1 − the one that there is.
    fn side(&mut self, of: &[u32]) -> i32 {
        let Some(first) = of.first() else { return EMPTY };
        let leaf = -1 - *first as i32;
        if of.len() == 1 {
            return leaf;
        }
        let Some((plane, Sides { over, under })) = self.best(of) else { return leaf };
        let node = self.nodes.len();
        self.nodes.push(Node { plane, over: EMPTY, under: EMPTY });
        let over = self.side(&over);
        let under = self.side(&under);
        self.nodes[node] = Node { plane, over, under };
        node as i32
    }

    /// Of the planes of faces, evenly from all, the one with the fewest tetrahedra on its fuller side and the fewest that it cuts, and of equal ones
    /// the first; none that leaves all on one side.
    fn best(&self, of: &[u32]) -> Option<(Vec4, Sides)> {
        let faces = 4 * of.len();
        let step = faces.div_ceil(TRIED);
        // An odd step meets all four faces.
        let step = if step > 1 { step | 1 } else { step };
        let planes = (0..faces).step_by(step).filter_map(|face| self.plane(of[face / 4], face % 4));
        let counted = planes.filter_map(|plane| {
            let (mut over, mut under) = (0, 0);
            for &tetrahedron in of {
                let [is_over, is_under] = self.reach(plane, tetrahedron);
                over += usize::from(is_over);
                under += usize::from(is_under);
            }
            // Those that it cuts count once more: they go on on both sides.
            let cut = over + under - of.len();
            (over.max(under) < of.len()).then(|| (over.max(under) + CUT * cut, plane))
        });
        let best = counted.fold(None, |best: Option<(usize, Vec4)>, next| match best {
            Some(best) if best.0 <= next.0 => Some(best),
            _ => Some(next),
        });
        let (_, plane) = best?;
        let mut sides = Sides::default();
        for &tetrahedron in of {
            let [is_over, is_under] = self.reach(plane, tetrahedron);
            if is_over {
                sides.over.push(tetrahedron);
            }
            if is_under {
                sides.under.push(tetrahedron);
            }
        }
        Some((plane, sides))
    }

    fn place_m(&self, tetrahedron: u32, corner: usize) -> Vec3 {
        self.places_m[self.vertices[tetrahedron as usize][corner] as usize]
    }

    /// Plane of the face opposite to a corner.
    fn plane(&self, tetrahedron: u32, opposite: usize) -> Option<Vec4> {
        let [a, b, c] = [1, 2, 3].map(|by| self.place_m(tetrahedron, (opposite + by) % 4));
        let normal = (b - a).cross(c - a).try_normalize()?;
        Some(normal.extend(normal.dot(a)))
    }

    /// A tetrahedron reaches over a plane, and under it.
    fn reach(&self, plane: Vec4, tetrahedron: u32) -> [bool; 2] {
        let away_m =
            [0, 1, 2, 3].map(|corner| plane.truncate().dot(self.place_m(tetrahedron, corner)) - plane.w);
        let [over, under] = [
            away_m.iter().any(|&away_m| away_m > self.on_plane_m),
            away_m.iter().any(|&away_m| away_m < -self.on_plane_m),
        ];
        // A flat one is under.
        [over, under || !over]
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::harmonics::relight_direction;

    use super::*;

    const SIDE: u32 = 7;

    /// Cells of a lattice whose points are moved a little, each cut into six tetrahedra.
    fn shaken(by: f32) -> (Vec<Vec3>, Vec<[u32; 4]>) {
        let places = (0..SIDE.pow(3)).map(|index| {
            let at = [index % SIDE, index / SIDE % SIDE, index / SIDE.pow(2)];
            let is_inner = at.iter().all(|&along| along > 0 && along < SIDE - 1);
            let moved = if is_inner { relight_direction(index, 512) * by } else { Vec3::ZERO };
            Vec3::from(at.map(|along| along as f32)) + moved
        });
        let steps = [1, SIDE, SIDE * SIDE];
        let mut tetrahedra = Vec::new();
        for low in 0..SIDE.pow(3) {
            let is_cell = steps.iter().all(|step| low / step % SIDE < SIDE - 1);
            for [a, b] in [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]] {
                if is_cell {
                    let one = low + steps[a];
                    tetrahedra.push([low, one, one + steps[b], low + steps.iter().sum::<u32>()]);
                }
            }
        }
        (places.collect(), tetrahedra)
    }

    fn walk(nodes: &[Node], at: Vec3) -> i32 {
        let mut node = 0;
        while node >= 0 {
            let Node { plane, over, under } = nodes[node as usize];
            node = if plane.truncate().dot(at) > plane.w { over } else { under };
        }
        node
    }

    #[test]
    fn walks_end_in_the_tetrahedron_of_a_point() {
        for by in [0.0, 0.2] {
            let (places, tetrahedra) = shaken(by);
            let nodes = tree(&places, &tetrahedra);
            assert!(nodes.len() < 8 * tetrahedra.len(), "{} nodes", nodes.len());
            for index in 0..4096 {
                let at = 3.0 + 2.9 * relight_direction(index, 4096) * ((index % 97) as f32 / 97.0);
                let found = walk(&nodes, at);
                assert_ne!(found, EMPTY, "{at}");
                let corners = tetrahedra[(-1 - found) as usize].map(|vertex| places[vertex as usize]);
                let [a, b, c, d] = corners;
                let volume = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| (b - a).cross(c - a).dot(d - a);
                let all = volume(a, b, c, d);
                for part in
                    [volume(at, b, c, d), volume(a, at, c, d), volume(a, b, at, d), volume(a, b, c, at)]
                {
                    assert!(part / all > -1e-3, "{} at {at}", part / all);
                }
            }
        }
    }

    #[test]
    fn one_tetrahedron_none_and_twins_have_a_tree() {
        let places = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let twins = [[0, 1, 2, 3]; 2];
        assert_eq!(walk(&tree(&places, &twins[..1]), Vec3::splat(0.1)), -1);
        assert_eq!(walk(&tree(&places, &twins), Vec3::splat(0.1)), -1);
        assert_eq!(walk(&tree(&places, &[]), Vec3::splat(0.1)), EMPTY);
    }
}
