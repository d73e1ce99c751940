//! Which triangles meet at which edge, and whether the surface is smooth there.

use glam::{DVec3, Vec3};

use super::UnwrapSettings;
use super::soup::Soup;

/// No triangle beyond this edge.
pub(super) const NO_NEIGHBOUR: u32 = u32::MAX;

/// Edges that meet at a smaller angle than this (cosine of 2°) are flat, whatever the shading normals say.
const FLAT_COSINE: f64 = 0.999_39;

/// Edges shared by more triangles than this are paired in index order instead of by best match.
const MAX_MATCHED_FAN: usize = 16;

/// At most one neighbour over each edge of each triangle.
///
/// Neighbours run along their edge in opposite directions, so that both face the same side. Where more than two
/// triangles share an edge those with the closest normals are paired. Coincident triangles lie in different
/// layers, and only triangles of one layer are neighbours: duplicates never meet in a chart.
pub(super) struct Adjacency {
    /// `neighbours[t][e]` lies beyond the edge from corner `e` to corner `e + 1`.
    pub neighbours: Vec<[u32; 3]>,
    /// Bit `e` is set when edge `e` is hard.
    hard_edges: Vec<u8>,
}

/// One side of an edge. Ordered by edge, layer, direction, triangle.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct HalfEdge {
    low: u32,
    high: u32,
    layer: u32,
    is_reversed: bool,
    triangle: u32,
    edge: u8,
}

impl Adjacency {
    /// Pairs half-edges by sorting them.
    pub fn new(soup: &Soup, normals: &[Vec3], triangles: &[[u32; 3]], settings: &UnwrapSettings) -> Self {
        let mut adjacency =
            Self { neighbours: vec![[NO_NEIGHBOUR; 3]; soup.len()], hard_edges: vec![0; soup.len()] };
        let shading =
            Shading { soup, normals, triangles, crease_cosine: libm::cos(settings.crease_rad.into()) };
        let half_edges = sorted_half_edges(soup);
        for group in half_edges.chunk_by(|a, b| (a.low, a.high, a.layer) == (b.low, b.high, b.layer)) {
            let (forward, backward) = group.split_at(group.partition_point(|h| !h.is_reversed));
            adjacency.pair_group(&shading, forward, backward);
        }
        adjacency
    }

    /// Whether edge `edge` of the triangle ends a chart.
    pub fn is_hard(&self, triangle: u32, edge: usize) -> bool {
        self.hard_edges[triangle as usize] >> edge & 1 != 0
    }

    fn pair_group(&mut self, shading: &Shading, forward: &[HalfEdge], backward: &[HalfEdge]) {
        if forward.len().max(backward.len()) > MAX_MATCHED_FAN {
            for (&a, &b) in forward.iter().zip(backward) {
                self.join(shading, a, b);
            }
            return;
        }
        let mut pairs: Vec<(f64, usize, usize)> = Vec::with_capacity(forward.len() * backward.len());
        for (i, a) in forward.iter().enumerate() {
            for (j, b) in backward.iter().enumerate() {
                pairs.push((shading.normal_cosine(a.triangle, b.triangle), i, j));
            }
        }
        pairs.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        let (mut used_forward, mut used_backward) = (0_u32, 0_u32);
        for (_, i, j) in pairs {
            if used_forward >> i & 1 == 0 && used_backward >> j & 1 == 0 {
                used_forward |= 1 << i;
                used_backward |= 1 << j;
                self.join(shading, forward[i], backward[j]);
            }
        }
    }

    fn join(&mut self, shading: &Shading, a: HalfEdge, b: HalfEdge) {
        if a.triangle == b.triangle {
            return;
        }
        self.neighbours[a.triangle as usize][a.edge as usize] = b.triangle;
        self.neighbours[b.triangle as usize][b.edge as usize] = a.triangle;
        if shading.is_hard(a, b) {
            self.hard_edges[a.triangle as usize] |= 1 << a.edge;
            self.hard_edges[b.triangle as usize] |= 1 << b.edge;
        }
    }
}

fn sorted_half_edges(soup: &Soup) -> Vec<HalfEdge> {
    let layers = duplicate_layers(soup);
    let mut half_edges = Vec::with_capacity(3 * soup.len());
    for triangle in (0..soup.len() as u32).filter(|&t| soup.is_live(t)) {
        let corners = soup.corners[triangle as usize];
        for edge in 0..3_u8 {
            let (from, to) = (corners[edge as usize], corners[(edge as usize + 1) % 3]);
            half_edges.push(HalfEdge {
                low: from.min(to),
                high: from.max(to),
                layer: layers[triangle as usize],
                is_reversed: from > to,
                triangle,
                edge,
            });
        }
    }
    half_edges.sort_unstable();
    half_edges
}

/// How many triangles of lower index have the same three points and face the same side.
fn duplicate_layers(soup: &Soup) -> Vec<u32> {
    let key = |t: u32| {
        let [a, b, c] = soup.corners[t as usize];
        if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        }
    };
    let mut order: Vec<([u32; 3], u32)> =
        (0..soup.len() as u32).filter(|&t| soup.is_live(t)).map(|t| (key(t), t)).collect();
    order.sort_unstable();
    let mut layers = vec![0; soup.len()];
    for same in order.chunk_by(|a, b| a.0 == b.0) {
        for (layer, &(_, triangle)) in same.iter().enumerate() {
            layers[triangle as usize] = layer as u32;
        }
    }
    layers
}

/// Tells hard edges from smooth ones.
struct Shading<'a> {
    soup: &'a Soup,
    normals: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    crease_cosine: f64,
}

impl Shading<'_> {
    fn normal_cosine(&self, a: u32, b: u32) -> f64 {
        self.soup.normals[a as usize].dot(self.soup.normals[b as usize])
    }

    /// Hard when the shading normals of both sides differ at either end of the edge and the surface bends there.
    fn is_hard(&self, a: HalfEdge, b: HalfEdge) -> bool {
        if self.normal_cosine(a.triangle, b.triangle) > FLAT_COSINE {
            return false;
        }
        let ends = [(0, 1), (1, 0)];
        ends.iter().any(|&(at_a, at_b)| {
            self.corner_normal(a, at_a).dot(self.corner_normal(b, at_b)) < self.crease_cosine
        })
    }

    /// Unit shading normal at one end of a half-edge; the geometric one where the mesh has none.
    fn corner_normal(&self, half_edge: HalfEdge, end: usize) -> DVec3 {
        let corner = (half_edge.edge as usize + end) % 3;
        let vertex = self.triangles[half_edge.triangle as usize][corner] as usize;
        let geometric = self.soup.normals[half_edge.triangle as usize];
        let shading = self.normals.get(vertex).map_or(DVec3::ZERO, |n| n.as_dvec3());
        shading.try_normalize().unwrap_or(geometric)
    }
}
