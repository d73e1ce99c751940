//! Triangles welded by position and measured.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};

use super::{MAX_INSTANCE_TEXELS, MAX_LATTICE_TEXELS, UnwrapError, UnwrapSettings};

/// Corner of a triangle that is left out.
const NO_POINT: u32 = u32::MAX;

/// Height relative to length, and height in texels, below which a triangle's normal is rounding noise.
const SLIVER_SHAPE: f64 = 1e-3;
const SLIVER_TEXELS: f64 = 2e-3;

/// World-space triangles whose corners are points welded by exact position.
pub(super) struct Soup {
    /// Distinct positions in metres.
    pub points_m: Vec<DVec3>,
    /// Points of each source triangle; meaningless where `area_m2` is 0.
    pub corners: Vec<[u32; 3]>,
    /// Unit geometric normals; zero for triangles that are left out.
    pub normals: Vec<DVec3>,
    /// Areas; 0 exactly for triangles that are left out.
    pub area_m2: Vec<f64>,
}

impl Soup {
    /// Welds corners of equal position (`-0.0` equals `0.0`) and measures triangles.
    pub fn new(positions_m: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let (points_m, point_of_vertex) = weld(positions_m);
        let mut soup = Self {
            points_m,
            corners: Vec::with_capacity(triangles.len()),
            normals: Vec::with_capacity(triangles.len()),
            area_m2: Vec::with_capacity(triangles.len()),
        };
        for triangle in triangles {
            soup.push(triangle.map(|v| point_of_vertex.get(v as usize).copied().unwrap_or(NO_POINT)));
        }
        soup
    }

    /// Number of source triangles, left-out ones included.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// Whether the triangle takes part.
    pub fn is_live(&self, triangle: u32) -> bool {
        self.area_m2[triangle as usize] > 0.0
    }

    /// Corner positions of a live triangle.
    pub fn positions_m(&self, triangle: u32) -> [DVec3; 3] {
        self.corners[triangle as usize].map(|p| self.points_m[p as usize])
    }

    /// Whether the triangle is a sliver whose normal means nothing: it may join any chart it borders on.
    pub fn is_sliver(&self, triangle: u32, texel_m: f32) -> bool {
        let longest_m = self.longest_edge_m(triangle);
        let height_m = 2.0 * self.area_m2[triangle as usize] / longest_m;
        height_m < SLIVER_SHAPE * longest_m && height_m < SLIVER_TEXELS * f64::from(texel_m)
    }

    /// Refuses surfaces with too many texels and vertices too far away.
    ///
    /// A sliver counts by its length: it may have no area and still cross any number of texels.
    pub fn check_limits(&self, settings: &UnwrapSettings) -> Result<(), UnwrapError> {
        let texel_m = settings.texel_m;
        for triangle in (0..self.len() as u32).filter(|&t| self.is_live(t)) {
            let far = self.positions_m(triangle).iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
            if far > MAX_LATTICE_TEXELS * f64::from(texel_m) {
                return Err(UnwrapError::TooFar { triangle, distance_m: far as f32, texel_m });
            }
        }
        let texels: f64 =
            (0..self.len() as u32).filter(|&t| self.is_live(t)).map(|t| self.texels(t, texel_m)).sum();
        if texels > MAX_INSTANCE_TEXELS as f64 {
            return Err(UnwrapError::TooLarge { texels: texels as u64, limit: MAX_INSTANCE_TEXELS, texel_m });
        }
        Ok(())
    }

    fn longest_edge_m(&self, triangle: u32) -> f64 {
        let [a, b, c] = self.positions_m(triangle);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    }

    /// Texels that a live triangle crosses, about.
    fn texels(&self, triangle: u32, texel_m: f32) -> f64 {
        let texel_m = f64::from(texel_m);
        (self.longest_edge_m(triangle) / texel_m).max(self.area_m2[triangle as usize] / (texel_m * texel_m))
    }

    fn push(&mut self, corners: [u32; 3]) {
        self.corners.push(corners);
        let doubled = if corners.contains(&NO_POINT) {
            DVec3::ZERO
        } else {
            let [a, b, c] = corners.map(|p| self.points_m[p as usize]);
            (b - a).cross(c - a)
        };
        let length = doubled.length();
        let live = length.is_finite() && length > 0.0;
        self.area_m2.push(if live { 0.5 * length } else { 0.0 });
        self.normals.push(if live { doubled / length } else { DVec3::ZERO });
    }
}

/// Distinct finite positions in ascending bit order, and the point of each vertex.
fn weld(positions_m: &[Vec3]) -> (Vec<DVec3>, Vec<u32>) {
    let key = |v: u32| (positions_m[v as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut order: Vec<u32> =
        (0..positions_m.len() as u32).filter(|&v| positions_m[v as usize].is_finite()).collect();
    order.sort_unstable_by(|&a, &b| match key(a).cmp(&key(b)) {
        Ordering::Equal => a.cmp(&b),
        unequal => unequal,
    });
    let mut points_m = Vec::new();
    let mut point_of_vertex = vec![NO_POINT; positions_m.len()];
    let mut previous = None;
    for vertex in order {
        if previous != Some(key(vertex)) {
            points_m.push((positions_m[vertex as usize] + Vec3::ZERO).as_dvec3());
            previous = Some(key(vertex));
        }
        point_of_vertex[vertex as usize] = points_m.len() as u32 - 1;
    }
    (points_m, point_of_vertex)
}
