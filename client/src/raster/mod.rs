//! A software rasteriser, the reference of the adapter's: clipping at the near plane, fill rule, perspective.
//!
//! Depth is reversed, as in the shaders: 1 at the near plane, 0 infinitely far. Positions are snapped to 1/256 pixel
//! like adapters do, so that edges of neighbouring triangles meet exactly.

mod camera;
mod clip;

use std::ops::Range;

use glam::{Vec2, Vec4};

pub use camera::{camera_clip_from_world, look_along, parallel, perspective};
use clip::{Corner, clip_near};

/// Subpixel positions per pixel.
const SUBPIXELS: f64 = 256.0;

/// A triangle on the screen, after clipping.
#[derive(Clone, Copy, Debug)]
pub struct ScreenTriangle {
    /// Index that its maker gave it.
    pub source: u32,
    /// Its front is seen.
    pub front: bool,
    x: [f64; 3],
    y: [f64; 3],
    /// Depth after division.
    depth: [f32; 3],
    inverse_w: [f32; 3],
    /// Barycentric coordinates of the corners in the triangle before clipping.
    barycentric: [Vec2; 3],
    inverse_area: f64,
}

/// A pixel of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Reversed depth.
    pub depth: f32,
    /// Perspective-correct weights of the second and third corner.
    pub barycentric: Vec2,
}

/// Clips a triangle given in clip space and appends the rest: 0, 1 or 2 triangles.
pub fn set_up(clip: [Vec4; 3], size: [u32; 2], source: u32, out: &mut Vec<ScreenTriangle>) {
    let corner = |index: usize, barycentric| Corner { clip: clip[index], barycentric };
    let corners = [corner(0, Vec2::ZERO), corner(1, Vec2::X), corner(2, Vec2::Y)];
    let (polygon, count) = clip_near(corners);
    for last in 2..count {
        out.extend(ScreenTriangle::new([polygon[0], polygon[last - 1], polygon[last]], size, source));
    }
}

impl ScreenTriangle {
    fn new(corners: [Corner; 3], size: [u32; 2], source: u32) -> Option<Self> {
        let [width, height] = size.map(f64::from);
        let snap = |pixels: f64| (pixels * SUBPIXELS).round() / SUBPIXELS;
        let inverse_w = corners.map(|corner| 1.0 / corner.clip.w);
        let x =
            std::array::from_fn(|i| snap(f64::from(0.5 + 0.5 * corners[i].clip.x * inverse_w[i]) * width));
        let y =
            std::array::from_fn(|i| snap(f64::from(0.5 - 0.5 * corners[i].clip.y * inverse_w[i]) * height));
        let mut this = Self {
            source,
            front: false,
            x,
            y,
            depth: std::array::from_fn(|i| corners[i].clip.z * inverse_w[i]),
            inverse_w,
            barycentric: corners.map(|corner| corner.barycentric),
            inverse_area: 0.0,
        };
        // Rows grow downwards, so a front (counter-clockwise seen) triangle has a negative area here.
        let area = this.edge(0, x[2], y[2]);
        if area == 0.0 || !area.is_finite() {
            return None;
        }
        this.front = area < 0.0;
        if this.front {
            this.swap_last_corners();
        }
        this.inverse_area = 1.0 / area.abs();
        this.touches(width, height).then_some(this)
    }

    fn swap_last_corners(&mut self) {
        self.x.swap(1, 2);
        self.y.swap(1, 2);
        self.depth.swap(1, 2);
        self.inverse_w.swap(1, 2);
        self.barycentric.swap(1, 2);
    }

    fn touches(&self, width: f64, height: f64) -> bool {
        let within = |v: &[f64; 3], end: f64| v.iter().any(|v| *v > 0.0) && v.iter().any(|v| *v < end);
        within(&self.x, width) && within(&self.y, height)
    }

    /// Twice the signed area of edge `edge` (from corner `edge` to the next) and a point; positive inside.
    fn edge(&self, edge: usize, x: f64, y: f64) -> f64 {
        let (a, b) = (edge, (edge + 1) % 3);
        (self.x[b] - self.x[a]) * (y - self.y[a]) - (self.y[b] - self.y[a]) * (x - self.x[a])
    }

    /// Points exactly on a top or left edge belong to the triangle.
    fn owns(&self, edge: usize) -> bool {
        let (a, b) = (edge, (edge + 1) % 3);
        let (dx, dy) = (self.x[b] - self.x[a], self.y[b] - self.y[a]);
        dy < 0.0 || (dy == 0.0 && dx > 0.0)
    }

    fn covers(&self, x: f64, y: f64) -> bool {
        (0..3).all(|edge| {
            let side = self.edge(edge, x, y);
            side > 0.0 || (side == 0.0 && self.owns(edge))
        })
    }

    /// Weights of the corners at a point of the screen, in pixels.
    fn weights(&self, x: f64, y: f64) -> [f32; 3] {
        let w0 = (self.edge(1, x, y) * self.inverse_area) as f32;
        let w1 = (self.edge(2, x, y) * self.inverse_area) as f32;
        [w0, w1, 1.0 - w0 - w1]
    }

    /// Perspective-correct weights of the source triangle's second and third corner at a point in pixels.
    pub fn barycentric_at(&self, x: f64, y: f64) -> Vec2 {
        let (mut sum, mut total) = (Vec2::ZERO, 0.0);
        for ((weight, inverse_w), barycentric) in
            self.weights(x, y).into_iter().zip(self.inverse_w).zip(self.barycentric)
        {
            sum += barycentric * weight * inverse_w;
            total += weight * inverse_w;
        }
        sum / total
    }

    /// Rows that the triangle may touch, within `rows`.
    fn row_range(&self, rows: &Range<u32>) -> Range<u32> {
        let low = self.y.iter().copied().fold(f64::INFINITY, f64::min).floor().max(f64::from(rows.start));
        let high = self.y.iter().copied().fold(f64::NEG_INFINITY, f64::max).ceil().min(f64::from(rows.end));
        low as u32..high as u32
    }

    /// Columns whose centres may be covered in the row with centre `y`; one more on either side.
    fn column_range(&self, y: f64, width: u32) -> Range<u32> {
        let (mut low, mut high) = (0.0_f64, f64::from(width));
        for edge in 0..3 {
            let (a, b) = (edge, (edge + 1) % 3);
            let dy = self.y[b] - self.y[a];
            if dy == 0.0 {
                continue;
            }
            let crossing = self.x[a] + (self.x[b] - self.x[a]) * (y - self.y[a]) / dy;
            if dy > 0.0 {
                high = high.min(crossing + 1.0);
            } else {
                low = low.max(crossing - 1.5);
            }
        }
        low.max(0.0) as u32..high.max(0.0).min(f64::from(width)).ceil() as u32
    }

    /// Calls `visit(x, y, fragment)` for every pixel whose centre is covered, in the given rows.
    pub fn rasterise(&self, width: u32, rows: Range<u32>, mut visit: impl FnMut(u32, u32, Fragment)) {
        for row in self.row_range(&rows) {
            let y = f64::from(row) + 0.5;
            for column in self.column_range(y, width) {
                let x = f64::from(column) + 0.5;
                if !self.covers(x, y) {
                    continue;
                }
                let weights = self.weights(x, y);
                let depth = (0..3).map(|corner| weights[corner] * self.depth[corner]).sum::<f32>();
                if depth >= 0.0 {
                    visit(column, row, Fragment { depth, barycentric: self.barycentric_at(x, y) });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn drawn(triangles: &[[Vec4; 3]], size: u32) -> Vec<u32> {
        let mut set = Vec::new();
        for (index, clip) in triangles.iter().enumerate() {
            set_up(*clip, [size, size], index as u32, &mut set);
        }
        let mut counts = vec![0; (size * size) as usize];
        for triangle in &set {
            triangle.rasterise(size, 0..size, |x, y, _| counts[(y * size + x) as usize] += 1);
        }
        counts
    }

    #[test]
    fn two_triangles_of_a_square_cover_every_pixel_once() {
        let at = |x: f32, y: f32| Vec4::new(x, y, 0.5, 1.0);
        let (a, b, c, d) = (at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0));
        for size in [1, 2, 17, 64] {
            let counts = drawn(&[[a, b, c], [a, c, d]], size);
            assert!(counts.iter().all(|count| *count == 1), "{size}: {counts:?}");
        }
    }

    #[test]
    fn a_fan_with_shared_edges_leaves_no_gap_and_no_overlap() {
        let rim: Vec<Vec4> = (0..13)
            .map(|i| (i as f32 * std::f32::consts::TAU / 13.0).sin_cos())
            .map(|(s, c)| Vec4::new(4.0 * c, 4.0 * s, 0.5, 1.0))
            .collect();
        let centre = Vec4::new(0.123, -0.071, 0.5, 1.0);
        let fan: Vec<[Vec4; 3]> = (0..13).map(|i| [centre, rim[i], rim[(i + 1) % 13]]).collect();
        assert!(drawn(&fan, 101).iter().all(|count| *count == 1));
    }

    #[test]
    fn barycentrics_are_those_of_the_point_in_space() {
        let clip_from_world = perspective(1.0, 1.0, 0.1) * look_along(Vec3::ZERO, Vec3::NEG_Z, Vec3::Y);
        let corners = [Vec3::new(-3.0, -1.0, -1.0), Vec3::new(4.0, -1.0, -9.0), Vec3::new(0.0, 5.0, 3.0)];
        let mut set = Vec::new();
        set_up(corners.map(|corner| clip_from_world * corner.extend(1.0)), [64, 64], 0, &mut set);
        let mut seen = 0;
        for triangle in &set {
            triangle.rasterise(64, 0..64, |x, y, fragment| {
                let [_, v, w] = [0.0, fragment.barycentric.x, fragment.barycentric.y];
                let point = corners[0] * (1.0 - v - w) + corners[1] * v + corners[2] * w;
                let clip = clip_from_world * point.extend(1.0);
                let (px, py) = (32.0 + 32.0 * clip.x / clip.w, 32.0 - 32.0 * clip.y / clip.w);
                assert!((px - x as f32 - 0.5).abs() < 0.02 && (py - y as f32 - 0.5).abs() < 0.02);
                assert!((clip.z / clip.w - fragment.depth).abs() < 1e-3);
                seen += 1;
            });
        }
        assert!(seen > 100, "{seen}");
    }

    #[test]
    fn degenerate_and_not_finite_triangles_are_dropped() {
        let p = Vec4::new(0.1, 0.2, 0.5, 1.0);
        let mut set = Vec::new();
        set_up([p, p, p], [8, 8], 0, &mut set);
        set_up([p, Vec4::NAN, p], [8, 8], 0, &mut set);
        set_up([p, Vec4::new(f32::INFINITY, 0.0, 0.5, 1.0), Vec4::ONE], [8, 8], 0, &mut set);
        assert!(set.is_empty());
    }
}
