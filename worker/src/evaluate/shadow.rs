//! Direct light as a client's shadow maps have it, beside that of exact rays.

use glam::{DVec3, Vec4};
use rayon::prelude::*;
use serde::Serialize;

use super::EvaluationError;
use super::figures::{RelativeRoot, SquareTerm};
use crate::geometry::Site;
use crate::rays::sampling::{R2, seed_of, tangent_frame};
use crate::reference::{Lighting, Reference, luminance};

/// Points around a pixel, within the filter of its shadow map, that exact rays look from.
const AROUND: u32 = 32;
/// Points of lights with extent that exact rays look at.
const EXTENT_POINTS: u32 = 16;
/// The same for the error of E_dir.
const ERROR_POINTS: u32 = 256;
/// Share of a light's unshadowed irradiance from which on its presence, or its lack, is counted.
const SHARE_MIN: f64 = 0.05;

/// A client that lights a scene by shadow maps.
pub trait ClientLights: Send + Sync {
    /// The client's direct light; `None` where it has no such lights.
    fn under<'a>(&'a self, lighting: &Lighting)
    -> Result<Option<Box<dyn MappedLight + 'a>>, EvaluationError>;
}

/// Direct light of one lighting by shadow maps.
pub trait MappedLight: Sync {
    /// Light that bounces start from; `None` for kinds that bounce no such light.
    fn incoming(&self) -> Option<MappedIncoming>;

    /// Direct light of a pixel.
    fn at(&self, site: &Site) -> MappedPixel;
}

/// E_dir of receivers by slot and of near hits, W·m⁻².
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MappedIncoming {
    /// By slot.
    pub receivers: Vec<Vec4>,
    /// By near hit.
    pub near: Vec<Vec4>,
}

/// Direct light of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MappedPixel {
    /// E_dir as shown, W·m⁻².
    pub shown: DVec3,
    /// E_dir without any shadow.
    pub unshadowed: DVec3,
    /// Reach of the shadow map's filter on the surface, in metres.
    pub filter_m: f32,
    /// Part of the light without shadows by which it changes at once at shadows of lights with extent, which are those of a few
    /// points; 0 for lights without.
    pub coarse: f64,
}

/// Shares of the area of pixels whose direct light is wrong beyond the reach of the filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DirectShares {
    /// Direct light is there, though exact rays all around find none.
    pub leak: f64,
    /// Direct light is lacking, though exact rays all around find it.
    pub acne: f64,
    /// Pixels looked at.
    pub pixels: usize,
    /// Root mean square error of E_dir as shown against exact rays, over the mean.
    pub error: RelativeRoot,
}

impl DirectShares {
    /// Looks at sites, each with the area that it stands for; and the relative squares of the error's draws.
    pub(super) fn of(
        sites: &[(Site, f64)],
        mapped: &dyn MappedLight,
        reference: &Reference,
    ) -> (Self, Vec<f64>) {
        let faults: Vec<[bool; 2]> =
            sites.par_iter().map(|(site, _)| faults(site, &mapped.at(site), reference)).collect();
        let area: f64 = sites.iter().map(|(_, area)| area).sum();
        let share = |which: usize| {
            let faulty = sites.iter().zip(&faults).filter(|(_, fault)| fault[which]);
            faulty.fold(0.0, |sum, ((_, part), _)| sum + part) / area.max(f64::MIN_POSITIVE)
        };
        let term = |(site, area): &(Site, f64)| {
            let reference = luminance(reference.direct_irradiance(site, ERROR_POINTS));
            let square = (luminance(mapped.at(site).shown) - reference).powi(2);
            SquareTerm { weight: *area, square, reference }
        };
        let terms: Vec<SquareTerm> = sites.par_iter().map(term).collect();
        let (error, draws) = RelativeRoot::of(&terms);
        (Self { leak: share(0), acne: share(1), pixels: sites.len(), error }, draws)
    }
}

/// Whether a pixel's direct light leaks, and whether it is lacking.
fn faults(site: &Site, pixel: &MappedPixel, reference: &Reference) -> [bool; 2] {
    let [shown, unshadowed] = [pixel.shown, pixel.unshadowed].map(luminance);
    if unshadowed <= 0.0 {
        return [false; 2];
    }
    let share = shown / unshadowed;
    let least = SHARE_MIN + pixel.coarse;
    let points = if pixel.coarse > 0.0 { EXTENT_POINTS } else { 1 };
    let exact = |site: &Site| luminance(reference.direct_irradiance(site, points));
    let is_lit = |site: &Site| exact(site) > 0.0;
    // Behind glass less light is right; so is what a light's few points make of the edge of a shadow.
    let is_brighter = |site: &Site| exact(site) > shown * (1.0 + SHARE_MIN) + pixel.coarse * unshadowed;
    let around = || std::iter::once(*site).chain(around(site, pixel.filter_m));
    [
        share > least && !around().any(|site| is_lit(&site)),
        share < 1.0 - least && around().all(|site| is_lit(&site) && is_brighter(&site)),
    ]
}

/// Points of the plane of a site within a distance, half of them on its rim. Points in or under other surfaces count as
/// dark, so that fewer pixels are called faulty there.
fn around(site: &Site, reach_m: f32) -> impl Iterator<Item = Site> {
    let site = *site;
    let points = R2::new(seed_of(&site.identity()));
    let (tangent, bitangent) = tangent_frame(site.face_normal);
    (0..AROUND).map(move |index| {
        let [turn, radius] = points.point(index);
        let radius = if index % 2 == 0 { 1.0 } else { radius.sqrt() };
        let (sine, cosine) = libm::sincosf(std::f32::consts::TAU * turn);
        let offset_m = (tangent * cosine + bitangent * sine) * (radius * reach_m);
        Site { position_m: site.position_m + offset_m, ..site }
    })
}
