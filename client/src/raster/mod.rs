//! A software rasteriser, the reference of the adapter's: clipping at the near plane, fill rule, perspective.
//!
//! Depth is reversed, as in the shaders: 1 at the near plane, 0 infinitely far. Positions are f64 and are not snapped to
//! parts of a pixel, as adapters do it: a corner in the middle of another triangle's edge stays on it, and depth is as
//! exact far from the near plane as at it. Both triangles of a shared edge measure from the same end of it, so that each
//! pixel falls to one of them.

mod camera;
mod clip;

use std::ops::Range;

use glam::{DMat4, DVec2, DVec4, Mat4, Vec2};

pub use camera::{camera_clip_from_world, look_along, parallel, perspective};
use clip::{Corner, clip_near};

/// A triangle on the screen, after clipping.
#[derive(Clone, Copy, Debug)]
pub struct ScreenTriangle {
    /// Index that its maker gave it.
    pub source: u32,
    /// Its front is seen.
    pub front: bool,
    x: [f64; 3],
    y: [f64; 3],
    /// Per edge: measured from its end.
    from_end: [bool; 3],
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

/// Projects points in metres as exactly as their coordinates are.
pub fn projected(clip_from_world: Mat4) -> impl Fn([f32; 3]) -> DVec4 {
    let exact: DMat4 = clip_from_world.as_dmat4();
    move |position_m| exact * glam::Vec3::from(position_m).as_dvec3().extend(1.0)
}

/// Clips a triangle given in clip space and appends the rest: 0, 1 or 2 triangles.
pub fn set_up(clip: [DVec4; 3], size: [u32; 2], source: u32, out: &mut Vec<ScreenTriangle>) {
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
        let inverse_w = corners.map(|corner| 1.0 / corner.clip.w);
        let along = |i: usize, clip: f64| 0.5 + 0.5 * clip * inverse_w[i];
        let mut this = Self {
            source,
            front: false,
            x: std::array::from_fn(|i| along(i, corners[i].clip.x) * width),
            y: std::array::from_fn(|i| along(i, -corners[i].clip.y) * height),
            from_end: [false; 3],
            depth: std::array::from_fn(|i| (corners[i].clip.z * inverse_w[i]) as f32),
            inverse_w: inverse_w.map(|inverse_w| inverse_w as f32),
            barycentric: corners.map(|corner| corner.barycentric),
            inverse_area: 0.0,
        };
        // Rows grow downwards, so a front (counter-clockwise seen) triangle has a negative area here.
        let area = this.edge(0, this.x[2], this.y[2]);
        if area == 0.0 || !area.is_finite() {
            return None;
        }
        this.front = area < 0.0;
        if this.front {
            this.swap_last_corners();
        }
        this.inverse_area = 1.0 / area.abs();
        let at = |corner: usize| (this.x[corner], this.y[corner]);
        this.from_end = std::array::from_fn(|edge| at((edge + 1) % 3) < at(edge));
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
        let from = if self.from_end[edge] { b } else { a };
        (self.x[b] - self.x[a]) * (y - self.y[from]) - (self.y[b] - self.y[a]) * (x - self.x[from])
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

    /// Weights of the corners at a point of the screen, in pixels. The corner at the near plane outweighs the others, so
    /// that f32 would lose them.
    fn weights(&self, x: f64, y: f64) -> [f64; 3] {
        let w0 = self.edge(1, x, y) * self.inverse_area;
        let w1 = self.edge(2, x, y) * self.inverse_area;
        [w0, w1, 1.0 - w0 - w1]
    }

    /// Perspective-correct weights of the source triangle's second and third corner at a point in pixels.
    pub fn barycentric_at(&self, x: f64, y: f64) -> Vec2 {
        let (mut sum, mut total) = (DVec2::ZERO, 0.0);
        for ((weight, inverse_w), barycentric) in
            self.weights(x, y).into_iter().zip(self.inverse_w).zip(self.barycentric)
        {
            let share = weight * f64::from(inverse_w);
            sum += barycentric.as_dvec2() * share;
            total += share;
        }
        (sum / total).as_vec2()
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
                let depth =
                    (0..3).map(|corner| weights[corner] * f64::from(self.depth[corner])).sum::<f64>() as f32;
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
    use glam::{DVec4, Vec3};

    fn drawn(triangles: &[[DVec4; 3]], size: u32) -> Vec<u32> {
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
        let at = |x: f64, y: f64| DVec4::new(x, y, 0.5, 1.0);
        let (a, b, c, d) = (at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0));
        for size in [1, 2, 17, 64] {
            let counts = drawn(&[[a, b, c], [a, c, d]], size);
            assert!(counts.iter().all(|count| *count == 1), "{size}: {counts:?}");
        }
    }

    #[test]
    fn a_fan_with_shared_edges_leaves_no_gap_and_no_overlap() {
        let rim: Vec<DVec4> = (0..13)
            .map(|i| (i as f64 * std::f64::consts::TAU / 13.0).sin_cos())
            .map(|(s, c)| DVec4::new(4.0 * c, 4.0 * s, 0.5, 1.0))
            .collect();
        let centre = DVec4::new(0.123, -0.071, 0.5, 1.0);
        let fan: Vec<[DVec4; 3]> = (0..13).map(|i| [centre, rim[i], rim[(i + 1) % 13]]).collect();
        assert!(drawn(&fan, 101).iter().all(|count| *count == 1));
    }

    #[test]
    fn barycentrics_are_those_of_the_point_in_space() {
        let clip_from_world = perspective(1.0, 1.0, 0.1) * look_along(Vec3::ZERO, Vec3::NEG_Z, Vec3::Y);
        let corners = [Vec3::new(-3.0, -1.0, -1.0), Vec3::new(4.0, -1.0, -9.0), Vec3::new(0.0, 5.0, 3.0)];
        let mut set = Vec::new();
        set_up(corners.map(|corner| projected(clip_from_world)(corner.into())), [64, 64], 0, &mut set);
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
    fn sheets_that_meet_along_a_line_leave_no_pixel_between_them() {
        // The left one's edge is whole, the right one's is cut into pieces; both go through the near plane.
        let edge = |share: f32| Vec3::new(0.25, -1.0, 8.0) + share * Vec3::new(0.5, 3.0, -16.0);
        for turn in 0..40 {
            let (sin, cos) = (0.1 + 0.013 * turn as f32).sin_cos();
            let clip_from_world = perspective(1.0, 1.0, 1e-3)
                * look_along(Vec3::new(0.1 * sin, 0.2, 0.0), Vec3::new(0.3 * sin, sin - 0.2, -cos), Vec3::Y);
            let at = |point: Vec3| projected(clip_from_world)(point.into());
            let far = |share: f32, side: f32| edge(share) + 60.0 * side * Vec3::X;
            let mut sheets = vec![[at(edge(0.0)), at(edge(1.0)), at(far(1.0, -1.0))]];
            sheets.push([at(edge(0.0)), at(far(1.0, -1.0)), at(far(0.0, -1.0))]);
            for piece in 0..8 {
                let (from, to) = (piece as f32 / 8.0, (piece + 1) as f32 / 8.0);
                sheets.push([at(edge(from)), at(far(from, 1.0)), at(far(to, 1.0))]);
                sheets.push([at(edge(from)), at(far(to, 1.0)), at(edge(to))]);
            }
            let counts = drawn(&sheets, 256);
            // Beyond the sheets' other rims there is nothing: the covered part of a row has no end within it.
            let ends = |row: &[u32]| row.windows(2).filter(|pair| (pair[0] > 0) != (pair[1] > 0)).count();
            let cut = counts.chunks(256).filter(|row| ends(row) > 1).count();
            assert!(counts.iter().sum::<u32>() > 20_000, "{turn}");
            assert_eq!(cut, 0, "{turn}");
        }
    }

    #[test]
    fn depth_of_a_plane_is_exact_however_near_its_corner() {
        // Ground 1 m below the eye, whose near plane cuts its triangle.
        let clip_from_world = perspective(1.0, 1.0, 1e-3) * look_along(Vec3::ZERO, Vec3::NEG_Z, Vec3::Y);
        let corners =
            [Vec3::new(-40.0, -1.0, -29.3), Vec3::new(0.7, -1.0, 33.1), Vec3::new(37.0, -1.0, -31.0)];
        let (mut set, mut seen) = (Vec::new(), 0);
        set_up(corners.map(|corner| projected(clip_from_world)(corner.into())), [512, 512], 0, &mut set);
        for triangle in &set {
            triangle.rasterise(512, 0..512, |_, y, fragment| {
                // The pixel's ray falls by so much per metre.
                let fall = (f64::from(y) + 0.5 - 256.0) / 256.0;
                let off = f64::from(fragment.depth) / (1e-3 * fall) - 1.0;
                assert!(off.abs() < 1e-6, "row {y}: {off}");
                seen += 1;
            });
        }
        assert!(seen > 50_000, "{seen}");
    }

    #[test]
    fn degenerate_and_not_finite_triangles_are_dropped() {
        let p = DVec4::new(0.1, 0.2, 0.5, 1.0);
        let mut set = Vec::new();
        set_up([p, p, p], [8, 8], 0, &mut set);
        set_up([p, DVec4::NAN, p], [8, 8], 0, &mut set);
        set_up([p, DVec4::new(f64::INFINITY, 0.0, 0.5, 1.0), DVec4::ONE], [8, 8], 0, &mut set);
        assert!(set.is_empty());
    }
}
