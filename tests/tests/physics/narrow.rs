//! Between slats that a sun shines on light falls on strips narrower than texels: near hits tell.

use glam::Vec3;
use lightkiln_proto::scene::LightKind;
use lightkiln_tests::harness::{Compared, Held, Recipe};
use lightkiln_tests::scenes::{self, SLATS_M};
use lightkiln_worker::lightmap::Receiver;

use super::setup::{only, spread};

const TEXEL_M: f32 = 0.0625;
/// Receivers that are looked at.
const RECEIVERS: usize = 80;
/// Root mean square error of E_ind over its mean. Measured: 0.50, 0.83 without near hits, and 1.86 without the
/// points of texels too. The rest is E_ind, which
/// changes within these texels too, and is that of their middles.
const ERROR_MAX: f64 = 0.6;

/// Root mean square error over the mean of the reference.
fn error(pairs: &[Compared]) -> f64 {
    let squares: f64 = pairs.iter().map(|pair| (pair.baked - pair.reference).powi(2)).sum();
    let mean = pairs.iter().map(|pair| pair.reference).sum::<f64>() / pairs.len() as f64;
    (squares / pairs.len() as f64).sqrt() / mean
}

#[test]
fn light_between_slats_is_that_of_the_strips_that_the_sun_falls_on() {
    let sun = only(LightKind::Sun { direction: Vec3::new(0.2, -1.0, -1.1).normalize().to_array() }, 10.0);
    let [min, max] = SLATS_M;
    let is_between = |receiver: &Receiver| {
        let at = receiver.position_m;
        receiver.face_normal.y.abs() > 0.9 && at.cmpgt(min).all() && at.cmplt(max.with_y(max.y - 0.01)).all()
    };
    let errors = [0, 32].map(|near_hits| {
        let settings = serde_json::json!({ "texel_m": TEXEL_M, "near_hits": near_hits });
        let held = Held::new(scenes::shutter(), &Recipe { kind: "prt", settings }).unwrap();
        let receivers = spread(&held.receivers(is_between), RECEIVERS);
        assert!(receivers.len() > RECEIVERS / 2);
        error(&held.under(&sun).unwrap().compared(&receivers, 0.03).unwrap())
    });
    println!("without near hits {:.3}, with them {:.3}", errors[0], errors[1]);
    assert!(errors[1] < ERROR_MAX && errors[1] < 0.75 * errors[0], "{errors:?}");
}
