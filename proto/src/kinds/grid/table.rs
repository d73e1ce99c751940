//! The field at run time: probes by their points of the lattice, light at probes from λ, and irradiance at any point and normal.

use std::ops::Range;
use std::sync::LazyLock;

use glam::{IVec3, Vec3, Vec4};

use super::content::{FieldPart, PROBE_ROWS, ProbeKey, depth_of};
use super::octahedron::{MAP_POINTS, map_points, octahedral_length};
use crate::harmonics::ShBasis;
use crate::relight::{ClusterTable, Columns, EmitterTable, Inconsistent, Parallel};

/// A point of the lattice without a probe.
pub const NO_PROBE: u32 = u32::MAX;

/// Harmonics of a probe's rows.
static BASIS: LazyLock<ShBasis> = LazyLock::new(|| ShBasis::new(2));

/// Most points of the lattice between the outermost probes.
const POINTS_MAX: usize = 1 << 20;
/// Share of a depth over which a point beyond it goes from seen to hidden.
const HIDDEN_SHARE: f32 = 0.05;
/// The same in metres, at most: a point 2 cm behind a wall of 2 cm is hidden however far the probe is. *We differ* from a share alone,
/// which is 10 cm at a probe 2 m away.
const HIDDEN_M: f32 = 0.04;
/// Share of its distance from a probe by which a point may lie behind a surface and still be lit by that probe where no other sees it:
/// depth maps round edges off by as much.
const ROUNDED_SHARE: f32 = 0.15;
/// Depth in metres over which such probes count less, from that of the least on.
const ROUNDED_M: f32 = 0.01;
/// Least sum of weights for which a cage's probes count; below it, those of the cages around it do.
const WEIGHT_MIN: f32 = 1e-4;

/// Probes, their depth maps and their transport.
#[derive(Debug, Default)]
pub struct FieldTable {
    /// Step of the lattice h in metres.
    pub spacing_m: f32,
    /// Least point of the lattice, and how many points there are along each axis.
    pub low: IVec3,
    /// See `low`.
    pub size: IVec3,
    /// Probe of each point, x fastest, or [`NO_PROBE`].
    pub probe_at: Vec<u32>,
    /// Likewise of each cell, by its least corner.
    pub probe_in: Vec<u32>,
    /// Places of probes in metres.
    pub position_m: Vec<Vec4>,
    /// Depth maps, [`MAP_POINTS`] codes a probe.
    pub depths: Vec<u16>,
    /// Transport, [`PROBE_ROWS`] rows a probe.
    pub clusters: ClusterTable,
    /// Light straight from emitters, as many rows.
    pub emitters: EmitterTable,
}

impl FieldTable {
    /// Joins parts, of a bake of so many emitters, whose columns read `columns`.
    pub fn join(parts: &[FieldPart], emitters: usize, columns: &impl Columns) -> Result<Self, Inconsistent> {
        let of_parts = || parts.iter().map(|part| PROBE_ROWS * part.probes.len());
        let clusters = ClusterTable::join(parts.iter().map(|part| &part.factors).zip(of_parts()), columns)?;
        let direct =
            EmitterTable::join(parts.iter().map(|part| &part.emitters[..]).zip(of_parts()), emitters)?;
        let spacing_m = parts.first().map_or(1.0, |part| part.spacing_m);
        let mut table = Self { spacing_m, clusters, emitters: direct, ..Self::default() };
        if let Some(index) = parts.iter().position(|part| part.spacing_m != spacing_m) {
            let problem =
                format!("its probes stand {} m apart, others {spacing_m} m", parts[index].spacing_m);
            return Err(Inconsistent::new(format!("field {index}"), problem));
        }
        table.place(parts)?;
        Ok(table)
    }

    /// Fills the table of points.
    fn place(&mut self, parts: &[FieldPart]) -> Result<(), Inconsistent> {
        let keys = || parts.iter().flat_map(|part| &part.probes).map(|probe| probe.key);
        let Some(first) = keys().next() else { return Ok(()) };
        let ends = [first.point(); 2];
        let [low, high] =
            keys().map(ProbeKey::point).fold(ends, |[low, high], at| [low.min(at), high.max(at)]);
        (self.low, self.size) = (low, high - low + 1);
        let points =
            self.size.to_array().iter().try_fold(1_usize, |all, &along| all.checked_mul(along as usize));
        let Some(points) = points.filter(|points| *points <= POINTS_MAX) else {
            let problem = format!("its probes span {} points, at most {POINTS_MAX}", self.size);
            return Err(Inconsistent::new("field", problem));
        };
        self.probe_at = vec![NO_PROBE; points];
        self.probe_in = vec![NO_PROBE; points];
        for (index, part) in parts.iter().enumerate() {
            for probe in &part.probes {
                let number = self.position_m.len() as u32;
                let point = probe.key.point();
                let place = self.index_of(point).unwrap_or_default();
                let table = if probe.key.is_of_cell() { &mut self.probe_in } else { &mut self.probe_at };
                if std::mem::replace(&mut table[place], number) != NO_PROBE {
                    let problem = format!("it has a second probe at {point}");
                    return Err(Inconsistent::new(format!("field {index}"), problem));
                }
                self.position_m.push(probe.position_m(self.spacing_m).extend(0.0));
            }
            self.depths.extend_from_slice(&part.depths);
        }
        Ok(())
    }

    /// Probes.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }

    fn index_of(&self, point: IVec3) -> Option<usize> {
        let at = point - self.low;
        let is_there = at.cmpge(IVec3::ZERO).all() && at.cmplt(self.size).all();
        is_there.then(|| ((at.z * self.size.y + at.y) * self.size.x + at.x) as usize)
    }

    /// Coefficients of irradiance at probes, [`PROBE_ROWS`] each, W·m⁻², with the light of emitters of that scale.
    pub fn relit(&self, parallel: &impl Parallel, lambda: &[Vec4], emitter_scale: &[f32]) -> Vec<Vec4> {
        let direct = self.emitters.irradiance(PROBE_ROWS * self.len(), emitter_scale);
        let b = self.clusters.basis(parallel, lambda);
        self.clusters.reconstruct(parallel, &b, &direct, None)
    }

    /// Reciprocal octahedral distance of the nearest surface that a probe sees in a direction, 0 where there is none.
    fn reciprocal(&self, probe: usize, direction: Vec3) -> f32 {
        let map = &self.depths[probe * MAP_POINTS..][..MAP_POINTS];
        let read = |sum: f32, (at, weight): (usize, f32)| sum + depth_of(map[at]) * weight;
        map_points(direction).into_iter().fold(0.0, read) / self.spacing_m
    }

    /// Distance in metres of the nearest surface that a probe sees in a direction of length 1; infinite where there is none.
    pub fn distance_m(&self, probe: u32, direction: Vec3) -> f32 {
        1.0 / (self.reciprocal(probe as usize, direction) * octahedral_length(direction))
    }

    /// How far behind the nearest surface that a probe sees a point lies, and the point's distance; octahedral, in metres. 0 before it.
    fn excess(&self, probe: u32, point_m: Vec3) -> [f32; 2] {
        let probe = probe as usize;
        let to = point_m - self.position_m[probe].truncate();
        let distance_m = octahedral_length(to);
        if distance_m <= 1e-6 * self.spacing_m {
            return [0.0, distance_m];
        }
        let beyond = self.reciprocal(probe, to) * distance_m;
        [if beyond <= 1.0 { 0.0 } else { distance_m * (1.0 - 1.0 / beyond) }, distance_m]
    }

    /// Share of a probe's light that counts at a point, by its depth map: 1 before the nearest surface, 0 behind it.
    ///
    /// `V = clamp(1 − (1 − s_x/s)/t, 0, 1)` with the reciprocals of octahedral distances s_x of the point and s of the surface, and
    /// `t = min(0.05, 4 cm · s_x)`.
    pub fn visibility(&self, probe: u32, point_m: Vec3) -> f32 {
        let [excess_m, distance_m] = self.excess(probe, point_m);
        if excess_m == 0.0 {
            return 1.0;
        }
        (1.0 - excess_m / HIDDEN_M.min(HIDDEN_SHARE * distance_m)).max(0.0)
    }

    /// Probes that a point's light comes from, and their weights, which add up to 1; none where no probe is near that sees it.
    ///
    /// Trilinear weights of the point's cage of the lattice, and a tent within it of its own probe, times visibility. Where that leaves nothing, tents twice as wide; and where
    /// these do, as in corners that depth maps round off, of the probes that it lies least far behind.
    pub fn weights(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        let of_depths = |(probe, tent): (u32, f32)| (probe, tent * self.visibility(probe, point_m));
        let near = self.cage(point_m);
        let found = normalised(near.iter().copied().map(of_depths));
        if !found.is_empty() {
            return found;
        }
        let wide = self.around(point_m / self.spacing_m, -1..3, 2.0);
        let found = normalised(wide.iter().copied().map(of_depths));
        if !found.is_empty() {
            return found;
        }
        let all = wide.iter().map(|&(probe, tent)| (probe, tent, self.excess(probe, point_m)));
        let all: Vec<_> =
            all.filter(|(_, _, [excess_m, far_m])| *excess_m <= ROUNDED_SHARE * far_m).collect();
        let least_m = all.iter().map(|(_, _, [excess_m, _])| *excess_m).fold(f32::INFINITY, f32::min);
        let weight = |(probe, tent, [excess_m, _]): (u32, f32, [f32; 2])| {
            (probe, tent * (1.0 - (excess_m - least_m) / ROUNDED_M).max(0.0))
        };
        normalised(all.into_iter().map(weight))
    }

    /// Probes around a point, and their tents, whether they see it or not; less than 1 in all where a corner of the cage has no probe.
    pub fn cage(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        self.around(point_m / self.spacing_m, 0..2, 1.0)
    }

    /// Probes around a place, in steps of the lattice, and products of tents along each axis: of so many steps about points, half a step
    /// less about the middles of cells. None beyond all lattices.
    fn around(&self, at: Vec3, range: Range<i32>, reach: f32) -> Vec<(u32, f32)> {
        if !at.is_finite() || at.abs().max_element() > super::LATTICE_MAX as f32 {
            return Vec::new();
        }
        let cage = at.floor().as_ivec3();
        let mut found = Vec::new();
        for z in range.clone() {
            for y in range.clone() {
                for x in range.clone() {
                    let point = cage + IVec3::new(x, y, z);
                    let Some(index) = self.index_of(point) else { continue };
                    for (probe, half) in [(self.probe_at[index], 0.0), (self.probe_in[index], 0.5)] {
                        let away = (at - point.as_vec3() - half).abs();
                        let tent = (1.0 - away / (reach - half)).max(Vec3::ZERO).element_product();
                        if tent > 0.0 && probe != NO_PROBE {
                            found.push((probe, tent));
                        }
                    }
                }
            }
        }
        found
    }

    /// Coefficients at a point, of those at probes; 0 where no probe sees it.
    pub fn coefficients(&self, rows: &[Vec4], point_m: Vec3) -> [Vec4; PROBE_ROWS] {
        let mut sums = [Vec4::ZERO; PROBE_ROWS];
        for (probe, weight) in self.weights(point_m) {
            let own = &rows[PROBE_ROWS * probe as usize..][..PROBE_ROWS];
            sums.iter_mut().zip(own).for_each(|(sum, row)| *sum += *row * weight);
        }
        sums
    }

    /// Irradiance at a point and normal in W·m⁻²: `E = max(0, Σ_j Y_j(n) Σ_p w_p q_pj)`.
    pub fn irradiance(&self, rows: &[Vec4], point_m: Vec3, normal: Vec3) -> Vec3 {
        let mut harmonics = [0.0; PROBE_ROWS];
        BASIS.evaluate(normal, &mut harmonics);
        let coefficients = self.coefficients(rows, point_m);
        let sum: Vec4 = coefficients.iter().zip(harmonics).map(|(row, harmonic)| *row * harmonic).sum();
        sum.truncate().max(Vec3::ZERO)
    }
}

/// Weights that add up to 1; none where they are next to nothing.
fn normalised(weights: impl Iterator<Item = (u32, f32)>) -> Vec<(u32, f32)> {
    let mut found: Vec<(u32, f32)> = weights.filter(|(_, weight)| *weight > 0.0).collect();
    let sum: f32 = found.iter().map(|(_, weight)| weight).sum();
    if sum < WEIGHT_MIN {
        return Vec::new();
    }
    found.iter_mut().for_each(|(_, weight)| *weight /= sum);
    found
}

#[cfg(test)]
mod tests {
    use super::super::content::{Probe, depth_code};
    use super::super::octahedron::map_direction;
    use super::*;
    use crate::content::{PatchSet, TransportFactors};
    use crate::relight::{PatchTable, Serial, SlotTable};

    /// A field of rank 1 with all points of a box, whose probes see planes at x = `wall`; probe p's row j is `value(p, j)` times λ, 1.
    fn field(spacing_m: f32, side: i32, wall_m: f32, value: impl Fn(IVec3, usize) -> f32) -> FieldTable {
        let mut points = Vec::new();
        for z in 0..side {
            for y in 0..side {
                points.extend((0..side).map(|x| IVec3::new(x, y, z)));
            }
        }
        let probes: Vec<Probe> =
            points.iter().map(|&point| Probe { key: ProbeKey::of(point).unwrap(), moved: [0; 3] }).collect();
        let depth = |probe: &Probe, at: usize| {
            let towards = map_direction(at).x / (wall_m - probe.position_m(spacing_m).x);
            depth_code(towards.max(0.0), spacing_m)
        };
        let depths =
            probes.iter().flat_map(|probe| (0..MAP_POINTS).map(move |at| depth(probe, at))).collect();
        let u = points.iter().flat_map(|&point| (0..PROBE_ROWS).map(move |j| (point, j)));
        let u: Vec<f32> = u.map(|(point, j)| value(point, j)).collect();
        let factors =
            TransportFactors { keys: vec![sky_key()], rank: 1, u, vt: vec![1.0], ..Default::default() };
        let part = FieldPart { spacing_m, probes, depths, factors, emitters: Vec::new() };
        FieldTable::join(&[part], 0, &columns()).unwrap()
    }

    fn sky_key() -> u64 {
        crate::content::PatchKey::of_sky(0).0
    }

    fn columns() -> PatchTable {
        let set = PatchSet { leaf_starts: vec![0], sky_parts: 1, ..PatchSet::default() };
        PatchTable::new(&set, &SlotTable::new([]).unwrap()).unwrap()
    }

    fn lit(table: &FieldTable) -> Vec<Vec4> {
        table.relit(&Serial, &vec![Vec4::ONE; columns().lambda_count()], &[])
    }

    #[test]
    fn linear_light_is_read_as_it_is_and_none_comes_from_beyond() {
        // Constant over normals: Y_0 = 1/√4π.
        let root = (4.0 * std::f32::consts::PI).sqrt();
        let table = field(0.5, 5, 100.0, |at, j| if j == 0 { root * (1.0 + at.x as f32) } else { 0.0 });
        let rows = lit(&table);
        for x in [0.0, 0.2, 0.77, 1.5, 1.99] {
            let read = table.irradiance(&rows, Vec3::new(x, 0.6, 1.1), Vec3::Y);
            assert!((read.x - (1.0 + x / 0.5)).abs() < 2e-3, "{read} at {x}");
        }
        assert_eq!(table.irradiance(&rows, Vec3::splat(50.0), Vec3::Y), Vec3::ZERO);
        assert_eq!(table.irradiance(&rows, Vec3::splat(f32::NAN), Vec3::Y), Vec3::ZERO);
        assert_eq!(table.irradiance(&rows, Vec3::splat(1e30), Vec3::Y), Vec3::ZERO);
    }

    #[test]
    fn points_behind_a_wall_see_no_probe_before_it() {
        // The wall stands between the third and the fourth probe along x; all maps are of probes on its near side.
        let table = field(0.5, 5, 1.2, |_, _| 1.0);
        let near = table.index_of(IVec3::new(2, 2, 2)).unwrap() as u32;
        for off_m in [0.05, 0.1, 0.3] {
            assert_eq!(table.visibility(near, Vec3::new(1.2 + off_m, 1.1, 0.9)), 0.0, "{off_m} behind");
            assert_eq!(table.visibility(near, Vec3::new(1.2 - off_m, 1.1, 0.9)), 1.0, "{off_m} before");
        }
        let far = table.index_of(IVec3::new(0, 0, 0)).unwrap() as u32;
        let grazing = Vec3::new(1.19, 2.0, 2.0);
        assert!(table.visibility(far, grazing) > 0.95, "{}", table.visibility(far, grazing));
    }

    #[test]
    fn probes_that_contradict_each_other_are_refused() {
        let probe = Probe { key: ProbeKey::of(IVec3::ONE).unwrap(), moved: [0; 3] };
        let part = |spacing_m: f32, point: IVec3| FieldPart {
            spacing_m,
            probes: vec![Probe { key: ProbeKey::of(point).unwrap(), ..probe }],
            depths: vec![0; MAP_POINTS],
            ..FieldPart::default()
        };
        let problem = |parts: &[FieldPart]| FieldTable::join(parts, 0, &columns()).unwrap_err().to_string();
        assert!(problem(&[part(0.5, IVec3::ONE), part(0.6, IVec3::ZERO)]).contains("0.6 m apart"));
        assert!(problem(&[part(0.5, IVec3::ONE), part(0.5, IVec3::ONE)]).contains("second probe"));
        let far = IVec3::splat(1000);
        assert!(problem(&[part(0.5, far), part(0.5, -far)]).contains("span"));
    }
}
