//! One row of the transport matrix: α_rpj by cosine-distributed rays.
//!
//! `α_rpj ≈ π/N Σ_n w_p V_p(y_n) Y_j(Ψ_p(y_n)) / Σ_q w_q V_q(y_n)`; a ray that meets nothing adds `π/N Y_j(ω_n)` to
//! the sky's columns.

use glam::Vec3;
use lightkiln_proto::harmonics::{MAX_COEFFICIENTS, ShBasis, band_of};

use super::ProbeTransport;
use super::supporters::{Supporter, Supporters};
use crate::emitters::EmitterSet;
use crate::geometry::{Grid, Trail};
use crate::lightmap::{Numbering, Receiver, Surface, World};
use crate::rays::Hit;
use crate::transport::{Hemisphere, HemisphereRay, Row};

/// Samples rows of one cluster cell.
pub struct AlphaSampler<'a> {
    world: &'a World,
    emitters: &'a EmitterSet,
    basis: ShBasis,
    window: Vec<f32>,
    supporters: Supporters,
    /// Indices of the columns' probes, ascending as their keys are.
    probes: Numbering<u32>,
    rays: u32,
    emitter_rays: u32,
}

/// State that one receiver's rays share.
struct Gather<'a> {
    receiver: &'a Receiver,
    origin_m: Vec3,
    supporters: Vec<Supporter>,
    /// Whether each supporter and the receiver see each other; found when first needed.
    mutual: Option<Vec<bool>>,
    row: Row,
}

impl<'a> AlphaSampler<'a> {
    /// A sampler whose columns are the probes that reach any of `receivers`.
    pub fn new(transport: &'a ProbeTransport, receivers: &[u32]) -> Self {
        let ProbeTransport { world, emitters, probes, settings } = transport;
        let (mut low_m, mut high_m) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &receiver in receivers {
            let position_m = world.lightmap.receivers[receiver as usize].position_m;
            (low_m, high_m) = (low_m.min(position_m), high_m.max(position_m));
        }
        let basis = ShBasis::new(settings.probes.bands as usize);
        let window = (0..basis.coefficients())
            .map(|j| basis.window(band_of(j), settings.probes.window_strength))
            .collect();
        let supporters = Supporters::reaching(&probes.probes, low_m, high_m);
        let probes = Numbering::of(supporters.indices());
        let (rays, emitter_rays) = (settings.transport.transport_rays, settings.transport.emitter_rays);
        Self { world, emitters, basis, window, supporters, probes, rays, emitter_rays }
    }

    /// Indices of the probes of the columns, in order.
    pub fn probes(&self) -> &[u32] {
        self.probes.values()
    }

    /// The row of a receiver.
    pub fn row(&self, receiver: u32) -> Row {
        let hemisphere = Hemisphere::new(self.world, self.emitters, receiver, self.rays);
        let receiver = &self.world.lightmap.receivers[receiver as usize];
        let mut gather = Gather {
            receiver,
            origin_m: hemisphere.origin_m(),
            supporters: self.supporters.around(receiver.position_m),
            mutual: None,
            row: Row {
                alpha: vec![0.0; (self.probes.len() + 1) * self.basis.coefficients()],
                ..Row::default()
            },
        };
        let grid = Grid::default();
        let surroundings = hemisphere.cast(self.emitter_rays, &Trail::new(&grid), |ray, hit| match hit {
            None => {
                gather.row.lit += 1.0;
                self.add_sky(&mut gather.row, ray.direction);
            }
            Some(hit) => self.add_hit(&mut gather, hit, ray),
        });
        gather.row.add_surroundings(surroundings);
        self.finish(&mut gather.row);
        gather.row
    }

    /// `Y_j(ω)` into the sky's columns.
    fn add_sky(&self, row: &mut Row, direction: Vec3) {
        let count = self.basis.coefficients();
        let mut y = [0.0; MAX_COEFFICIENTS];
        self.basis.evaluate(direction, &mut y);
        let sky = row.alpha.len() - count;
        row.alpha[sky..].iter_mut().zip(&y).for_each(|(alpha, y)| *alpha += y);
    }

    /// `w_p V_p(y) Y_j(Ψ_p(y)) / Σ_q w_q V_q(y)` into the columns of the probes that see the hit.
    fn add_hit(&self, gather: &mut Gather, hit: &Hit, ray: HemisphereRay) {
        let Surface::Receiver(met) = self.world.surface_at(hit) else {
            let (row, lost) = (&mut gather.row, self.world.lost_in_cavity(hit));
            (row.lit, row.uncovered, row.left_out) =
                (row.lit + lost, row.uncovered + lost, row.left_out + lost);
            return;
        };
        let tracer = &self.world.geometry.tracer;
        let side = self.world.geometry.side_normal(hit);
        let met_m = ray.origin_m + ray.direction * hit.t;
        let point_m = met_m + side * tracer.ray_offset_m(met_m);
        let albedo = self.world.lightmap.receivers[met as usize].albedo;
        let share = (albedo[0] + albedo[1] + albedo[2]) / 3.0;
        gather.row.lit += share;
        let mut seen = Vec::with_capacity(gather.supporters.len());
        let mut total = 0.0;
        for supporter in &gather.supporters {
            if (supporter.position_m - point_m).dot(side) <= 0.0 {
                continue;
            }
            if !tracer.is_occluded(point_m, supporter.position_m) {
                total += supporter.weight;
                seen.push(*supporter);
            }
        }
        if seen.is_empty() {
            gather.row.uncovered += share;
            seen = self.supporters_in_sight(gather);
            total = seen.iter().map(|supporter| supporter.weight).sum();
            if seen.is_empty() {
                gather.row.left_out += share;
            }
        }
        self.share_out(&mut gather.row, &seen, total, point_m);
    }

    /// Adds `w_p/Σw · Y_j(Ψ_p(y))` for each of `seen`.
    fn share_out(&self, row: &mut Row, seen: &[Supporter], total: f32, point_m: Vec3) {
        let count = self.basis.coefficients();
        let mut y = [0.0; MAX_COEFFICIENTS];
        for supporter in seen {
            let Some(towards) = (point_m - supporter.position_m).try_normalize() else { continue };
            self.basis.evaluate(towards, &mut y);
            let weight = supporter.weight / total;
            let column = self.probes.place(supporter.probe);
            row.alpha[column * count..(column + 1) * count]
                .iter_mut()
                .zip(&y)
                .for_each(|(alpha, y)| *alpha += weight * y);
        }
    }

    /// Supporters that the receiver itself sees: a hit seen by none is spread over them, as that crosses no wall.
    fn supporters_in_sight(&self, gather: &mut Gather) -> Vec<Supporter> {
        let (origin_m, face_normal) = (gather.origin_m, gather.receiver.face_normal);
        let supporters = &gather.supporters;
        let mutual = gather.mutual.get_or_insert_with(|| {
            let sees = |supporter: &Supporter| {
                (supporter.position_m - origin_m).dot(face_normal) > 0.0
                    && !self.world.geometry.tracer.is_occluded(origin_m, supporter.position_m)
            };
            supporters.iter().map(sees).collect()
        });
        supporters
            .iter()
            .zip(mutual.iter())
            .filter(|(_, sees)| **sees)
            .map(|(supporter, _)| *supporter)
            .collect()
    }

    /// The factor π/N, and the window of each band.
    fn finish(&self, row: &mut Row) {
        let scale = std::f32::consts::PI / self.rays as f32;
        for coefficients in row.alpha.chunks_exact_mut(self.basis.coefficients()) {
            for (alpha, window) in coefficients.iter_mut().zip(&self.window) {
                *alpha *= scale * window;
            }
        }
    }
}
