//! The whole frame on the processor, by the passes' references.

use glam::Vec4;
use lightkiln_proto::prt::BasisKind;

use super::{Prepared, jitters};
use crate::bake::LoadedBake;
use crate::error::Result;
use crate::lights::Sky;
use crate::passes::atlas::reference::spread;
use crate::passes::basis::reference::basis;
use crate::passes::direct::reference::direct;
use crate::passes::near::reference::near;
use crate::passes::patches::reference::mean_radiance;
use crate::passes::patches::sky_radiance;
use crate::passes::reconstruct::reference::reconstruct;
use crate::passes::relight::RelightTable;
use crate::passes::relight::reference::{Irradiance, relight};
use crate::passes::shade::ShadeView;
use crate::passes::shade::reference::{Lit, shade};
use crate::passes::shadow::reference::{ShadowMaps, draw};
use crate::picture::{Film, Picture};

/// Irradiance after the bounces have settled.
pub(super) struct Settled {
    pub dir: Vec<Vec4>,
    pub emit: Vec<Vec4>,
    pub ind: Vec<Vec4>,
    pub frames: u32,
    pub converged: bool,
}

/// Draws the picture.
pub(super) fn render(prepared: &Prepared<'_>) -> Result<Picture> {
    let Prepared { bake, view, plan, sky } = prepared;
    let maps = draw(bake, plan);
    let settled = settle(prepared, &maps);
    let atlas = spread(&bake.atlas, &settled.emit, &settled.ind);
    let lit = Lit { bake, plan, maps: &maps, atlas: &atlas, emitter_scale: &view.emitter_scale };
    let mut film: Option<Film> = None;
    for jitter in jitters(view.samples) {
        let shade_view = ShadeView::new(&view.camera, view.size(), bake.manifest.bounds_m, *sky, jitter)?;
        let radiance = shade(lit, &shade_view, view.size());
        film.get_or_insert_with(|| Film::new(view.size(), view.tone, view.exposure, &radiance))
            .add(&radiance);
    }
    let film = film.unwrap_or_else(|| Film::new(view.size(), view.tone, view.exposure, &[]));
    let (frames, converged) = (settled.frames, settled.converged);
    Ok(Picture { by_reference: true, frames, converged, ..film.develop() })
}

/// What carries light, by the bake's basis.
enum Lambda {
    /// Spherical harmonics at probes.
    Probes(RelightTable),
    /// Means of patches, with the radiance of the sky's parts.
    Patches(Vec<Vec4>),
}

impl Lambda {
    fn new(bake: &LoadedBake, sky: Sky) -> Self {
        match bake.manifest.settings.basis {
            BasisKind::Sh => Self::Probes(RelightTable::new(bake, sky)),
            BasisKind::Patches => Self::Patches(sky_radiance(bake, sky)),
        }
    }

    fn next(&self, bake: &LoadedBake, irradiance: Irradiance<'_>) -> Vec<Vec4> {
        match self {
            Self::Probes(table) => relight(bake, table, irradiance),
            Self::Patches(sky) => mean_radiance(bake, sky, irradiance),
        }
    }
}

/// Feeds bounces back until E_ind changes by less than the view's limit.
pub(super) fn settle(prepared: &Prepared<'_>, maps: &ShadowMaps) -> Settled {
    let Prepared { bake, view, plan, sky } = prepared;
    let dir = direct(&bake.receivers.position_m, &bake.receivers.normal, plan, maps);
    let dir_near = direct(&bake.near.position_m, &bake.near.normal, plan, maps);
    let lambda_of = Lambda::new(bake, *sky);
    let emit = bake.emitter_irradiance(&view.emitter_scale);
    let ind = vec![Vec4::ZERO; bake.receivers.len()];
    let mut settled = Settled { dir, emit, ind, frames: 0, converged: false };
    while settled.frames < view.frames_max && !settled.converged {
        let irradiance = Irradiance { dir: &settled.dir, emit: &settled.emit, ind: &settled.ind };
        let lambda = lambda_of.next(bake, irradiance);
        let b = basis(&bake.clusters, &lambda, bake.coefficients());
        let near = near(bake, &dir_near, irradiance);
        let next = reconstruct(&bake.clusters, &b, &near, &settled.emit);
        settled.converged = change(&settled.ind, &next) < view.change_max;
        settled.ind = next;
        settled.frames += 1;
    }
    settled
}

/// Relative change from one frame's E_ind to the next: Σ|next − last| / Σ|next|; 0 when both are black.
pub(crate) fn change(last: &[Vec4], next: &[Vec4]) -> f32 {
    let (mut difference, mut total) = (0.0_f64, 0.0_f64);
    for (last, next) in last.iter().zip(next) {
        difference += f64::from((*next - *last).truncate().abs().element_sum());
        total += f64::from(next.truncate().abs().element_sum());
    }
    if total > 0.0 { (difference / total) as f32 } else { 0.0 }
}
