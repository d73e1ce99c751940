//! Coplanar regions: the parts of a chart's triangles in a texel that lie in one plane, together.

use glam::{Vec2, Vec3};

use crate::lightmap::polygon::{area_and_middle, clipped, is_inside, texels_of};
use crate::task::{Cancelled, Progress};
use crate::unwrap::UnwrapBlock;

/// Cosine between triangles from which on they are of one face.
const COPLANAR_COSINE_MIN: f32 = 0.996;

/// A coplanar region of a chart in a texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoplanarRegion {
    /// Index of the texel in the block.
    pub place: usize,
    /// Index of the block's triangle that `point` lies on.
    pub triangle: u32,
    /// Its middle; where no triangle of it holds that, the middle of the largest part.
    pub point: Vec2,
    /// Its area in texels.
    pub area: f32,
    /// Its width in texels: the area over the greatest extent along an axis.
    pub width: f32,
}

/// A triangle's part of a texel.
#[derive(Clone, Copy)]
struct Part {
    place: usize,
    triangle: u32,
    area: f32,
    middle: Vec2,
    low: Vec2,
    high: Vec2,
}

/// Regions of the chart that `chart_of` names for each texel, ascending by texel and from the largest to the smallest.
/// `normal` is that of the face of a triangle of the block.
pub fn coplanar_regions(
    block: &UnwrapBlock,
    chart_of: impl Fn(usize) -> Option<u32>,
    normal: impl Fn(u32) -> Vec3,
    progress: &Progress,
) -> Result<Vec<CoplanarRegion>, Cancelled> {
    let mut parts = Vec::new();
    for (index, triangle) in block.triangles.iter().enumerate() {
        progress.check()?;
        for (place, _, corner) in texels_of(&triangle.uv_texels, [block.width, block.height]) {
            if chart_of(place) != Some(triangle.chart) {
                continue;
            }
            let polygon = clipped(&triangle.uv_texels, corner, corner + 1.0);
            let Some((area, middle)) = area_and_middle(&polygon) else { continue };
            let low = polygon.iter().copied().reduce(Vec2::min).unwrap_or(middle);
            let high = polygon.iter().copied().reduce(Vec2::max).unwrap_or(middle);
            parts.push(Part { place, triangle: index as u32, area, middle, low, high });
        }
    }
    parts.sort_by(|a, b| {
        let largest_first = b.area.total_cmp(&a.area);
        a.place.cmp(&b.place).then(largest_first).then(a.triangle.cmp(&b.triangle))
    });
    let mut regions = Vec::new();
    for of_texel in parts.chunk_by(|a, b| a.place == b.place) {
        progress.check()?;
        let mut faces: Vec<(Vec3, Vec<Part>)> = Vec::new();
        for part in of_texel {
            let own = normal(part.triangle);
            match faces.iter_mut().find(|(of_face, _)| of_face.dot(own) >= COPLANAR_COSINE_MIN) {
                Some((_, parts)) => parts.push(*part),
                None => faces.push((own, vec![*part])),
            }
        }
        let mut of_texel: Vec<CoplanarRegion> =
            faces.iter().map(|(_, parts)| region_of(block, parts)).collect();
        of_texel.sort_by(|a, b| b.area.total_cmp(&a.area).then(a.triangle.cmp(&b.triangle)));
        regions.extend(of_texel);
    }
    Ok(regions)
}

/// Parts of one face, the largest first, as one.
fn region_of(block: &UnwrapBlock, parts: &[Part]) -> CoplanarRegion {
    let largest = parts[0];
    let area: f32 = parts.iter().map(|part| part.area).sum();
    let middle = parts.iter().map(|part| part.middle * (part.area / area)).sum();
    let extent = parts.iter().fold(largest.high, |high, part| high.max(part.high))
        - parts.iter().fold(largest.low, |low, part| low.min(part.low));
    let width = if extent.max_element() > 0.0 { area / extent.max_element() } else { 0.0 };
    // Those without area hold points that are far off.
    let holds = |part: &&Part| {
        part.area > f32::MIN_POSITIVE && is_inside(&block.triangles[part.triangle as usize].uv_texels, middle)
    };
    let (triangle, point) =
        parts.iter().find(holds).map_or((largest.triangle, largest.middle), |part| (part.triangle, middle));
    CoplanarRegion { place: largest.place, triangle, point, area, width }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::unwrap::UnwrappedTriangle;

    fn block(triangles: &[[Vec2; 3]]) -> UnwrapBlock {
        let of_chart = |(index, uv): (usize, &[Vec2; 3])| UnwrappedTriangle {
            source_triangle: index as u32,
            chart: 0,
            uv_texels: *uv,
            piece_corners: None,
        };
        let triangles = triangles.iter().enumerate().map(of_chart).collect();
        UnwrapBlock { texel_m: 1.0, width: 4, height: 4, triangles }
    }

    fn rectangle(low: Vec2, high: Vec2) -> [[Vec2; 3]; 2] {
        let (a, b) = (Vec2::new(high.x, low.y), Vec2::new(low.x, high.y));
        [[low, a, high], [low, high, b]]
    }

    /// Regions in the texel in the middle.
    fn regions_of(triangles: &[[Vec2; 3]], normal: impl Fn(u32) -> Vec3) -> Vec<CoplanarRegion> {
        let in_middle = |place: usize| (place == 5).then_some(0);
        coplanar_regions(&block(triangles), in_middle, normal, &Progress::new()).unwrap()
    }

    #[test]
    fn triangles_of_one_face_are_one_region_whatever_the_diagonal() {
        let (low, high) = (Vec2::new(1.0, 1.2), Vec2::new(2.0, 1.3));
        let [first, second] = rectangle(low, high);
        let flip = |corners: [Vec2; 3]| corners.map(|corner| Vec2::new(3.0 - corner.x, corner.y));
        for triangles in [[first, second], [flip(first), flip(second)]] {
            let found = regions_of(&triangles, |_| Vec3::Y);
            let [region] = found[..] else { panic!("{found:?}") };
            assert!(region.point.distance(Vec2::new(1.5, 1.25)) < 1e-5, "{region:?}");
            assert!((region.area - 0.1).abs() < 1e-5 && (region.width - 0.1).abs() < 1e-5, "{region:?}");
        }
    }

    #[test]
    fn faces_that_bend_are_regions_apart_and_the_larger_comes_first() {
        let narrow = rectangle(Vec2::new(1.0, 1.0), Vec2::new(2.0, 1.25));
        let wide = rectangle(Vec2::new(1.0, 1.25), Vec2::new(2.0, 1.75));
        let triangles = [narrow[0], narrow[1], wide[0], wide[1]];
        let normal = |triangle: u32| if triangle < 2 { Vec3::Y } else { Vec3::new(0.0, 0.8, 0.6) };
        let found = regions_of(&triangles, normal);
        let middles: Vec<Vec2> = found.iter().map(|region| region.point).collect();
        assert_eq!(middles.len(), 2);
        assert!(middles[0].distance(Vec2::new(1.5, 1.5)) < 1e-5, "{middles:?}");
        assert!(middles[1].distance(Vec2::new(1.5, 1.125)) < 1e-5, "{middles:?}");
    }

    #[test]
    fn triangles_without_area_hold_no_point() {
        let [first, second] = rectangle(Vec2::new(1.0, 1.0), Vec2::new(2.0, 1.5));
        let needle = [Vec2::new(1.5, 0.0), Vec2::new(1.5, 1.25), Vec2::new(1.5, 3.0)];
        let found = regions_of(&[needle, first, second], |_| Vec3::Y);
        assert_eq!(found.len(), 1);
        assert_ne!(found[0].triangle, 0);
    }
}
