//! Narrow places that nothing in the open sees get no receivers; all others keep theirs, and their light.

use glam::Vec3;
use lightkiln_tests::harness::{Held, Lit};
use lightkiln_tests::scenes::{self, BAR_M, BOARD_M, CHEST_M, DUCT_M};
use lightkiln_worker::lightmap::Receiver;
use lightkiln_worker::reference::luminance;

use super::setup::{in_both_kinds, lamp_at, with_texels};

const TEXEL_M: f32 = 0.0625;

/// Tells some receivers from the others.
type Which<'a> = &'a dyn Fn(&Receiver) -> bool;

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

in_both_kinds!(cavities_get_no_receivers_and_what_is_seen_keeps_its_own);

fn cavities_get_no_receivers_and_what_is_seen_keeps_its_own(kind: &'static str) {
    let with_cavities = |cavity_m: f32| {
        // Truncation alone changes the light of dark places when other receivers are gone: under the board by 4 % in a draft, in
        // the mouth of the bar by 10 % at 0.002.
        let recipe = with_texels(kind, TEXEL_M, 256).with("cavity_m", cavity_m).with("rank_error", 0.00025);
        Held::new(scenes::hollow_furniture(), &recipe).unwrap()
    };
    let (without, with) = (with_cavities(0.3), with_cavities(0.0));
    let count = |held: &Held, which: Which| held.receivers(which).len();
    let deep = [count(&without, &is_deep_in_bar), count(&with, &is_deep_in_bar)];
    assert!(deep[1] > 40 && deep[0] * 10 < deep[1], "deep in the bar: {deep:?}");
    let at_mouth = |r: &Receiver| is_inside(BAR_M, r) && r.position_m.x > BAR_M[1].x - 2.5 * TEXEL_M;
    let in_duct = |r: &Receiver| is_inside(DUCT_M, r);
    // Nothing sees into the chest either, but it is no narrow place: one may look in there.
    let in_chest = |r: &Receiver| is_inside(CHEST_M, r);
    for seen in [&at_mouth as Which, &is_under_board, &in_duct, &in_chest] {
        let counts = [count(&without, seen), count(&with, seen)];
        assert!(counts[0] > 3 && counts[0] == counts[1], "{counts:?}");
    }
    let in_board = |r: &Receiver| is_inside(BOARD_M, r);
    assert!(count(&without, &in_board) == 0 && count(&with, &in_board) > 40);
    let rest = |r: &Receiver| !is_inside(BAR_M, r) && !in_board(r);
    assert_eq!(count(&without, &rest), count(&with, &rest));

    let lamp = lamp_at(Vec3::new(0.4, 2.2, 0.5));
    let (lit_without, lit_with) = (without.under(&lamp).unwrap(), with.under(&lamp).unwrap());
    let light = |held: &Held, lit: &Lit, which: Which| {
        let receivers = held.receivers(which);
        receivers.iter().map(|&receiver| luminance(lit.baked(receiver))).sum::<f64>() / receivers.len() as f64
    };
    // At the mouth of the bar, light that would come back from its depths is missing.
    let groups: [(&str, Which, f64); 4] = [
        ("room", &rest, 0.01),
        ("under the board", &is_under_board, 0.03),
        ("duct", &in_duct, 0.02),
        ("mouth of the bar", &at_mouth, 0.08),
    ];
    for (what, seen, tolerance) in groups {
        let ratio = light(&without, &lit_without, seen) / light(&with, &lit_with, seen);
        println!("{kind}, {what}: {ratio} of the light with cavities");
        assert!((ratio - 1.0).abs() < tolerance, "{kind}, {what}: {ratio} of the light with cavities");
    }
}
