//! Narrow places that nothing in the open sees get no receivers; all others keep theirs, and their light.

use glam::Vec3;
use lightkiln_tests::harness::{Held, Lit};
use lightkiln_tests::scenes::{self, BAR_M, BOARD_M, DUCT_M};
use lightkiln_worker::prt::stage::Receiver;
use lightkiln_worker::reference::luminance;

use super::setup::{lamp_at, with_texels};

const TEXEL_M: f32 = 0.0625;

/// The receiver stands in the box or on its rim, and looks into it.
fn is_inside([min, max]: [Vec3; 2], receiver: &Receiver) -> bool {
    let ahead = receiver.position_m + 0.01 * receiver.face_normal;
    ahead.cmpgt(min).all() && ahead.cmplt(max).all()
}

fn is_deep_in_bar(receiver: &Receiver) -> bool {
    is_inside(BAR_M, receiver) && receiver.position_m.x < 0.0
}

fn is_under_board(receiver: &Receiver) -> bool {
    let gap = [Vec3::new(BOARD_M[0].x, 0.0, BOARD_M[0].z), BOARD_M[1].with_y(BOARD_M[0].y)];
    is_inside(gap, receiver)
}

#[test]
fn cavities_get_no_receivers_and_what_is_seen_keeps_its_own() {
    let with_cavities = |texels: f32| {
        let mut settings = with_texels("patches", TEXEL_M, 256);
        settings["cavity_texels"] = texels.into();
        Held::new(scenes::hollow_furniture(), &settings).unwrap()
    };
    let (without, with) = (with_cavities(2.0), with_cavities(0.0));
    let count = |held: &Held, which: &dyn Fn(&Receiver) -> bool| held.receivers(which).len();
    let deep = [count(&without, &is_deep_in_bar), count(&with, &is_deep_in_bar)];
    assert!(deep[1] > 40 && deep[0] * 10 < deep[1], "deep in the bar: {deep:?}");
    let at_mouth = |r: &Receiver| is_inside(BAR_M, r) && r.position_m.x > BAR_M[1].x - 2.5 * TEXEL_M;
    for seen in [&at_mouth as &dyn Fn(&Receiver) -> bool, &is_under_board, &|r| is_inside(DUCT_M, r)] {
        let counts = [count(&without, seen), count(&with, seen)];
        assert!(counts[0] > 3 && counts[0] == counts[1], "{counts:?}");
    }
    let in_board = |r: &Receiver| is_inside(BOARD_M, r);
    assert_eq!(count(&without, &in_board), 0);
    let rest = |r: &Receiver| !is_inside(BAR_M, r) && !in_board(r);
    assert_eq!(count(&without, &rest), count(&with, &rest));

    let lamp = lamp_at(Vec3::new(0.4, 2.2, 0.5));
    let (lit_without, lit_with) = (without.under(&lamp).unwrap(), with.under(&lamp).unwrap());
    let light = |held: &Held, lit: &Lit, which: &dyn Fn(&Receiver) -> bool| {
        let receivers = held.receivers(which);
        receivers.iter().map(|&receiver| luminance(lit.baked(receiver))).sum::<f64>() / receivers.len() as f64
    };
    for seen in [&rest as &dyn Fn(&Receiver) -> bool, &is_under_board, &|r| is_inside(DUCT_M, r)] {
        let ratio = light(&without, &lit_without, seen) / light(&with, &lit_with, seen);
        assert!((ratio - 1.0).abs() < 0.03, "{ratio} of the light that was there");
    }
}
