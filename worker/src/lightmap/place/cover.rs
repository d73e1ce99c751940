//! Step "cover": which texels of a block hold surface, and the central point of each.

use std::collections::BTreeMap;

use glam::{Vec2, Vec3};

use super::regions::{CoplanarRegion, coplanar_regions};
use crate::lightmap::polygon::{area_and_middle, clipped, is_inside, source_weights, texels_of};
use crate::task::{Cancelled, Progress};
use crate::unwrap::{UnwrapBlock, UnwrappedTriangle};

/// Least width of a coplanar region, in texels, for a receiver of its own though a neighbour could stand for the texel:
/// points beside a rim see past the wall that meets it there.
const APART_WIDTH_MIN: f32 = 1.0 / 32.0;

/// A point of the surface in a texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelPoint {
    /// Texel in the block.
    pub texel: [u16; 2],
    /// Triangle of the instance.
    pub triangle: u32,
    /// Weights of its corners.
    pub weights: [f32; 3],
}

/// The texels of a block, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coverage {
    /// Texels with a receiver, in raster order.
    pub covered: Vec<TexelPoint>,
    /// For each texel, index into `covered` of the one that stands for it, or `u32::MAX`.
    pub stands_for: Vec<u32>,
    /// Of each texel that another stands for, the middles of its chart's coplanar regions there, in the raster's order and
    /// from the largest region to the smallest, without mere rims.
    pub touched: Vec<TexelPoint>,
}

impl Coverage {
    /// Index of a texel of a block that is `width` texels wide into `stands_for`.
    pub fn place(texel: [u16; 2], width: u32) -> usize {
        usize::from(texel[1]) * width as usize + usize::from(texel[0])
    }

    /// Lets touched texels stand for themselves. `with` holds a value for each of `covered`, and stays in step with it.
    pub fn set_apart<T: Copy>(&mut self, apart: &[(TexelPoint, T)], with: &mut Vec<T>, width: u32) {
        for (point, value) in apart {
            self.stands_for[Self::place(point.texel, width)] = self.covered.len() as u32;
            self.covered.push(*point);
            with.push(*value);
        }
        let mut order: Vec<usize> = (0..self.covered.len()).collect();
        order.sort_by_key(|&index| Self::place(self.covered[index].texel, width));
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, &old)| rank[old] = new as u32);
        self.covered = order.iter().map(|&old| self.covered[old]).collect();
        *with = order.iter().map(|&old| with[old]).collect();
        for index in self.stands_for.iter_mut().filter(|index| **index != u32::MAX) {
            *index = rank[*index as usize];
        }
    }
}

/// Share of the area that a chart has in a neighbour's texel, below which it has a mere rim in a texel that it touches.
const RIM_SHARE_MAX: f32 = 0.5;

#[derive(Clone, Copy)]
struct Claim {
    /// Index into the block's triangles, or `u32::MAX`.
    triangle: u32,
    /// The texel's centre is inside the triangle.
    centred: bool,
    /// Area of the triangle inside the texel, in texels.
    area: f32,
    /// Central point: the texel's centre, or the middle of the triangle's part of it.
    point: Vec2,
}

impl Claim {
    /// A triangle has a part of the texel, and not its centre.
    fn is_touched(&self) -> bool {
        self.triangle != u32::MAX && !self.centred
    }
}

const UNCLAIMED: Claim = Claim { triangle: u32::MAX, centred: false, area: 0.0, point: Vec2::ZERO };

/// Finds the receivers' texels.
///
/// A texel whose centre lies in a triangle has a receiver there. A texel that a chart only touches has one too unless a
/// neighbour of the same chart has one and much more of the chart: so strips have a receiver in every texel along them, and
/// light goes on smoothly there. Others are stood for by the nearest such neighbour.
///
/// A texel that holds no centre of its own has its point in the middle of the largest face that the chart has there, not
/// of a triangle, whose middle wanders across a strip with its diagonals. `normal` is that of a source triangle's face.
pub fn cover(
    block: &UnwrapBlock,
    normal: impl Fn(u32) -> Vec3,
    progress: &Progress,
) -> Result<Coverage, Cancelled> {
    let mut claims = claim_texels(block, progress)?;
    let chart_of = |place: usize| {
        let Claim { triangle, centred, .. } = claims[place];
        (triangle != u32::MAX && !centred).then(|| block.triangles[triangle as usize].chart)
    };
    let normal_of = |index: u32| normal(block.triangles[index as usize].source_triangle);
    let regions = coplanar_regions(block, chart_of, normal_of, progress)?;
    for largest in regions.chunk_by(|a, b| a.place == b.place).map(|regions| regions[0]) {
        let claim = &mut claims[largest.place];
        (claim.triangle, claim.point, claim.area) = (largest.triangle, largest.point, largest.area);
    }
    let (width, height) = (block.width as i64, block.height as i64);
    let chart = |index: usize| {
        let triangle = claims[index].triangle;
        (triangle != u32::MAX).then(|| block.triangles[triangle as usize].chart)
    };
    let mut has_receiver: Vec<bool> = claims.iter().map(|claim| claim.centred).collect();
    let mut stand_in = vec![u32::MAX; claims.len()];
    let mut touched: Vec<usize> = (0..claims.len()).filter(|&i| claims[i].is_touched()).collect();
    touched.sort_by(|&a, &b| claims[b].area.total_cmp(&claims[a].area).then(a.cmp(&b)));
    for index in touched {
        progress.check()?;
        let (x, y) = (index as i64 % width, index as i64 / width);
        let neighbours = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
        let has_much_more = |other: &Claim| other.centred || claims[index].area < RIM_SHARE_MAX * other.area;
        let nearest = neighbours
            .filter(|&(x, y)| x >= 0 && y >= 0 && x < width && y < height)
            .map(|(x, y)| (y * width + x) as usize)
            .filter(|&other| has_receiver[other] && chart(other) == chart(index))
            .filter(|&other| has_much_more(&claims[other]))
            .min_by(|&a, &b| {
                let distance = |other: usize| claims[other].point.distance_squared(claims[index].point);
                distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
            });
        match nearest {
            Some(other) => stand_in[index] = other as u32,
            None => has_receiver[index] = true,
        }
    }
    progress.check()?;
    Ok(collect(block, &claims, &has_receiver, &stand_in, &regions))
}

/// Where other points of a texel lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spread {
    /// All over the texel, and in the middles of triangles' parts of it.
    OverTexel,
    /// All over each triangle's part of it, however narrow.
    OverParts,
}

/// Other points of some texels that could stand for them: for each of `wanted` (ascending texels with a triangle of
/// the chart that they belong to), points of that chart's triangles inside the texel, in a fixed order.
///
/// Errors when `check` does, which is asked again and again.
pub fn other_points<E>(
    block: &UnwrapBlock,
    wanted: &[TexelPoint],
    spread: Spread,
    check: impl Fn() -> Result<(), E>,
) -> Result<Vec<Vec<TexelPoint>>, E> {
    let mut found = vec![Vec::new(); wanted.len()];
    if wanted.is_empty() {
        return Ok(found);
    }
    let chart_of: BTreeMap<u32, u32> = block.triangles.iter().map(|t| (t.source_triangle, t.chart)).collect();
    let order = |texel: [u16; 2]| (texel[1], texel[0]);
    for triangle in &block.triangles {
        check()?;
        for (_, texel, corner) in texels_of(&triangle.uv_texels, [block.width, block.height]) {
            let place = wanted.binary_search_by_key(&order(texel), |covered| order(covered.texel));
            let Ok(place) = place else { continue };
            if chart_of.get(&wanted[place].triangle) == Some(&triangle.chart) {
                let points = match spread {
                    Spread::OverTexel => points_inside(&triangle.uv_texels, corner),
                    Spread::OverParts => points_of_part(&triangle.uv_texels, corner),
                };
                found[place].extend(points.into_iter().map(|point| TexelPoint {
                    texel,
                    triangle: triangle.source_triangle,
                    weights: source_weights(triangle, point),
                }));
            }
        }
    }
    Ok(found)
}

/// Area of the surface that reads each covered texel: of each triangle's `area`, the share in texels that it stands for.
pub fn areas(
    block: &UnwrapBlock,
    coverage: &Coverage,
    area: impl Fn(&UnwrappedTriangle) -> f32,
    progress: &Progress,
) -> Result<Vec<f32>, Cancelled> {
    let mut areas = vec![0.0; coverage.covered.len()];
    for triangle in &block.triangles {
        progress.check()?;
        let mut found: Vec<(u32, f32)> = Vec::new();
        for (place, _, corner) in texels_of(&triangle.uv_texels, [block.width, block.height]) {
            let polygon = clipped(&triangle.uv_texels, corner, corner + 1.0);
            let covered = coverage.stands_for[place];
            if let (Some((part, _)), true) = (area_and_middle(&polygon), covered != u32::MAX) {
                found.push((covered, part));
            }
        }
        // Shares of the parts found, so that slivers collapsed in the block count with their whole area.
        let all: f32 = found.iter().map(|(_, part)| part).sum();
        let whole = area(triangle);
        found.into_iter().for_each(|(covered, part)| areas[covered as usize] += whole * (part / all));
    }
    Ok(areas)
}

/// The middle of a triangle's part of the texel at `corner`, and those points of a grid in the texel, and on its very rim,
/// that the triangle holds: often no more of a texel than a strip along one side is seen, or a corner.
fn points_inside(corners: &[Vec2; 3], corner: Vec2) -> Vec<Vec2> {
    const RIM: [f32; 3] = [1.0 / 16.0, 0.5, 15.0 / 16.0];
    let middle = area_and_middle(&clipped(corners, corner, corner + 1.0)).map(|(_, middle)| middle);
    let rim =
        RIM.into_iter().flat_map(|y| RIM.map(|x| Vec2::new(x, y))).filter(|point| *point != Vec2::splat(0.5));
    let held = grid().chain(rim).map(|point| corner + point).filter(|&point| is_inside(corners, point));
    middle.into_iter().chain(held).collect()
}

/// Points of a grid over a triangle's part of the texel at `corner`: what is seen of a strip may be narrower than the texel's
/// own grid.
fn points_of_part(corners: &[Vec2; 3], corner: Vec2) -> Vec<Vec2> {
    let part = clipped(corners, corner, corner + 1.0);
    let Some(&first) = part.first() else { return Vec::new() };
    let [low, high] = part.iter().fold([first; 2], |[low, high], &at| [low.min(at), high.max(at)]);
    grid().map(|at| low + (high - low) * at).filter(|&point| is_inside(corners, point)).collect()
}

/// Middles of the cells of a unit square.
fn grid() -> impl Iterator<Item = Vec2> {
    const SIDE: u32 = 4;
    (0..SIDE * SIDE).map(|i| (Vec2::new((i % SIDE) as f32, (i / SIDE) as f32) + 0.5) / SIDE as f32)
}

fn collect(
    block: &UnwrapBlock,
    claims: &[Claim],
    has_receiver: &[bool],
    stand_in: &[u32],
    regions: &[CoplanarRegion],
) -> Coverage {
    let covered_at = |place: usize, triangle: u32, point: Vec2| {
        let triangle = &block.triangles[triangle as usize];
        TexelPoint {
            texel: [(place % block.width as usize) as u16, (place / block.width as usize) as u16],
            triangle: triangle.source_triangle,
            weights: source_weights(triangle, point),
        }
    };
    let mut coverage = Coverage { stands_for: vec![u32::MAX; claims.len()], ..Coverage::default() };
    for (place, claim) in claims.iter().enumerate().filter(|(place, _)| has_receiver[*place]) {
        coverage.stands_for[place] = coverage.covered.len() as u32;
        coverage.covered.push(covered_at(place, claim.triangle, claim.point));
    }
    for (place, &other) in stand_in.iter().enumerate().filter(|(_, other)| **other != u32::MAX) {
        coverage.stands_for[place] = coverage.stands_for[other as usize];
    }
    let touched =
        regions.iter().filter(|region| stand_in[region.place] != u32::MAX && region.width >= APART_WIDTH_MIN);
    coverage.touched = touched.map(|r| covered_at(r.place, r.triangle, r.point)).collect();
    coverage
}

/// The best claim on each texel: centred before touching, then the largest area, then the earliest triangle.
fn claim_texels(block: &UnwrapBlock, progress: &Progress) -> Result<Vec<Claim>, Cancelled> {
    let mut claims = vec![UNCLAIMED; block.width as usize * block.height as usize];
    for (index, triangle) in block.triangles.iter().enumerate() {
        progress.check()?;
        for (place, _, corner) in texels_of(&triangle.uv_texels, [block.width, block.height]) {
            let Some(found) = claim_of(index as u32, &triangle.uv_texels, corner) else { continue };
            let claim = &mut claims[place];
            if (found.centred, found.area) > (claim.centred, claim.area) && !claim.centred {
                *claim = found;
            }
        }
    }
    Ok(claims)
}

/// A triangle's claim on the texel at `corner`.
///
/// Where it does not hold the centre, its point is the middle of the covered part and not the nearest point: that would lie
/// on the triangle's rim, often just inside of the thing that the surface stands on.
fn claim_of(triangle: u32, corners: &[Vec2; 3], corner: Vec2) -> Option<Claim> {
    let centre = corner + 0.5;
    if is_inside(corners, centre) {
        return Some(Claim { triangle, centred: true, area: 1.0, point: centre });
    }
    let covered = clipped(corners, corner, corner + 1.0);
    let (area, point) = area_and_middle(&covered)?;
    Some(Claim { triangle, centred: false, area, point })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(triangles: &[[Vec2; 3]]) -> UnwrapBlock {
        let triangles = triangles
            .iter()
            .enumerate()
            .map(|(index, uv)| UnwrappedTriangle {
                source_triangle: index as u32,
                chart: index as u32,
                uv_texels: *uv,
                piece_corners: None,
            })
            .collect();
        UnwrapBlock { texel_m: 1.0, width: 8, height: 8, triangles }
    }

    fn cover_flat(block: &UnwrapBlock) -> Coverage {
        cover(block, |_| Vec3::Y, &Progress::new()).unwrap()
    }

    #[test]
    fn quad_on_the_lattice_covers_its_texels_and_no_other() {
        let (low, high) = (Vec2::new(2.0, 2.0), Vec2::new(5.0, 4.0));
        let (a, b) = (Vec2::new(high.x, low.y), Vec2::new(low.x, high.y));
        let coverage = cover_flat(&block(&[[low, a, high], [low, high, b]]));
        assert_eq!(coverage.covered.len(), 6);
        assert!(
            coverage.covered.iter().all(|t| (2..5).contains(&t.texel[0]) && (2..4).contains(&t.texel[1]))
        );
    }

    #[test]
    fn sliver_between_centres_still_gets_a_receiver_on_itself() {
        let coverage =
            cover_flat(&block(&[[Vec2::new(2.6, 1.1), Vec2::new(2.7, 1.1), Vec2::new(2.65, 4.9)]]));
        assert!(!coverage.covered.is_empty());
        for texel in &coverage.covered {
            assert!(texel.weights.iter().all(|w| (0.0..=1.0).contains(w)));
        }
    }

    #[test]
    fn touched_texel_is_stood_for_by_its_neighbour() {
        let coverage = cover_flat(&block(&[[Vec2::new(1.2, 1.2), Vec2::new(6.4, 1.2), Vec2::new(1.2, 6.4)]]));
        let touched = coverage.stands_for.iter().filter(|&&index| index != u32::MAX).count();
        assert!(touched > coverage.covered.len());
        assert!(coverage.stands_for.iter().all(|&i| i == u32::MAX || (i as usize) < coverage.covered.len()));
    }

    #[test]
    fn texels_set_apart_stand_for_themselves_in_order_of_the_raster() {
        let block = block(&[[Vec2::new(1.2, 1.2), Vec2::new(6.4, 1.2), Vec2::new(1.2, 6.4)]]);
        let before = cover_flat(&block);
        let mut after = before.clone();
        let mut with: Vec<[u16; 2]> = before.covered.iter().map(|covered| covered.texel).collect();
        let largest = before.touched.chunk_by(|a, b| a.texel == b.texel).map(|regions| regions[0]);
        let apart: Vec<(TexelPoint, [u16; 2])> = largest.map(|point| (point, point.texel)).collect();
        assert!(!apart.is_empty());
        after.set_apart(&apart, &mut with, block.width);
        let places: Vec<usize> =
            after.covered.iter().map(|covered| Coverage::place(covered.texel, block.width)).collect();
        assert!(places.is_sorted() && places.len() == before.covered.len() + apart.len());
        assert!(after.covered.iter().zip(&with).all(|(covered, texel)| covered.texel == *texel));
        for (index, place) in places.iter().enumerate() {
            assert_eq!(after.stands_for[*place], index as u32);
        }
    }

    #[test]
    fn points_along_a_strip_lie_in_its_middle_whatever_its_diagonal() {
        let [low, high] = [Vec2::new(1.0, 2.1), Vec2::new(6.0, 2.4)];
        let mut both = block(&[[low, Vec2::new(high.x, low.y), high], [low, high, Vec2::new(low.x, high.y)]]);
        both.triangles[1].chart = both.triangles[0].chart;
        let covered = cover_flat(&both).covered;
        assert_eq!(covered.len(), 5, "one in every texel along the strip");
        for texel in &covered {
            let corners = both.triangles[texel.triangle as usize].uv_texels;
            let point: Vec2 =
                corners.iter().zip(texel.weights).map(|(corner, weight)| *corner * weight).sum();
            assert!((point.y - 2.25).abs() < 1e-5, "{point}");
            assert!((point.x.fract() - 0.5).abs() < 1e-5, "{point}");
        }
    }

    #[test]
    fn points_over_parts_lie_all_over_a_strip_that_the_grid_of_the_texel_steps_over() {
        let [low, high] = [Vec2::new(1.0, 2.14), Vec2::new(2.0, 2.36)];
        let mut both = block(&[[low, Vec2::new(high.x, low.y), high], [low, high, Vec2::new(low.x, high.y)]]);
        both.triangles[1].chart = both.triangles[0].chart;
        let wanted = cover_flat(&both).covered;
        let lowest = |spread: Spread| {
            let place = |point: &TexelPoint| -> f32 {
                let corners = both.triangles[point.triangle as usize].uv_texels;
                corners.iter().zip(point.weights).map(|(corner, weight)| corner.y * weight).sum()
            };
            other_points(&both, &wanted, spread, || Progress::new().check()).unwrap()[0]
                .iter()
                .map(place)
                .fold(f32::INFINITY, f32::min)
        };
        assert!(lowest(Spread::OverTexel) > 2.2 && lowest(Spread::OverParts) < 2.18);
    }

    #[test]
    fn region_no_wider_than_a_rim_is_not_set_apart() {
        let strip = |width: f32| {
            let [low, high] = [Vec2::new(2.0, 2.0), Vec2::new(4.0 + width, 5.0)];
            let mut both =
                block(&[[low, Vec2::new(high.x, low.y), high], [low, high, Vec2::new(low.x, high.y)]]);
            both.triangles[1].chart = both.triangles[0].chart;
            cover_flat(&both).touched.chunk_by(|a, b| a.texel == b.texel).count()
        };
        assert_eq!([strip(0.2), strip(0.01)], [3, 0]);
    }

    #[test]
    fn other_points_of_a_texel_lie_in_its_chart() {
        let strip = [Vec2::new(1.0, 1.0), Vec2::new(1.9, 1.0), Vec2::new(1.0, 1.9)];
        let rest = [Vec2::new(1.9, 1.0), Vec2::new(1.9, 1.9), Vec2::new(1.0, 1.9)];
        let mut both = block(&[strip, rest]);
        let wanted = cover_flat(&both).covered;
        let in_own_chart =
            other_points(&both, &wanted, Spread::OverTexel, || Progress::new().check()).unwrap();
        both.triangles[1].chart = both.triangles[0].chart;
        let in_both = other_points(&both, &wanted, Spread::OverTexel, || Progress::new().check()).unwrap();
        assert_eq!((wanted.len(), in_own_chart.len()), (1, 1));
        let triangles = |found: &[TexelPoint]| found.iter().map(|p| p.triangle).collect::<Vec<_>>();
        let own = triangles(&in_own_chart[0]);
        assert!(own.len() > 4 && own.iter().all(|triangle| *triangle == wanted[0].triangle), "{own:?}");
        let all = triangles(&in_both[0]);
        assert!(all.contains(&0) && all.contains(&1), "{all:?}");
    }
}
