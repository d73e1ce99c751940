//! The receivers of a cell that cast rays. Where nothing is near, irradiance bends little from texel to texel, whatever the light: there
//! rows are interpolated between those of the corners of rectangles of texels (METHOD.md §2.4).

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;

use crate::geometry::Site;
use crate::lightmap::World;
use crate::task::Cancelled;

/// Longest side of a rectangle in texels, a power of two. More → fewer rays, and light that is noisy in larger pieces.
const SIDE_MAX: i32 = 4;
/// Least cosine between normals of a rectangle's receivers.
const FLAT_COSINE: f32 = 0.9998;
/// Farthest that a receiver of a rectangle is from where its corners say, in texels.
const STRAY_TEXELS: f32 = 0.125;

/// A receiver as rectangles see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Block, and place in it.
    block: u32,
    at: [i32; 2],
    texel_m: f32,
    site: Site,
    /// No wall parts its texel.
    is_whole: bool,
    /// No wall stands between it and the next texels along x and y.
    is_linked: [bool; 2],
    /// Others take its light, or it takes another's: all are to have the very same.
    is_shared: bool,
}

impl Texel {
    /// Of a receiver of a world.
    pub fn of(world: &World, receiver: u32) -> Self {
        let own = &world.lightmap.receivers[receiver as usize];
        Self {
            block: own.block,
            at: own.texel.map(i32::from),
            texel_m: world.lightmap.texel_m_of(receiver),
            site: own.site(),
            is_whole: world.is_whole(receiver),
            is_linked: [0, 1].map(|bit| own.links >> bit & 1 == 1),
            is_shared: world.is_shared(receiver),
        }
    }
}

/// By how many times corners beside a rectangle may see nearer things than its own.
const BESIDE: f32 = 2.0;

/// Corners that a row is interpolated from: places in the cell, with weights whose sum is 1.
pub type Corners = Vec<(usize, f32)>;

/// Of each texel the corners that its row is interpolated from; `None` where it casts rays itself.
///
/// `cast` casts the rays of some texels, by their places, and tells the mean of `1/t²` over each one's rays, in m⁻², t being the length
/// of a ray. A rectangle with sides of at most h is interpolated if `h² 1/t² ≤ bend²` at each of its corners.
pub fn corners(
    texels: &[Texel],
    bend: f32,
    mut cast: impl FnMut(&[usize]) -> Result<Vec<f32>, Cancelled>,
) -> Result<Vec<Option<Corners>>, Cancelled> {
    let mut nearness_m2: Vec<Option<f32>> = vec![None; texels.len()];
    let mut around: Vec<Option<Rectangle>> = vec![None; texels.len()];
    let mut cast_all = |places: BTreeSet<usize>, nearness_m2: &mut Vec<Option<f32>>| {
        let new: Vec<usize> = places.into_iter().filter(|&place| nearness_m2[place].is_none()).collect();
        let told = cast(&new)?;
        new.into_iter().zip(told).for_each(|(place, told)| nearness_m2[place] = Some(told));
        Ok(())
    };
    let sheets = if bend > 0.0 { sheets(texels) } else { Vec::new() };
    let mut side = SIDE_MAX;
    let mut rectangles: Vec<Rectangle> = sheets.iter().flat_map(|sheet| sheet.rectangles(side)).collect();
    while !rectangles.is_empty() {
        let (flat, mut rest): (Vec<_>, Vec<_>) = rectangles.into_iter().partition(Rectangle::is_flat);
        cast_all(flat.iter().flat_map(Rectangle::corners).collect(), &mut nearness_m2)?;
        for rectangle in flat {
            let nearest = rectangle.corners().map(|corner| nearness_m2[corner].unwrap_or(f32::INFINITY));
            let nearest_m2 = nearest.into_iter().fold(0.0, f32::max);
            if rectangle.side_m().powi(2) * nearest_m2 <= bend * bend {
                rectangle.places().for_each(|place| around[place] = Some(rectangle));
            } else {
                rest.push(rectangle);
            }
        }
        side /= 2;
        rectangles = rest.iter().flat_map(|rectangle| rectangle.parts(side)).collect();
    }
    let casts = |place: &usize| around[*place].is_none() || texels[*place].is_shared;
    cast_all((0..texels.len()).filter(casts).collect(), &mut nearness_m2)?;
    let mut nodes: BTreeMap<(u32, [i32; 2]), [Vec<i32>; 2]> = BTreeMap::new();
    let interpolated = |(texel, (around, cast)): (&Texel, (&Option<Rectangle>, &Option<f32>))| {
        // A corner of one rectangle may lie on the side of another.
        let rectangle = around.filter(|_| cast.is_none())?;
        let nodes =
            nodes.entry((texel.block, rectangle.low)).or_insert_with(|| rectangle.nodes(&nearness_m2, bend));
        Some(rectangle.corners_of(texel.at, nodes))
    };
    Ok(texels.iter().zip(around.iter().zip(&nearness_m2)).map(interpolated).collect())
}

/// Weights of a polynomial's values at some places for that at `at`.
fn lagrange(places: &[i32], at: i32) -> Vec<f32> {
    let of = |own: &i32| {
        let others = places.iter().filter(|other| *other != own);
        others.map(|other| (at - other) as f32 / (own - other) as f32).product()
    };
    places.iter().map(of).collect()
}

/// Texels of a block.
struct Sheet<'a> {
    texels: &'a [Texel],
    places: BTreeMap<[i32; 2], usize>,
}

fn sheets(texels: &[Texel]) -> Vec<Sheet<'_>> {
    let mut of_block: BTreeMap<u32, BTreeMap<[i32; 2], usize>> = BTreeMap::new();
    for (place, texel) in texels.iter().enumerate() {
        of_block.entry(texel.block).or_default().insert(texel.at, place);
    }
    of_block.into_values().map(|places| Sheet { texels, places }).collect()
}

impl Sheet<'_> {
    /// All of it, cut at the multiples of a side.
    fn rectangles(&self, side: i32) -> impl Iterator<Item = Rectangle<'_>> {
        let along = |axis: usize| self.places.keys().map(move |at| at[axis]);
        let [low, high] = [
            [0, 1].map(|axis| along(axis).min().unwrap_or(0)),
            [0, 1].map(|axis| along(axis).max().unwrap_or(0)),
        ];
        Rectangle { sheet: self, low, high }.parts(side)
    }
}

/// A rectangle of texels, its last ones too.
#[derive(Clone, Copy)]
struct Rectangle<'a> {
    sheet: &'a Sheet<'a>,
    low: [i32; 2],
    high: [i32; 2],
}

impl<'a> Rectangle<'a> {
    /// Its parts between multiples of a side that have texels between their corners; those beside each other share their sides.
    fn parts(self, side: i32) -> impl Iterator<Item = Rectangle<'a>> {
        let cuts = |axis: usize| -> Vec<[i32; 2]> {
            if side < 2 {
                return Vec::new();
            }
            let first = self.low[axis].div_euclid(side) + 1;
            let inner = (first..).map(|multiple| multiple * side).take_while(|at| *at < self.high[axis]);
            let all: Vec<i32> = [self.low[axis]].into_iter().chain(inner).chain([self.high[axis]]).collect();
            all.windows(2).map(|pair| [pair[0], pair[1]]).filter(|[low, high]| low < high).collect()
        };
        let (columns, rows) = (cuts(0), cuts(1));
        let part = move |[left, right]: [i32; 2], [low, high]: [i32; 2]| Rectangle {
            low: [left, low],
            high: [right, high],
            ..self
        };
        let all = rows
            .into_iter()
            .flat_map(move |row| columns.clone().into_iter().map(move |column| part(column, row)));
        all.filter(|part| part.size().into_iter().max() > Some(1))
    }

    fn size(&self) -> [i32; 2] {
        [0, 1].map(|axis| self.high[axis] - self.low[axis])
    }

    fn place(&self, at: [i32; 2]) -> Option<usize> {
        self.sheet.places.get(&at).copied()
    }

    fn at(&self) -> impl Iterator<Item = [i32; 2]> + use<> {
        let (low, high) = (self.low, self.high);
        (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y]))
    }

    /// Places of its corners; none where it has a hole there.
    fn corners(&self) -> [usize; 4] {
        let [[x0, y0], [x1, y1]] = [self.low, self.high];
        [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|at| self.place(at).unwrap_or(usize::MAX))
    }

    fn side_m(&self) -> f32 {
        let texel_m = self.sheet.texels[self.corners()[0]].texel_m;
        self.size().into_iter().max().unwrap_or(0) as f32 * texel_m
    }

    /// Its texels are all there, one flat surface, and no wall is between them.
    fn is_flat(&self) -> bool {
        let own = |at: [i32; 2]| self.place(at).map(|place| &self.sheet.texels[place]);
        let corners = self.corners();
        if corners.contains(&usize::MAX) {
            return false;
        }
        let (first, own_nodes) = (self.sheet.texels[corners[0]].site, self.own_nodes());
        self.at().all(|at| {
            let Some(texel) = own(at) else { return false };
            let is_linked = |axis: usize| at[axis] == self.high[axis] || texel.is_linked[axis];
            let expected_m: Vec3 = self
                .corners_of(at, &own_nodes)
                .into_iter()
                .map(|(corner, weight)| self.sheet.texels[corner].site.position_m * weight)
                .sum();
            let stray_m = texel.site.position_m.distance(expected_m);
            texel.is_whole
                && is_linked(0)
                && is_linked(1)
                && stray_m <= STRAY_TEXELS * texel.texel_m
                && texel.site.normal.dot(first.normal) >= FLAT_COSINE
                && texel.site.face_normal.dot(first.face_normal) >= FLAT_COSINE
        })
    }

    /// Places of its texels.
    fn places(&self) -> impl Iterator<Item = usize> + '_ {
        self.at().filter_map(|at| self.place(at))
    }

    /// Columns and rows of its corners.
    fn own_nodes(&self) -> [Vec<i32>; 2] {
        [0, 1].map(|axis| vec![self.low[axis], self.high[axis]])
    }

    /// Columns and rows of corners to interpolate from: its own, and one more on either side where all of these have cast rays, see
    /// nothing much nearer, and are of the same flat surface.
    fn nodes(&self, nearness_m2: &[Option<f32>], bend: f32) -> [Vec<i32>; 2] {
        let size = self.size();
        let most_m2 = (BESIDE * bend / self.side_m()).powi(2);
        let mut nodes = self.own_nodes();
        for (axis, is_before) in [(0, true), (0, false), (1, true), (1, false)] {
            let mut more = nodes.clone();
            if is_before {
                more[axis].insert(0, self.low[axis] - size[axis]);
            } else {
                more[axis].push(self.high[axis] + size[axis]);
            }
            let is_node = |at: [i32; 2]| {
                self.place(at)
                    .is_some_and(|place| nearness_m2[place].is_some_and(|nearness| nearness <= most_m2))
            };
            let all = more[1].iter().flat_map(|&y| more[0].iter().map(move |&x| [x, y]));
            let [low, high] = [0, 1]
                .map(|end| [0, 1].map(|axis| more[axis][if end == 0 { 0 } else { more[axis].len() - 1 }]));
            if all.clone().all(is_node) && (Rectangle { low, high, ..*self }).is_flat() {
                nodes = more;
            }
        }
        nodes
    }

    /// Weights at a texel of polynomials through the corners in some columns and rows.
    fn corners_of(&self, at: [i32; 2], nodes: &[Vec<i32>; 2]) -> Corners {
        let [along_x, along_y] = [0, 1].map(|axis| lagrange(&nodes[axis], at[axis]));
        let of_row = |(&y, weight): (&i32, f32)| {
            let of_corner = |(&x, other): (&i32, &f32)| Some((self.place([x, y])?, weight * other));
            nodes[0].iter().zip(&along_x).filter_map(of_corner).collect::<Vec<_>>()
        };
        nodes[1].iter().zip(along_y).flat_map(of_row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of texels of 1 m.
    fn sheet(width: i32, height: i32) -> Vec<Texel> {
        let texel = |at: [i32; 2]| Texel {
            block: 0,
            at,
            texel_m: 1.0,
            site: Site {
                position_m: Vec3::new(at[0] as f32, at[1] as f32, 0.0),
                normal: Vec3::Z,
                face_normal: Vec3::Z,
            },
            is_whole: true,
            is_linked: [true; 2],
            is_shared: false,
        };
        (0..height).flat_map(|y| (0..width).map(move |x| texel([x, y]))).collect()
    }

    /// Which texels cast rays, if all see things as far as told; corners of the others are checked.
    fn casts(texels: &[Texel], nearness_m2: impl Fn(&Texel) -> f32) -> Vec<bool> {
        let mut cast = vec![false; texels.len()];
        let found = corners(texels, 0.25, |places| {
            places.iter().for_each(|&place| assert!(!std::mem::replace(&mut cast[place], true)));
            Ok(places.iter().map(|&place| nearness_m2(&texels[place])).collect())
        });
        for (index, corners) in found.unwrap().into_iter().enumerate() {
            assert_eq!(corners.is_none(), cast[index]);
            let Some(corners) = corners else { continue };
            assert!(corners.iter().all(|(corner, _)| cast[*corner]));
            let mean_m: Vec3 =
                corners.iter().map(|(corner, weight)| texels[*corner].site.position_m * *weight).sum();
            assert!(mean_m.distance(texels[index].site.position_m) < STRAY_TEXELS);
        }
        cast
    }

    #[test]
    fn polynomials_of_the_third_degree_come_back_inside_and_of_the_second_at_the_rim() {
        let texels = sheet(17, 17);
        let found = corners(&texels, 0.25, |places| Ok(vec![0.0; places.len()])).unwrap();
        let value =
            |at: [i32; 2], degree: i32| (at[0] as f32 / 8.0).powi(degree) - (at[1] as f32 / 8.0).powi(degree);
        for (texel, corners) in texels.iter().zip(found) {
            let is_inside = texel.at.iter().all(|at| (4..=12).contains(at));
            for degree in 0..=if is_inside { 3 } else { 2 } {
                let Some(corners) = &corners else { continue };
                let sum: f32 =
                    corners.iter().map(|&(corner, weight)| weight * value(texels[corner].at, degree)).sum();
                assert!((sum - value(texel.at, degree)).abs() < 1e-4, "{:?} {degree} {sum}", texel.at);
            }
        }
    }

    fn count(casts: &[bool]) -> usize {
        casts.iter().filter(|casts| **casts).count()
    }

    #[test]
    fn open_surface_casts_at_every_fourth_texel_and_at_its_rim() {
        assert_eq!(count(&casts(&sheet(17, 9), |_| 0.0)), 5 * 3);
        assert_eq!(count(&casts(&sheet(16, 16), |_| 0.0)), 5 * 5);
        assert_eq!(count(&casts(&sheet(2, 2), |_| 0.0)), 4);
        assert_eq!(count(&casts(&sheet(9, 1), |_| 0.0)), 9, "a row has no rectangle");
    }

    #[test]
    fn rectangles_are_smaller_where_something_is_near() {
        let far = |free_m: f32| move |_: &Texel| 1.0 / (free_m * free_m);
        assert_eq!(count(&casts(&sheet(17, 17), far(16.1))), 5 * 5);
        assert_eq!(count(&casts(&sheet(17, 17), far(15.9))), 9 * 9);
        assert_eq!(count(&casts(&sheet(17, 17), far(7.9))), 17 * 17);
        let beside = casts(&sheet(17, 5), |texel| if texel.at[0] == 0 { 1.0 } else { 0.0 });
        assert_eq!(count(&beside), 5 + 5 + 3 + 3 + 3 * 2);
    }

    #[test]
    fn what_is_not_one_flat_surface_casts_for_itself() {
        let with = |change: &dyn Fn(&mut Texel)| {
            let mut texels = sheet(5, 5);
            change(&mut texels[12]);
            casts(&texels, |_| 0.0)
        };
        for change in [
            &(|texel: &mut Texel| texel.is_whole = false) as &dyn Fn(&mut Texel),
            &|texel| texel.is_linked[0] = false,
            &|texel| texel.site.normal = Vec3::new(0.1, 0.0, 1.0).normalize(),
            &|texel| texel.site.position_m.z = 0.2,
            &|texel| texel.block = 1,
        ] {
            assert!(with(change)[12]);
            assert!(count(&with(change)) > 4);
        }
        let shared = with(&|texel| texel.is_shared = true);
        assert_eq!((shared[12], count(&shared)), (true, 5), "a shared texel alone casts, the rest is flat");
    }
}
