//! Physics of the reference: furnace, form factors, energy, and agreement of its ways to sample.

mod agreement;
mod energy;
mod form_factors;
mod furnace;
mod glass;
mod openings;
mod rooms;

use std::f64::consts::PI;

use lightkiln_proto::rectangle::default_up;
use lightkiln_proto::scene::{LightKind, SceneLight};

use crate::task::Progress;

use super::*;
use rooms::Room;

/// Estimates at sites of a room, under some light.
fn irradiance(
    room: &Room,
    lighting: &Lighting,
    sites: &[Site],
    precision: Precision,
) -> Vec<IrradianceEstimate> {
    let reference = room.under(lighting);
    reference.irradiance(sites, &precision, &Progress::new()).unwrap()
}

/// The scene's own emitters and nothing else.
fn emitters() -> Lighting {
    Lighting { emitter_scale: 1.0, ..Lighting::default() }
}

/// A rectangle that shines along `direction`, whose width is level.
fn rect(position_m: [f32; 3], direction: [f32; 3], size_m: [f32; 2], radiance: f32) -> SceneLight {
    let up = default_up(direction.into()).into();
    let kind = LightKind::Rect { position_m, direction, up, size_m, points: 4 };
    SceneLight { name: "rect".into(), kind, strength: [radiance; 3] }
}

/// Asserts that an estimate is right within so many standard errors, and that these are small.
fn assert_sure(found: &Estimate, wanted: f64, sigmas: f64, what: &str) {
    let off = (found.mean.y - wanted).abs();
    assert!(found.error.y <= 0.02 * wanted.abs(), "{what}: the error {} hides anything", found.error.y);
    assert!(
        off <= sigmas * found.error.y + 1e-5 * wanted.abs(),
        "{what}: {} ± {}, wanted {wanted}",
        found.mean.y,
        found.error.y
    );
}
