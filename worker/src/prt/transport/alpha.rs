//! One row of the transport matrix: α_rpj by cosine-distributed rays.
//!
//! `α_rpj ≈ π/N Σ_n w_p V_p(y_n) Y_j(Ψ_p(y_n)) / Σ_q w_q V_q(y_n)`; a ray that meets nothing adds `π/N Y_j(ω_n)` to
//! the sky's columns.

use glam::Vec3;
use lightkiln_proto::prt::Settings;
use lightkiln_proto::sh::{MAX_COEFFICIENTS, ShBasis, band_of};

use super::hemisphere::Hemisphere;
use super::near::NearHit;
use super::supporters::{Supporter, Supporters};
use crate::prt::stage::Receiver;
use crate::prt::world::{Surface, World};
use crate::rays::Hit;
use crate::task::Progress;

/// α of one receiver and what was met on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Coefficients: those of each probe of [`AlphaSampler::probes`], then the sky's.
    pub alpha: Vec<f32>,
    /// With patches: what is truncated (see `expectation`), and how much noise is in it: what rays of even number gave, less
    /// what the rest gave. One value more for what all patches have in common, before the sky's, and one for all of the
    /// sky, after them. Empty where nothing is truncated.
    pub weighed: [Vec<f32>; 2],
    /// Irradiance straight from each emitter of the world, W·m⁻².
    pub emitters: Vec<[f32; 3]>,
    /// Rays that light can come along: those to the sky, and those to surfaces by their albedo.
    pub lit: f32,
    /// The part of `lit` that no supporting probe sees.
    pub uncovered: f32,
    /// The part of `uncovered` that was left out, as no supporting probe is in sight of the receiver either.
    pub left_out: f32,
    /// Hits that are read at their very points; they are not in `alpha`.
    pub near: Vec<NearHit>,
    /// What each of them counts by, `∫ cosθ dω`.
    pub near_weight: f32,
    /// Mean length of the rays that met something, in metres.
    pub mean_path_m: f32,
    /// Closest-hit rays cast.
    pub rays_closest: u64,
    /// Occlusion rays cast.
    pub rays_occlusion: u64,
}

impl Row {
    /// Adds what was cast to the task's progress, and one receiver done.
    pub fn count(&self, progress: &Progress) {
        progress.add_rays_closest(self.rays_closest);
        progress.add_rays_occlusion(self.rays_occlusion);
        progress.advance(1);
    }

    /// No light can ever come here: no probe, sky or emitter is in sight of anything in sight. So it is in cavities of
    /// solids and on parts of surfaces that are sunk in others.
    pub fn is_dead(&self) -> bool {
        let no_hits =
            self.near.iter().all(|hit| hit.texel().is_none()) && self.alpha.iter().all(|alpha| *alpha == 0.0);
        no_hits && self.emitters.iter().flatten().all(|e| *e == 0.0)
    }
}

/// Samples rows of one cluster cell.
pub struct AlphaSampler<'a> {
    world: &'a World,
    basis: ShBasis,
    window: Vec<f32>,
    supporters: Supporters,
    /// Stage indices of the columns' probes, ascending by key.
    probes: Vec<u32>,
    rays: u32,
    emitter_rays: u32,
}

/// What one receiver's rays share.
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
    pub fn new(world: &'a World, settings: &Settings, receivers: &[u32]) -> Self {
        let (mut low_m, mut high_m) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &receiver in receivers {
            let position_m = world.stage.receivers[receiver as usize].position_m;
            (low_m, high_m) = (low_m.min(position_m), high_m.max(position_m));
        }
        let basis = ShBasis::new(settings.bands as usize);
        let window =
            (0..basis.coefficients()).map(|j| basis.window(band_of(j), settings.window_strength)).collect();
        let supporters = Supporters::reaching(&world.stage.probes, low_m, high_m);
        let probes = supporters.indices().collect();
        let (rays, emitter_rays) = (settings.transport_rays, settings.emitter_rays);
        Self { world, basis, window, supporters, probes, rays, emitter_rays }
    }

    /// Stage indices of the probes of the columns, in order.
    pub fn probes(&self) -> &[u32] {
        &self.probes
    }

    /// The row of a receiver.
    pub fn row(&self, receiver: u32) -> Row {
        let receiver = &self.world.stage.receivers[receiver as usize];
        let hemisphere = Hemisphere::new(self.world, receiver, self.rays);
        let mut gather = Gather {
            receiver,
            origin_m: hemisphere.origin_m,
            supporters: self.supporters.around(receiver.position_m),
            mutual: None,
            row: Row {
                alpha: vec![0.0; (self.probes.len() + 1) * self.basis.coefficients()],
                ..Row::default()
            },
        };
        let (emitters, mean_path_m, rays_occlusion) =
            hemisphere.cast(self.emitter_rays, |direction, hit| match hit {
                None => {
                    gather.row.lit += 1.0;
                    self.add_sky(&mut gather.row, direction);
                }
                Some(hit) => self.add_hit(&mut gather, hit, direction),
            });
        (gather.row.emitters, gather.row.mean_path_m) = (emitters, mean_path_m);
        gather.row.rays_occlusion += rays_occlusion;
        gather.row.rays_closest = u64::from(self.rays);
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
    fn add_hit(&self, gather: &mut Gather, hit: &Hit, direction: Vec3) {
        let Surface::Receiver(met) = self.world.surface_at(hit) else {
            let (row, lost) = (&mut gather.row, self.world.lost_in_cavity(hit));
            (row.lit, row.uncovered, row.left_out) =
                (row.lit + lost, row.uncovered + lost, row.left_out + lost);
            return;
        };
        let tracer = &self.world.geometry.tracer;
        let side = self.world.side_normal(hit);
        let point_m = gather.origin_m + direction * hit.t + side * tracer.ray_offset_m();
        let albedo = self.world.stage.receivers[met as usize].albedo;
        let share = (albedo[0] + albedo[1] + albedo[2]) / 3.0;
        gather.row.lit += share;
        let mut seen = Vec::with_capacity(gather.supporters.len());
        let mut total = 0.0;
        for supporter in &gather.supporters {
            if (supporter.position_m - point_m).dot(side) <= 0.0 {
                continue;
            }
            gather.row.rays_occlusion += 1;
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
            let Ok(column) = self.probes.binary_search(&supporter.probe) else { continue };
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
        let rays = &mut gather.row.rays_occlusion;
        let mutual = gather.mutual.get_or_insert_with(|| {
            let sees = |supporter: &Supporter| {
                (supporter.position_m - origin_m).dot(face_normal) > 0.0 && {
                    *rays += 1;
                    !self.world.geometry.tracer.is_occluded(origin_m, supporter.position_m)
                }
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
