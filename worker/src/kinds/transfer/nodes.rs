//! What a node of a volume sees of the object: rays within the cone around it, evenly spread.

use std::collections::BTreeMap;
use std::f32::consts::TAU;

use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::transfer::Lattice;

use super::parts::{NO_PART, Parts};
use crate::lightmap::{Surface, World};
use crate::patches::PatchTree;
use crate::rays::sampling::{seed_of, tangent_frame};

/// Share of rays that meet backs of closed surfaces above which a node lies within the object.
const BACKS_MAX: f32 = 0.5;
/// Share of rays that meet anything from which on a node lies within it: of double-sided surfaces there are no backs.
const ENCLOSED: f32 = 0.99;
/// Points that look at the object from outside, their distance in radii, and their rays.
const LOOKS: u32 = 64;
const LOOK_RADII: f32 = 1.5;
const LOOK_RAYS: u32 = 1024;
/// Purpose of a node's seed.
const SEED: u64 = 0x7472_6e6f;

/// Numbers of one node.
pub struct Node {
    /// F_p and Ω_p by part; the last is that of what is dark.
    pub sums: Vec<[f32; 4]>,
    /// The node lies within the object.
    pub is_inside: bool,
    /// Rays that met an emissive triangle, by it and its part, or the number of parts for what is dark.
    pub glows: BTreeMap<(u8, u32), u64>,
    /// Rays that met each part.
    pub rays: Vec<u64>,
}

/// The object as nodes look at it.
pub struct Sight<'a> {
    pub world: &'a World,
    pub tree: &'a PatchTree,
    pub parts: &'a Parts,
    pub lattice: &'a Lattice,
    /// Level and rays of each node.
    pub level: u32,
    pub rays: u32,
    /// Radius of the ball around the object in metres.
    pub radius_m: f32,
    /// By triangle: whether it emits.
    pub is_emissive: &'a [bool],
}

impl Sight<'_> {
    /// What the node of a number sees.
    pub fn of(&self, index: usize) -> Node {
        let from_m = self.lattice.node_m(index);
        let dark = self.parts.parts.len();
        let mut node = Node {
            sums: vec![[0.0; 4]; dark + 1],
            is_inside: false,
            glows: BTreeMap::new(),
            rays: vec![0; dark + 1],
        };
        let cone = Cone::new(
            self.lattice.middle_m - from_m,
            self.radius_m,
            seed_of(&[self.level.into(), index as u64, SEED]),
        );
        let weight = cone.solid_angle / self.rays as f32;
        let (mut backs, mut met) = (0, 0);
        let geometry = &self.world.geometry;
        for ray in 0..self.rays {
            let direction = cone.direction(ray, self.rays);
            let Some(hit) = geometry.tracer.met(from_m, direction, f32::INFINITY) else { continue };
            let is_back = geometry.is_back(&hit);
            backs += u32::from(is_back);
            met += 1;
            let found = self.world.found_at(&hit, from_m + direction * hit.t);
            let part = match found.linked {
                Surface::Receiver(receiver) => {
                    self.parts.of_leaf[self.tree.leaf_of_receiver[receiver as usize] as usize]
                }
                Surface::Dark => NO_PART,
            };
            let place = if part == NO_PART { dark } else { usize::from(part) };
            node.rays[place] += 1;
            if !is_back && self.is_emissive[hit.triangle as usize] {
                *node.glows.entry((place as u8, hit.triangle)).or_default() += 1;
            }
            let [x, y, z] = (direction * weight).to_array();
            let sum = &mut node.sums[place];
            *sum = [sum[0] + x, sum[1] + y, sum[2] + z, sum[3] + weight];
        }
        let [backs, met] = [backs, met].map(|count| count as f32 / self.rays as f32);
        node.is_inside = cone.is_sphere() && (backs > BACKS_MAX || met >= ENCLOSED);
        node
    }
}

/// By leaf: whether anything outside the object sees it.
pub fn seen_leaves(world: &World, tree: &PatchTree, middle_m: Vec3, radius_m: f32) -> Vec<bool> {
    let mut is_seen = vec![false; tree.leaf_starts.len()];
    for number in 0..LOOKS {
        let from_m = middle_m + relight_direction(number, LOOKS) * (LOOK_RADII * radius_m);
        let cone = Cone::new(middle_m - from_m, radius_m, seed_of(&[u64::from(number), SEED]));
        for ray in 0..LOOK_RAYS {
            let direction = cone.direction(ray, LOOK_RAYS);
            let Some(hit) = world.geometry.tracer.met(from_m, direction, f32::INFINITY) else { continue };
            if let Surface::Receiver(receiver) = world.found_at(&hit, from_m + direction * hit.t).linked {
                is_seen[tree.leaf_of_receiver[receiver as usize] as usize] = true;
            }
        }
    }
    is_seen
}

/// Directions towards a ball: all of the sphere from within it.
struct Cone {
    axis: Vec3,
    across: [Vec3; 2],
    /// `1 − cosα`, α the half angle.
    height: f32,
    solid_angle: f32,
    turn: f32,
}

impl Cone {
    fn new(towards_m: Vec3, radius_m: f32, seed: u64) -> Self {
        let distance_m = towards_m.length();
        let sine = radius_m / distance_m.max(f32::MIN_POSITIVE);
        let height = if sine < 1.0 { sine * sine / (1.0 + (1.0 - sine * sine).sqrt()) } else { 2.0 };
        let axis = towards_m.normalize_or(Vec3::Y);
        let (x, y) = tangent_frame(axis);
        let turn = (seed >> 40) as f32 / (1_u64 << 24) as f32;
        Self { axis, across: [x, y], height, solid_angle: TAU * height, turn }
    }

    fn is_sphere(&self) -> bool {
        self.height >= 2.0
    }

    /// A point of the Fibonacci lattice on the cap, turned about its axis.
    fn direction(&self, index: u32, count: u32) -> Vec3 {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let below = self.height * ((index as f32 + 0.5) / count as f32);
        let along = (f64::from(index) * GOLDEN + f64::from(self.turn)).fract() as f32;
        let (sine, cosine) = libm::sincosf(TAU * along);
        let radius = (below * (2.0 - below)).max(0.0).sqrt();
        let [x, y] = self.across;
        (x * (radius * cosine) + y * (radius * sine) + self.axis * (1.0 - below)).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_fill_the_cap_evenly() {
        for (distance, radius) in [(0.5_f32, 1.0_f32), (1.5, 1.0), (40.0, 1.0)] {
            let cone = Cone::new(Vec3::new(0.3, 0.4, -0.866).normalize() * distance, radius, 7);
            let all: Vec<Vec3> = (0..4096).map(|index| cone.direction(index, 4096)).collect();
            let least = (1.0 - (radius / distance).min(1.0).powi(2)).sqrt()
                * if radius > distance { -1.0 } else { 1.0 };
            let sine = (radius / distance).min(1.0);
            let sum: Vec3 = all.iter().sum::<Vec3>() * (cone.solid_angle / 4096.0);
            let wanted = if radius > distance { 0.0 } else { std::f32::consts::PI * sine * sine };
            assert!((sum.length() - wanted).abs() < 0.01, "{sum} {wanted}");
            assert!(
                all.iter()
                    .all(|at| at.dot(cone.axis) >= if radius > distance { -1.001 } else { least - 1e-4 })
            );
        }
    }
}
