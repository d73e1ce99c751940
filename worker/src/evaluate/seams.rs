//! Seams: jumps of the light across borders of charts, blocks and clusters. True light has none there but at a few places, so
//! the largest across charts and blocks are path-traced, and what the reference jumps there is taken off.

use glam::{DVec3, Vec2, Vec3};
use lightkiln_proto::content::BlockKey;
use rayon::prelude::*;
use serde::Serialize;

use super::evaluated::{Evaluated, EvaluatedLightmap, Relit};
use super::figures::at_share;
use super::open::OpenSpace;
use crate::geometry::{Site, Strata};
use crate::rays::Hit;
use crate::rays::sampling::tangent_frame;
use crate::reference::{Precision, Reference, Target, luminance};
use crate::task::{Cancelled, Progress};

/// Points from which borders are looked for. More → more pairs, more time.
const WALKS: u32 = 65_536;
/// Length of the way from each, and of its steps, in texels.
const WALK_TEXELS: f32 = 1.5;
const STEP_TEXELS: f32 = 0.125;
/// A step over which the place in the lightmap changes by more than this many texels crosses a border: charts lie at least
/// a gutter apart.
const JUMP_TEXELS: f32 = 0.5;
/// Halvings of a step: the points of a pair are then 0.008 texels apart.
const HALVINGS: u32 = 4;
/// Cosine between the normals of one plane, and of one shading normal.
const COPLANAR_COS: f32 = 0.9995;
/// Height in texels from which the way is cast onto the surface.
const CAST_TEXELS: f32 = 0.02;
/// Height in texels to which the points of a pair are raised at most to see each other.
const RAISED_TEXELS: f32 = 0.25;
/// Texels for which wide surfaces go on in sight on both sides of a border, and the steps in which they are looked at.
const WIDE_TEXELS: f32 = 1.5;
const WIDE_STEPS: u32 = 6;
/// Golden ratio's share of a turn, between the directions of walks.
const TURN: f32 = 0.381_966;
/// Rows of four texels across borders of clusters, and as many inside clusters, at most.
const ROWS: usize = 8192;
/// Light that a jump is over at least, as a share of the mean.
const LOCAL_LIGHT_MIN: f64 = 0.1;
/// Most jumps that are path-traced, the least of them, and the precision of the paths: none is told from a large one by far
/// less than figures need.
const TRACED: usize = 32;
const TRACED_JUMP_MIN: f64 = 0.05;
const TRACED_REL_ERROR: f64 = 0.15;
/// Jumps that are named.
const NAMED: usize = 8;

/// Jumps of light over its mean on both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Jumps {
    /// Places measured.
    pub pairs: usize,
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
}

/// A jump across a border of charts or blocks.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Step {
    /// Blocks on both sides: path, part and side.
    pub blocks: [String; 2],
    /// Place in metres.
    pub position_m: [f32; 3],
    /// Luminance on both sides, W·m⁻².
    pub light: [f64; 2],
    /// That of the reference.
    pub reference: [f64; 2],
}

/// Jumps by the border that they are across.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Seams {
    /// Between charts of a block.
    pub charts: Jumps,
    /// Between blocks.
    pub blocks: Jumps,
    /// Those of charts and blocks where the plane goes on in sight for 1.5 texels on both sides: elsewhere surfaces are narrower than
    /// what texels resolve.
    pub wide: Jumps,
    /// Between clusters, of texels extrapolated to the border.
    pub clusters: Jumps,
    /// The same inside clusters: what texels differ by anyway.
    pub inside: Jumps,
    /// The largest across charts and blocks that the reference does not have.
    pub worst: Vec<Step>,
}

/// Points right before and right behind a border of charts or blocks.
#[derive(Clone, Copy, Debug)]
struct Pair {
    hits: [Hit; 2],
    /// Surfaces on both sides are wide.
    is_wide: bool,
}

/// Light on both sides of a border of charts or blocks.
struct Across {
    pair: Pair,
    light: [f64; 2],
    /// Least light that a jump is over.
    floor: f64,
    /// That of the reference, where it is known; else it has no jump there.
    reference: Option<[f64; 2]>,
}

impl Across {
    /// The jump that the reference does not have, over the mean of both sides.
    fn jump(&self) -> f64 {
        let [one, other] = self.light;
        let own = one - other;
        let true_one = self.reference.map_or(0.0, |[one, other]| one - other) * own.signum();
        let excess = (own.abs() - true_one.max(0.0)).max(0.0);
        excess / (0.5 * (one + other)).max(self.floor).max(f64::MIN_POSITIVE)
    }

    fn step(&self, (bake, lightmap): (&dyn Evaluated, &dyn EvaluatedLightmap)) -> Step {
        let block = |hit: &Hit| {
            let found = lightmap.texel_at(hit);
            found.map_or(String::new(), |(block, _)| lightmap.block_name(block).to_owned())
        };
        Step {
            blocks: self.pair.hits.each_ref().map(block),
            position_m: bake.geometry().site_at(&self.pair.hits[0]).position_m.to_array(),
            light: self.light,
            reference: self.reference.unwrap_or_default(),
        }
    }
}

/// Path-traces the largest jumps; those that are left are named.
fn traced(
    across: &mut [Across],
    (bake, lightmap): (&dyn Evaluated, &dyn EvaluatedLightmap),
    reference: &Reference,
    progress: &Progress,
) -> Result<Vec<Step>, Cancelled> {
    let mut order: Vec<usize> = (0..across.len()).collect();
    order.retain(|&index| across[index].jump() > TRACED_JUMP_MIN);
    order.sort_by(|&a, &b| across[b].jump().total_cmp(&across[a].jump()).then(a.cmp(&b)));
    order.truncate(TRACED);
    if order.is_empty() {
        return Ok(Vec::new());
    }
    let geometry = bake.geometry();
    let sides = order.iter().flat_map(|&index| across[index].pair.hits);
    let targets: Vec<Target> = sides.map(|hit| Target::of(geometry.site_at(&hit))).collect();
    let precision = Precision { rel_error: TRACED_REL_ERROR, ..Precision::default() };
    let estimates = reference.mean_irradiance(&targets, &precision, progress)?;
    for (&index, sides) in order.iter().zip(estimates.chunks_exact(2)) {
        across[index].reference = Some([0, 1].map(|side: usize| sides[side].indirect.luminance()));
    }
    order.sort_by(|&a, &b| across[b].jump().total_cmp(&across[a].jump()).then(a.cmp(&b)));
    let left = order.iter().map(|&index| &across[index]).filter(|across| across.jump() > TRACED_JUMP_MIN);
    Ok(left.take(NAMED).map(|across| across.step((bake, lightmap))).collect())
}

/// Borders of a bake's lightmap.
#[derive(Clone, Debug, Default)]
pub struct Borders {
    charts: Vec<Pair>,
    blocks: Vec<Pair>,
    /// Receivers of four texels in a row, the border in their middle.
    clusters: Vec<[u32; 4]>,
    inside: Vec<[u32; 4]>,
}

impl Borders {
    /// Finds them: those of charts and blocks by walks from points spread by area, so that a border's chance is its length;
    /// those of clusters by all texels.
    pub fn of(bake: &dyn Evaluated, open: &OpenSpace, lightmap: &dyn EvaluatedLightmap) -> Self {
        let starts = Strata::new(bake.geometry(), WALKS).hits;
        let found: Vec<Pair> = (0..starts.len())
            .into_par_iter()
            .filter_map(|index| Walk::new((bake, open), lightmap, &starts[index], index)?.border())
            .collect();
        let is_of_block = |pair: &Pair| {
            let [one, other] = pair.hits.map(|hit| lightmap.texel_at(&hit).map(|(block, _)| block));
            one != other
        };
        let (blocks, charts) = found.into_iter().partition(is_of_block);
        let (clusters, inside): (Vec<_>, Vec<_>) =
            rows(bake, lightmap).into_iter().partition(|(crosses, _)| *crosses);
        let seen = |rows: Vec<(bool, [u32; 4])>| -> Vec<[u32; 4]> {
            let every = rows.len().div_ceil(ROWS).max(1);
            let is_seen = |row: &[u32; 4]| open.sees(bake.geometry(), &lightmap.receiver(row[1]).site);
            let few: Vec<[u32; 4]> = rows.into_iter().step_by(every).map(|(_, row)| row).collect();
            few.into_par_iter().filter(is_seen).collect()
        };
        Self { charts, blocks, clusters: seen(clusters), inside: seen(inside) }
    }

    /// Jumps of a light across them; `mean` is its mean luminance.
    pub(super) fn jumps(
        &self,
        (bake, lightmap): (&dyn Evaluated, &dyn EvaluatedLightmap),
        (relit, mean): (&dyn Relit, f64),
        reference: &Reference,
        progress: &Progress,
    ) -> Result<Seams, Cancelled> {
        let floor = LOCAL_LIGHT_MIN * mean;
        let across = |pair: &Pair| {
            let light = pair.hits.each_ref().map(|hit| relit.shown_at(hit).map_or(0.0, luminance));
            Across { pair: *pair, light, floor, reference: None }
        };
        let mut borders: Vec<Across> = self.charts.par_iter().chain(&self.blocks).map(across).collect();
        let worst = traced(&mut borders, (bake, lightmap), reference, progress)?;
        let [charts, blocks] = [&borders[..self.charts.len()], &borders[self.charts.len()..]]
            .map(|borders| Jumps::of(borders.iter().map(Across::jump).collect()));
        let wide = Jumps::of(borders.iter().filter(|across| across.pair.is_wide).map(Across::jump).collect());
        let along = |rows: &[[u32; 4]]| {
            let at = |index: u32| relit.irradiance(&lightmap.receiver(index)).unwrap_or(DVec3::ZERO);
            let jump = |row: &[u32; 4]| {
                let [a, b, c, d] = row.map(|index| luminance(at(index)));
                extrapolated([a, b, c, d]).abs() / (0.5 * (b + c)).max(floor).max(f64::MIN_POSITIVE)
            };
            Jumps::of(rows.par_iter().map(jump).collect())
        };
        Ok(Seams {
            charts,
            blocks,
            wide,
            clusters: along(&self.clusters),
            inside: along(&self.inside),
            worst,
        })
    }
}

impl Jumps {
    fn of(mut jumps: Vec<f64>) -> Self {
        jumps.sort_by(f64::total_cmp);
        let mean = jumps.iter().sum::<f64>() / jumps.len().max(1) as f64;
        Self { pairs: jumps.len(), mean, p95: at_share(&jumps, 0.95) }
    }
}

/// Jump at the middle of four values in a row: that of the lines through either two. None for light that changes evenly.
fn extrapolated([a, b, c, d]: [f64; 4]) -> f64 {
    (c - 0.5 * (d - c)) - (b + 0.5 * (b - a))
}

/// Linked rows of four texels: the border of two clusters in their middle and nowhere else, or all of one cluster; and
/// which of these they are.
fn rows(bake: &dyn Evaluated, lightmap: &dyn EvaluatedLightmap) -> Vec<(bool, [u32; 4])> {
    let cluster = |index: u32| bake.chunk_of(&lightmap.receiver(index));
    let row = |index: u32, [dx, dy]: [i32; 2]| -> Option<(bool, [u32; 4])> {
        let before = lightmap.linked(index, [-dx, -dy])?;
        let next = lightmap.linked(index, [dx, dy])?;
        let last = lightmap.linked(next, [dx, dy])?;
        let [a, b, c, d] = [before, index, next, last].map(cluster);
        (a == b && c == d).then_some((b != c, [before, index, next, last]))
    };
    let of_texel = |index: u32| [[1, 0], [0, 1]].into_iter().filter_map(move |step| row(index, step));
    (0..lightmap.receivers()).into_par_iter().flat_map_iter(of_texel).collect()
}

/// A straight way over a plane.
struct Walk<'a> {
    bake: &'a dyn Evaluated,
    open: &'a OpenSpace,
    lightmap: &'a dyn EvaluatedLightmap,
    start: Site,
    direction: Vec3,
}

/// A point of a way.
#[derive(Clone, Copy)]
struct Point {
    along_m: f32,
    hit: Hit,
    site: Site,
    block: BlockKey,
    texel: Vec2,
}

impl<'a> Walk<'a> {
    fn new(
        (bake, open): (&'a dyn Evaluated, &'a OpenSpace),
        lightmap: &'a dyn EvaluatedLightmap,
        hit: &Hit,
        index: usize,
    ) -> Option<Self> {
        lightmap.texel_at(hit)?;
        let start = bake.geometry().site_at(hit);
        let (tangent, bitangent) = tangent_frame(start.face_normal);
        let (sine, cosine) = libm::sincosf(std::f32::consts::TAU * (TURN * index as f32).fract());
        Some(Self { bake, open, lightmap, start, direction: tangent * cosine + bitangent * sine })
    }

    /// Points right before and right behind the first border on the way, if there is one and no wall parts them.
    fn border(&self) -> Option<Pair> {
        let step_m = STEP_TEXELS * self.lightmap.texel_m();
        let mut before = self.at(0.0)?;
        for step in 1..=(WALK_TEXELS / STEP_TEXELS) as u32 {
            let behind = self.at(step as f32 * step_m)?;
            if changes(&before, &behind) > JUMP_TEXELS {
                return self.halved(before, behind);
            }
            before = behind;
        }
        None
    }

    fn halved(&self, mut before: Point, mut behind: Point) -> Option<Pair> {
        for _ in 0..HALVINGS {
            let middle = self.at(0.5 * (before.along_m + behind.along_m))?;
            if changes(&before, &middle) > changes(&middle, &behind) {
                behind = middle;
            } else {
                before = middle;
            }
        }
        let points = [before, behind];
        let geometry = self.bake.geometry();
        let height_m = RAISED_TEXELS * self.lightmap.texel_m();
        let [from_m, to_m] =
            points.map(|point| geometry.raised(point.site.position_m, point.site.face_normal, height_m));
        let is_open = !geometry.tracer.is_occluded(from_m, to_m)
            && before.site.normal.dot(behind.site.normal) > COPLANAR_COS
            && points.iter().all(|point| self.open.sees(geometry, &point.site));
        let is_border = is_open && changes(&before, &behind) > JUMP_TEXELS;
        is_border.then(|| Pair {
            hits: points.map(|point| point.hit),
            is_wide: self.is_wide(&before, -1.0) && self.is_wide(&behind, 1.0),
        })
    }

    /// The chart's plane goes on in sight from a point, forwards or backwards.
    fn is_wide(&self, from: &Point, sign: f32) -> bool {
        let step_m = sign * WIDE_TEXELS * self.lightmap.texel_m() / WIDE_STEPS as f32;
        let is_seen = |step: u32| {
            let along_m = from.along_m + step as f32 * step_m;
            let goes_on = |point: &Point| changes(from, point) < 2.0 * WIDE_TEXELS;
            let found = self.at(along_m).filter(goes_on);
            found.is_some_and(|point| self.open.sees(self.bake.geometry(), &point.site))
        };
        (1..=WIDE_STEPS).all(is_seen)
    }

    /// The point so far along; `None` where the plane does not go on, or has no lightmap.
    fn at(&self, along_m: f32) -> Option<Point> {
        let geometry = self.bake.geometry();
        let normal = self.start.face_normal;
        let at_m = self.start.position_m + self.direction * along_m;
        let offset_m = geometry.tracer.ray_offset_m(at_m);
        let height_m = (CAST_TEXELS * self.lightmap.texel_m()).max(4.0 * offset_m);
        let from_m = at_m + normal * height_m;
        let hit = geometry.tracer.closest_surface(from_m, -normal, 2.0 * height_m)?;
        let site = geometry.site_at(&hit);
        let (block, texel) = self.lightmap.texel_at(&hit)?;
        let is_coplanar = site.face_normal.dot(normal) > COPLANAR_COS;
        is_coplanar.then_some(Point { along_m, hit, site, block, texel })
    }
}

/// Texels between the places of two points in the lightmap.
fn changes(one: &Point, other: &Point) -> f32 {
    if one.block == other.block { one.texel.distance(other.texel) } else { f32::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_reference_jumps_is_no_seam_and_the_rest_is() {
        let hit = Hit { t: 0.0, triangle: 0, barycentric: [0.0; 2], front: true };
        let jump = |light: [f64; 2], reference: Option<[f64; 2]>| {
            let pair = Pair { hits: [hit; 2], is_wide: true };
            Across { pair, light, floor: 0.1, reference }.jump()
        };
        assert_eq!(jump([3.0, 1.0], None), 1.0);
        assert_eq!(jump([3.0, 1.0], Some([2.0, 2.0])), 1.0);
        assert_eq!(jump([3.0, 1.0], Some([3.0, 1.5])), 0.25);
        assert_eq!(jump([3.0, 1.0], Some([9.0, 1.0])), 0.0, "noise of the reference makes no seam");
        assert_eq!(jump([1.0, 3.0], Some([3.0, 1.0])), 1.0, "a jump the other way takes nothing off");
        assert_eq!(jump([0.025, 0.0], None), 0.25, "little in the dark");
    }

    #[test]
    fn light_that_changes_evenly_has_no_jump_and_a_step_has_its_height() {
        assert_eq!(extrapolated([1.0, 2.0, 3.0, 4.0]), 0.0);
        assert_eq!(extrapolated([1.0, 1.0, 3.0, 3.0]), 2.0);
        let jumps = Jumps::of(vec![0.4, 0.0, 0.2, 0.2]);
        assert!(jumps.pairs == 4 && (jumps.mean - 0.2).abs() < 1e-12 && jumps.p95 == 0.4, "{jumps:?}");
    }
}
