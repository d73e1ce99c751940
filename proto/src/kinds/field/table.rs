//! The field at run time: which probes are near a point, light at probes from λ, and irradiance at any point and normal.

use std::f32::consts::PI;
use std::sync::LazyLock;

use glam::{Vec3, Vec4};

use super::content::{FieldPart, PROBE_ROWS, depth_of};
use super::dering::deringed;
use super::lattice::LatticeTable;
use super::octahedron::{MAP_POINTS, map_points, octahedral_length};
use super::tetrahedra::{TetrahedraTable, TetrahedronSet};
use crate::harmonics::ShBasis;
use crate::relight::{ClusterTable, Columns, EmitterTable, Inconsistent, Parallel};

/// Harmonics of a probe's rows.
static BASIS: LazyLock<ShBasis> = LazyLock::new(|| ShBasis::new(2));

/// Share of a depth over which a point beyond it goes from seen to hidden.
const HIDDEN_SHARE: f32 = 0.05;
/// The same in metres, at most: a point 2 cm behind a wall of 2 cm is hidden however far the probe is. *We differ* from a share alone,
/// which is 10 cm at a probe 2 m away.
const HIDDEN_IN_LATTICE_M: f32 = 0.04;
/// Likewise in tetrahedra, whose probes beyond a sheet lie farther from it: a point 2 cm behind one is hidden.
const HIDDEN_IN_TETRAHEDRA_M: f32 = 0.02;
/// Share of its distance from a probe by which a point may lie behind a surface and still be lit by that probe where no other sees it:
/// depth maps round edges off by as much.
const ROUNDED_SHARE: f32 = 0.15;
/// Share of a lattice's step that it may lie behind at most, and least such bound in metres: what lies deeper is in a hollow, which light that
/// far off says nothing about.
const ROUNDED_STEPS: f32 = 0.06;
const ROUNDED_LEAST_M: f32 = 0.04;
/// Depth in metres over which such probes count less, from that of the least on.
const ROUNDED_M: f32 = 0.01;
/// Height over surfaces at which they read their light, over the distance between probes, and at most, in metres.
const RAISED_STEPS: f32 = 0.1;
const RAISED_MOST_M: f32 = 0.1;
/// Least sum of weights for which a cage's probes count; below it, those of the cages around it do.
const WEIGHT_MIN: f32 = 1e-4;

/// Space between probes: which of them stand around a point.
#[derive(Debug)]
pub enum Between {
    /// Cells of a lattice, each with eight corners.
    Lattice(LatticeTable),
    /// Tetrahedra, each with four.
    Tetrahedra(TetrahedraTable),
}

impl Default for Between {
    fn default() -> Self {
        Self::Lattice(LatticeTable::default())
    }
}

/// Probes, their depth maps and their transport.
#[derive(Debug, Default)]
pub struct FieldTable {
    /// Step h in metres of the lattice that keys of probes name points of.
    pub spacing_m: f32,
    /// Space between them.
    pub between: Between,
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
    /// Joins parts, of a bake of so many emitters, whose columns read `columns`; probes on a lattice, or in tetrahedra where there are some.
    pub fn join(
        parts: &[FieldPart],
        tetrahedra: Option<&TetrahedronSet>,
        emitters: usize,
        columns: &impl Columns,
    ) -> Result<Self, Inconsistent> {
        let of_parts = || parts.iter().map(|part| PROBE_ROWS * part.probes.len());
        let clusters = ClusterTable::join(parts.iter().map(|part| &part.factors).zip(of_parts()), columns)?;
        let direct =
            EmitterTable::join(parts.iter().map(|part| &part.emitters[..]).zip(of_parts()), emitters)?;
        let spacing_m = parts.first().map_or(1.0, |part| part.spacing_m);
        if let Some(index) = parts.iter().position(|part| part.spacing_m != spacing_m) {
            let problem =
                format!("its probes stand {} m apart, others {spacing_m} m", parts[index].spacing_m);
            return Err(Inconsistent::new(format!("field {index}"), problem));
        }
        let between = match tetrahedra {
            None => Between::Lattice(LatticeTable::of(parts)?),
            Some(set) => Between::Tetrahedra(TetrahedraTable::of(parts, set)?),
        };
        let probes = || parts.iter().flat_map(|part| &part.probes);
        Ok(Self {
            spacing_m,
            between,
            position_m: probes().map(|probe| probe.position_m(spacing_m).extend(0.0)).collect(),
            depths: parts.iter().flat_map(|part| &part.depths).copied().collect(),
            clusters,
            emitters: direct,
        })
    }

    /// Probes.
    pub fn len(&self) -> usize {
        self.position_m.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.position_m.is_empty()
    }

    /// Coefficients of irradiance at probes, [`PROBE_ROWS`] each, W·m⁻², with the light of emitters of that scale, without ringing.
    pub fn relit(&self, parallel: &impl Parallel, lambda: &[Vec4], emitter_scale: &[f32]) -> Vec<Vec4> {
        let direct = self.emitters.irradiance(PROBE_ROWS * self.len(), emitter_scale);
        let b = self.clusters.basis(parallel, lambda);
        deringed(parallel, &self.clusters.reconstruct(parallel, &b, &direct, None))
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

    /// The place at which a surface reads its light, off it on the seen side by the less of 0.1 h and 10 cm: at the surface itself, a thin one
    /// would have light of both of its sides.
    pub fn raised(&self, point_m: Vec3, facet: Vec3) -> Vec3 {
        let h_m = match &self.between {
            Between::Lattice(_) => self.spacing_m,
            Between::Tetrahedra(tetrahedra) => tetrahedra.cell_m,
        };
        point_m + facet * (RAISED_STEPS * h_m).min(RAISED_MOST_M)
    }

    /// Depth in metres at which a point behind a surface is hidden at the latest.
    fn hidden_m(&self) -> f32 {
        match self.between {
            Between::Lattice(_) => HIDDEN_IN_LATTICE_M,
            Between::Tetrahedra(_) => HIDDEN_IN_TETRAHEDRA_M,
        }
    }

    /// Share of a probe's light that counts at a point, by its depth map: 1 before the nearest surface, 0 behind it.
    ///
    /// `V = clamp(1 − (1 − s_x/s)/t, 0, 1)` with the reciprocals of octahedral distances s_x of the point and s of the surface, and
    /// `t = min(0.05, 4 cm · s_x)`, in tetrahedra 2 cm.
    pub fn visibility(&self, probe: u32, point_m: Vec3) -> f32 {
        let [excess_m, distance_m] = self.excess(probe, point_m);
        if excess_m == 0.0 {
            return 1.0;
        }
        (1.0 - excess_m / self.hidden_m().min(HIDDEN_SHARE * distance_m)).max(0.0)
    }

    /// Probes that a point's light comes from, and their weights, which add up to 1; none where no probe is near that sees it.
    ///
    /// On a lattice trilinear weights of the point's cage, and a tent within it of its own probe; in tetrahedra barycentric ones; times
    /// visibility. Where that leaves nothing, those of a wider surrounding; and where these do, as in corners that depth maps round off, of
    /// the probes that it lies least far behind.
    pub fn weights(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        let found = self.seen(&self.cage(point_m), point_m);
        if !found.is_empty() {
            return found;
        }
        let wide = self.wide(point_m);
        let found = self.seen(&wide, point_m);
        if !found.is_empty() {
            return found;
        }
        let all = wide.iter().map(|&(probe, tent)| (probe, tent, self.excess(probe, point_m)));
        let rounded_m = match self.between {
            Between::Lattice(_) => (ROUNDED_STEPS * self.spacing_m).max(ROUNDED_LEAST_M),
            Between::Tetrahedra(_) => HIDDEN_IN_TETRAHEDRA_M,
        };
        let is_near = |[excess_m, far_m]: [f32; 2]| excess_m <= ROUNDED_SHARE * far_m && excess_m < rounded_m;
        let all: Vec<_> = all.filter(|(.., excess)| is_near(*excess)).collect();
        let least_m = all.iter().map(|(_, _, [excess_m, _])| *excess_m).fold(f32::INFINITY, f32::min);
        let weight = |(probe, tent, [excess_m, _]): (u32, f32, [f32; 2])| {
            (probe, tent * (1.0 - (excess_m - least_m) / ROUNDED_M).max(0.0))
        };
        normalised(all.into_iter().map(weight))
    }

    /// Weights of some probes times visibility, which add up to 1; none where next to nothing is left.
    pub fn seen(&self, near: &[(u32, f32)], point_m: Vec3) -> Vec<(u32, f32)> {
        normalised(near.iter().map(|&(probe, weight)| (probe, weight * self.visibility(probe, point_m))))
    }

    /// Probes around a point, and their tents, whether they see it or not; less than 1 in all where a corner of the cage has no probe.
    pub fn cage(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        match &self.between {
            Between::Lattice(lattice) => lattice.around(point_m / self.spacing_m, 0..2, 1.0),
            Between::Tetrahedra(tetrahedra) => tetrahedra.around(point_m),
        }
    }

    /// Likewise of a wider surrounding.
    pub fn wide(&self, point_m: Vec3) -> Vec<(u32, f32)> {
        match &self.between {
            Between::Lattice(lattice) => lattice.around(point_m / self.spacing_m, -1..3, 2.0),
            Between::Tetrahedra(tetrahedra) => tetrahedra.wide(point_m),
        }
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

    /// Mean radiance over all directions at a point in W·m⁻²·sr⁻¹: irradiance is π times as much in the mean over normals.
    pub fn mean_radiance(&self, rows: &[Vec4], point_m: Vec3) -> Vec3 {
        let mut harmonics = [0.0; PROBE_ROWS];
        BASIS.evaluate(Vec3::Y, &mut harmonics);
        (self.coefficients(rows, point_m)[0].truncate() * (harmonics[0] / PI)).max(Vec3::ZERO)
    }
}

/// Weights that add up to 1; none where they are next to nothing.
pub fn normalised(weights: impl Iterator<Item = (u32, f32)>) -> Vec<(u32, f32)> {
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
    use glam::IVec3;

    use super::super::content::{Probe, ProbeKey, depth_code};
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
        FieldTable::join(&[part], None, 0, &columns()).unwrap()
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
        let near = 2 * 25 + 2 * 5 + 2;
        for off_m in [0.05, 0.1, 0.3] {
            assert_eq!(table.visibility(near, Vec3::new(1.2 + off_m, 1.1, 0.9)), 0.0, "{off_m} behind");
            assert_eq!(table.visibility(near, Vec3::new(1.2 - off_m, 1.1, 0.9)), 1.0, "{off_m} before");
        }
        let far = 0;
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
        let problem =
            |parts: &[FieldPart]| FieldTable::join(parts, None, 0, &columns()).unwrap_err().to_string();
        assert!(problem(&[part(0.5, IVec3::ONE), part(0.6, IVec3::ZERO)]).contains("0.6 m apart"));
        assert!(problem(&[part(0.5, IVec3::ONE), part(0.5, IVec3::ONE)]).contains("second probe"));
        let far = IVec3::splat(1000);
        assert!(problem(&[part(0.5, far), part(0.5, -far)]).contains("span"));
    }
}
