//! Triangles of a block in its texels: the texels that they touch, and the part of each that they cover.

use glam::{UVec2, Vec2, Vec3};

use crate::unwrap::UnwrappedTriangle;

/// Index in a block of `size` texels, texel and low corner of each texel that a triangle may touch, row by row.
pub fn texels_of(
    corners: &[Vec2; 3],
    size: [u32; 2],
) -> impl Iterator<Item = (usize, [u16; 2], Vec2)> + use<> {
    let [a, b, c] = *corners;
    let last = UVec2::from(size) - 1;
    let low = a.min(b).min(c).floor().max(Vec2::ZERO).as_uvec2();
    let high = a.max(b).max(c).floor().max(Vec2::ZERO).as_uvec2();
    let (high, width) = (high.min(last), size[0]);
    (low.y..=high.y).flat_map(move |y| {
        (low.x..=high.x).map(move |x| {
            let place = y as usize * width as usize + x as usize;
            (place, [x as u16, y as u16], Vec2::new(x as f32, y as f32))
        })
    })
}

/// The triangle holds the point, on its rim too.
pub fn is_inside(corners: &[Vec2; 3], point: Vec2) -> bool {
    let [a, b, c] = *corners;
    let side = |from: Vec2, to: Vec2| (to - from).perp_dot(point - from);
    let (u, v, w) = (side(a, b), side(b, c), side(c, a));
    (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0)
}

/// The triangle cut by a box, as a polygon (Sutherland–Hodgman).
pub fn clipped(corners: &[Vec2; 3], low: Vec2, high: Vec2) -> Vec<Vec2> {
    let mut polygon = corners.to_vec();
    for axis in 0..2 {
        for (limit, sign) in [(low[axis], 1.0), (high[axis], -1.0)] {
            let inside = |point: Vec2| (point[axis] - limit) * sign;
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (index, &to) in polygon.iter().enumerate() {
                let from = polygon[(index + polygon.len() - 1) % polygon.len()];
                let (d_from, d_to) = (inside(from), inside(to));
                if (d_from < 0.0) != (d_to < 0.0) {
                    kept.push(from.lerp(to, d_from / (d_from - d_to)));
                }
                if d_to >= 0.0 {
                    kept.push(to);
                }
            }
            polygon = kept;
        }
    }
    polygon
}

/// Area and centroid of a convex polygon; of one without area, the mean of its corners. `None` when it is empty.
pub fn area_and_middle(polygon: &[Vec2]) -> Option<(f32, Vec2)> {
    let first = *polygon.first()?;
    let (mut doubled, mut moment) = (0.0, Vec2::ZERO);
    for pair in polygon[1..].windows(2) {
        let area = (pair[0] - first).perp_dot(pair[1] - first).abs();
        doubled += area;
        moment += (pair[0] + pair[1] + first) / 3.0 * area;
    }
    let mean = polygon.iter().sum::<Vec2>() / polygon.len() as f32;
    // Slivers may have no area in f32; they still get a receiver.
    Some(if doubled > 0.0 { (doubled * 0.5, moment / doubled) } else { (f32::MIN_POSITIVE, mean) })
}

/// Weights of the source triangle's corners at a point in texels.
pub fn source_weights(triangle: &UnwrappedTriangle, point: Vec2) -> [f32; 3] {
    let [a, b, c] = triangle.uv_texels.map(|corner| corner.as_dvec2());
    let point = point.as_dvec2();
    let area = (b - a).perp_dot(c - a);
    let inner = if area == 0.0 {
        [1.0, 0.0, 0.0]
    } else {
        let v = (point - a).perp_dot(c - a) / area;
        let w = (b - a).perp_dot(point - a) / area;
        [1.0 - v - w, v, w]
    };
    let mut weights = Vec3::from_array(inner.map(|weight| weight as f32));
    if let Some([p, q, r]) = triangle.piece_corners.as_deref() {
        weights = *p * weights.x + *q * weights.y + *r * weights.z;
    }
    weights = weights.max(Vec3::ZERO);
    (weights / weights.element_sum()).to_array()
}
