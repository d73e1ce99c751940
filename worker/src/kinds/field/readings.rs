//! Other ways to read light between probes than depth maps, to compare: with what rays say is seen, and as other engines do.

use glam::{Vec3, Vec4};
use lightkiln_proto::harmonics::ShBasis;
use lightkiln_proto::kinds::field::{Between, FieldTable, PROBE_ROWS};
use lightkiln_proto::lobes::{self, FARTHEST, Lobe};

use crate::geometry::Geometry;

/// Names of the classes of error: causes, then other ways to read probes, as in [`Reading::ALL`].
pub const CLASSES: [&str; 8] =
    ["angular", "interpolation", "held", "visibility", "exact", "chebyshev", "valid", "all"];

/// Distance by which a point counts as nearer than it is, in distances between probes.
const BIAS: f32 = 0.01;

/// A way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Probes that a ray from the point meets count, others do not.
    Exact,
    /// Mean distance and variance over a lobe, by Chebyshev's inequality (\[Luo2022\] eq. 4.10).
    Chebyshev,
    /// All probes around a point count.
    Valid,
    /// So do points of the lattice without a probe, as dark.
    All,
}

impl Reading {
    /// All ways, as at the end of [`CLASSES`].
    pub const ALL: [Self; 4] = [Self::Exact, Self::Chebyshev, Self::Valid, Self::All];

    /// In a few words.
    pub fn about(self) -> &'static str {
        match self {
            Self::Exact => "with probes seen by rays, not by depth maps",
            Self::Chebyshev => "with moments of distances and Chebyshev's inequality",
            Self::Valid => "with all probes of a cage",
            Self::All => "with all points of a cage, those without a probe dark",
        }
    }

    /// Probes that a point's light comes from, and their weights.
    pub fn weights(self, field: &FieldTable, geometry: &Geometry, point_m: Vec3) -> Vec<(u32, f32)> {
        let mut found = field.cage(point_m);
        for (probe, weight) in &mut found {
            let place_m = field.position_m[*probe as usize].truncate();
            *weight *= match self {
                Self::Exact => f32::from(!geometry.tracer.is_occluded(place_m, point_m)),
                Self::Chebyshev => chebyshev(field, *probe, point_m - place_m),
                Self::Valid | Self::All => 1.0,
            };
        }
        if self != Self::All {
            let sum: f32 = found.iter().map(|(_, weight)| weight).sum();
            found.iter_mut().for_each(|(_, weight)| *weight /= sum.max(1e-6));
        }
        found
    }

    /// Irradiance at a point and normal in W·m⁻².
    pub fn irradiance(
        self,
        (field, rows): (&FieldTable, &[Vec4]),
        geometry: &Geometry,
        point_m: Vec3,
        normal: Vec3,
    ) -> Vec3 {
        let mut harmonics = [0.0; PROBE_ROWS];
        ShBasis::new(2).evaluate(normal, &mut harmonics);
        let of_probe = |(probe, weight): (u32, f32)| -> Vec4 {
            let own = &rows[PROBE_ROWS * probe as usize..][..PROBE_ROWS];
            own.iter().zip(harmonics).map(|(row, harmonic)| *row * harmonic * weight).sum()
        };
        let sum: Vec4 = self.weights(field, geometry, point_m).into_iter().map(of_probe).sum();
        sum.truncate().max(Vec3::ZERO)
    }
}

/// `V = 1 where d − bias ≤ μ, else (σ²/(σ² + (d − bias − μ)²))³`, in distances between probes.
fn chebyshev(field: &FieldTable, probe: u32, to: Vec3) -> f32 {
    let spacing_m = match &field.between {
        Between::Lattice(_) => field.spacing_m,
        Between::Tetrahedra(tetrahedra) => tetrahedra.cell_m,
    };
    let distance = to.length() / spacing_m;
    if distance < 1e-6 {
        return 1.0;
    }
    let far = |ray: usize| (field.distance_m(probe, lobes::directions()[ray]) / spacing_m).min(FARTHEST);
    let [mean, square] = Lobe::around(to.normalize()).moments(far);
    let beyond = distance - BIAS - mean;
    if beyond <= 0.0 {
        return 1.0;
    }
    let variance = (square - mean * mean).abs();
    (variance / (variance + beyond * beyond)).powi(3)
}

/// How depth maps and rays agree at points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Points.
    pub points: usize,
    /// Share of weight that comes through walls.
    pub through: f64,
    /// Share of the weight of probes that are seen, by rays, which depth maps reject.
    pub rejected: f64,
    /// Share of points with no probe that they see, by rays, around them.
    pub unseen: f64,
}

impl Agreement {
    /// At some points.
    pub fn at(field: &FieldTable, geometry: &Geometry, points_m: impl Iterator<Item = Vec3>) -> Self {
        let mut found = Self::default();
        for point_m in points_m {
            let sees = |probe: u32| {
                !geometry.tracer.is_occluded(field.position_m[probe as usize].truncate(), point_m)
            };
            found.points += 1;
            let read = field.weights(point_m);
            found.through += read.iter().filter(|of| !sees(of.0)).map(|of| f64::from(of.1)).sum::<f64>();
            let seen: Vec<(u32, f32)> = field.cage(point_m).into_iter().filter(|of| sees(of.0)).collect();
            let sum: f64 = seen.iter().map(|of| f64::from(of.1)).sum();
            let hidden = seen.iter().map(|of| f64::from(of.1 * (1.0 - field.visibility(of.0, point_m))));
            found.rejected += if sum > 0.0 { hidden.sum::<f64>() / sum } else { 0.0 };
            found.unseen += f64::from(u8::from(sum < 1e-4));
        }
        let count = found.points.max(1) as f64;
        for share in [&mut found.through, &mut found.rejected, &mut found.unseen] {
            *share /= count;
        }
        found
    }

    /// In words.
    pub fn words(&self) -> String {
        let Self { points, through, rejected, unseen } = self;
        let [through, rejected, unseen] = [through, rejected, unseen].map(|share| 100.0 * share);
        format!(
            "of the weight of probes at {points} points {through:.2} % comes through walls, {rejected:.2} % of what rays see is \
             rejected; {unseen:.2} % of the points see no probe around them"
        )
    }
}
