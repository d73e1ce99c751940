//! A tree of eight-wide nodes over triangles in blocks of eight, made of obvhs' binary tree (\[Wald2008\]): of each inner
//! node the parts with the largest surface are opened until there are eight, and parts of at most eight triangles are blocks.

use glam::Vec3;
use obvhs::bvh2::Bvh2;

/// Boxes of a node, and triangles of a block.
pub const WIDTH: usize = 8;
/// One number of each box of a node, or of each triangle of a block.
pub type Lanes = [f32; WIDTH];

/// Bit of a child that is a block of triangles.
const BLOCK: u32 = 1 << 31;

/// Content of a node's box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Child {
    /// A node by index.
    Node(usize),
    /// A block of triangles by index.
    Block(usize),
}

impl Child {
    /// The child of a code of [`Node::children`].
    #[inline(always)]
    pub fn of(code: u32) -> Self {
        if code & BLOCK == 0 { Self::Node(code as usize) } else { Self::Block((code & !BLOCK) as usize) }
    }

    fn code(self) -> u32 {
        match self {
            Self::Node(index) => index as u32,
            Self::Block(index) => index as u32 | BLOCK,
        }
    }
}

/// Eight boxes; those that are not used are met by no ray.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Node {
    /// Lower and upper bounds, along each axis.
    pub bounds: [[Lanes; 3]; 2],
    /// Codes of what each box holds.
    pub children: [u32; WIDTH],
}

impl Node {
    const EMPTY: Self =
        Self { bounds: [[[f32::MAX; WIDTH]; 3], [[f32::MIN; WIDTH]; 3]], children: [0; WIDTH] };

    /// The children whose boxes meet a box.
    fn meeting(&self, low: Vec3, high: Vec3) -> impl Iterator<Item = Child> + '_ {
        let [own_low, own_high] = &self.bounds;
        let meets = move |&lane: &usize| {
            (0..3).all(|axis| own_low[axis][lane] <= high[axis] && own_high[axis][lane] >= low[axis])
        };
        (0..WIDTH).filter(meets).map(|lane| Child::of(self.children[lane]))
    }
}

/// Corners of at most eight triangles, along each axis; those that are not used are no numbers, which no ray hits.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Block {
    /// Along each axis, of each corner.
    pub corners: [[Lanes; 3]; 3],
}

impl Block {
    const EMPTY: Self = Self { corners: [[[f32::NAN; WIDTH]; 3]; 3] };

    /// Corners of a triangle.
    pub fn triangle(&self, lane: usize) -> [Vec3; 3] {
        self.corners.map(|axes| Vec3::from_array(axes.map(|lanes| lanes[lane])))
    }

    fn set(&mut self, lane: usize, triangle: &[Vec3; 3]) {
        for (axes, corner) in self.corners.iter_mut().zip(triangle) {
            axes.iter_mut().zip(corner.to_array()).for_each(|(lanes, value)| lanes[lane] = value);
        }
    }
}

/// The tree.
#[derive(Debug, Default)]
pub struct Tree {
    /// Nodes, the root first.
    pub nodes: Vec<Node>,
    /// Blocks of triangles.
    pub blocks: Vec<Block>,
    /// Triangle as given, of each triangle of each block; [`u32::MAX`] where there is none.
    pub triangles: Vec<[u32; WIDTH]>,
    /// Most nodes and blocks that wait while a ray goes through the tree.
    pub waiting_max: usize,
}

impl Tree {
    /// The tree of a binary one over the same triangles.
    pub fn new(bvh: &Bvh2, triangles: &[[Vec3; 3]]) -> Self {
        let mut tree = Self::default();
        if bvh.nodes.is_empty() {
            return tree;
        }
        let source = Source { bvh, counts: counts(bvh), triangles };
        tree.nodes.push(Node::EMPTY);
        let mut open = vec![(0, 0, 1)];
        while let Some((own, binary, depth)) = open.pop() {
            tree.waiting_max = tree.waiting_max.max(depth * WIDTH);
            for (lane, part) in source.parts(binary).into_iter().enumerate() {
                let child = if source.is_leaf(part) {
                    tree.add_block(&source, part)
                } else {
                    tree.nodes.push(Node::EMPTY);
                    let index = tree.nodes.len() - 1;
                    open.push((index, part, depth + 1));
                    Child::Node(index)
                };
                let (node, bounds) = (&mut tree.nodes[own], bvh.nodes[part].aabb());
                node.children[lane] = child.code();
                for axis in 0..3 {
                    node.bounds[0][axis][lane] = bounds.min[axis];
                    node.bounds[1][axis][lane] = bounds.max[axis];
                }
            }
        }
        tree
    }

    fn add_block(&mut self, source: &Source, part: usize) -> Child {
        let (mut block, mut triangles) = (Block::EMPTY, [u32::MAX; WIDTH]);
        let mut lane = 0;
        let mut open = vec![part];
        while let Some(node) = open.pop().map(|index| &source.bvh.nodes[index]) {
            let first = node.first_index as usize;
            if !node.is_leaf() {
                open.extend([first + 1, first]);
                continue;
            }
            for &triangle in &source.bvh.primitive_indices[first..first + node.prim_count as usize] {
                block.set(lane, &source.triangles[triangle as usize]);
                triangles[lane] = triangle;
                lane += 1;
            }
        }
        self.blocks.push(block);
        self.triangles.push(triangles);
        Child::Block(self.blocks.len() - 1)
    }

    /// Visits every triangle whose bounds meet a box, and maybe others.
    pub fn visit_box(&self, low: Vec3, high: Vec3, mut visit: impl FnMut(&[Vec3; 3]) -> bool) {
        let mut open: Vec<usize> = (0..self.nodes.len().min(1)).collect();
        while let Some(node) = open.pop() {
            for child in self.nodes[node].meeting(low, high) {
                match child {
                    Child::Node(index) => open.push(index),
                    Child::Block(index) => {
                        let mut lanes = (0..WIDTH).filter(|&lane| self.triangles[index][lane] != u32::MAX);
                        if !lanes.all(|lane| visit(&self.blocks[index].triangle(lane))) {
                            return;
                        }
                    }
                }
            }
        }
    }
}

/// The binary tree that a tree is made of.
struct Source<'a> {
    bvh: &'a Bvh2,
    /// Triangles below each node.
    counts: Vec<u32>,
    triangles: &'a [[Vec3; 3]],
}

impl Source<'_> {
    fn is_leaf(&self, node: usize) -> bool {
        self.bvh.nodes[node].is_leaf() || self.counts[node] as usize <= WIDTH
    }

    /// At most eight nodes that together are one: of those that can be opened, the one with the largest surface is.
    fn parts(&self, node: usize) -> Vec<usize> {
        let mut parts = vec![node];
        let surface = |part: usize| self.bvh.nodes[part].aabb().half_area();
        while parts.len() < WIDTH {
            let inner = parts.iter().copied().enumerate().filter(|(_, part)| !self.is_leaf(*part));
            // Of equal ones the first.
            let widest = inner.max_by(|a, b| surface(a.1).total_cmp(&surface(b.1)).then(b.0.cmp(&a.0)));
            let Some((place, part)) = widest else { break };
            let first = self.bvh.nodes[part].first_index as usize;
            parts[place] = first;
            parts.push(first + 1);
        }
        parts
    }
}

/// Triangles below each node of a binary tree.
fn counts(bvh: &Bvh2) -> Vec<u32> {
    let mut counts = vec![0; bvh.nodes.len()];
    let mut open = vec![(0, false)];
    while let Some((index, is_counted_below)) = open.pop() {
        let node = &bvh.nodes[index];
        let first = node.first_index as usize;
        if node.is_leaf() {
            counts[index] = node.prim_count;
        } else if is_counted_below {
            counts[index] = counts[first] + counts[first + 1];
        } else {
            open.extend([(index, true), (first, false), (first + 1, false)]);
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use obvhs::BvhBuildParams;
    use obvhs::bvh2::builder::build_bvh2;
    use obvhs::triangle::Triangle;

    use super::*;
    use crate::rays::sampling::Sequence;

    #[test]
    fn every_triangle_is_in_one_block_within_all_boxes_above_it() {
        let mut sequence = Sequence::new(2);
        let mut point = || Vec3::new(sequence.next_f32(), sequence.next_f32(), sequence.next_f32());
        let triangles: Vec<[Vec3; 3]> = (0..3000).map(|_| [point(), point(), point()]).collect();
        let bounded: Vec<Triangle> = triangles
            .iter()
            .map(|&[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() })
            .collect();
        let bvh = build_bvh2(&bounded, BvhBuildParams::medium_build(), &mut Duration::ZERO.clone());
        let tree = Tree::new(&bvh, &triangles);
        let mut met = vec![0; triangles.len()];
        let mut open = vec![(0, Vec3::NEG_INFINITY, Vec3::INFINITY)];
        while let Some((node, low, high)) = open.pop() {
            let node = &tree.nodes[node];
            for lane in (0..WIDTH).filter(|&lane| node.bounds[0][0][lane] <= node.bounds[1][0][lane]) {
                let [own_low, own_high] =
                    node.bounds.map(|axes| Vec3::from_array(axes.map(|lanes| lanes[lane])));
                assert!(own_low.cmpge(low).all() && own_high.cmple(high).all());
                match Child::of(node.children[lane]) {
                    Child::Node(index) => open.push((index, own_low, own_high)),
                    Child::Block(index) => {
                        for (lane, &triangle) in tree.triangles[index].iter().enumerate() {
                            if triangle != u32::MAX {
                                met[triangle as usize] += 1;
                                assert_eq!(tree.blocks[index].triangle(lane), triangles[triangle as usize]);
                                let corners = triangles[triangle as usize];
                                assert!(
                                    corners.iter().all(|c| c.cmpge(own_low).all() && c.cmple(own_high).all())
                                );
                            }
                        }
                    }
                }
            }
        }
        assert!(met.iter().all(|times| *times == 1));
        assert!(tree.blocks.len() < 1000, "{} blocks", tree.blocks.len());
    }
}
