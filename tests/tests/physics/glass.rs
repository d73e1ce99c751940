//! Glass lets its share of the light through, stops the rest, and makes none.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::scene::LightKind;
use lightkiln_tests::harness::{Held, Lighting, bake, relit};
use lightkiln_tests::scenes;
use lightkiln_tests::scenes::glb::Surface;

use super::setup::{
    assert_same_energy, careful, in_both_kinds, luminance, mean, only, small, spread, with_texels,
};

in_both_kinds!(
    furnace_with_panes_stays_a_furnace,
    three_quarters_of_a_lamps_light_come_through_a_pane_of_alpha_one_quarter,
    room_lit_through_a_pane_alone_agrees_with_the_reference,
);

fn furnace_with_panes_stays_a_furnace(kind: &'static str) {
    let albedo = 0.5;
    let bake = bake(scenes::furnace_with_panes(albedo, &[0.25, 0.6, 0.05]), &small(kind, 2500)).unwrap();
    let receivers = relit(&bake, &Lighting::NONE).unwrap();
    let wanted = PI / (1.0 - albedo);
    let all: Vec<_> = receivers.iter().collect();
    let found = mean(&all);
    let worst = all.iter().map(|r| (luminance(r.indirect) / wanted - 1.0).abs()).fold(0.0, f32::max);
    println!("{kind}: mean {:.4} of what is wanted, worst {worst:.4}", found / wanted);
    assert!(receivers.len() > 500);
    assert!((found / wanted - 1.0).abs() < 0.01, "mean {found}, wanted {wanted}");
    assert!(worst < 0.08, "a receiver is off by {worst}");
}

/// Mean light of the half of the box beyond the pane.
fn beyond(kind: &'static str, glass: Option<Surface>) -> f32 {
    let bake = bake(scenes::lamp_behind_pane(glass), &with_texels(kind, 0.25, 256)).unwrap();
    let receivers = relit(&bake, &Lighting::NONE).unwrap();
    let beyond: Vec<_> = receivers.iter().filter(|receiver| receiver.position_m.z > 0.2).collect();
    assert!(beyond.len() > 200, "{} receivers", beyond.len());
    mean(&beyond)
}

fn three_quarters_of_a_lamps_light_come_through_a_pane_of_alpha_one_quarter(kind: &'static str) {
    let open = beyond(kind, None);
    assert!(open > 0.5, "the lamp lights nothing: {open}");
    let black = Surface::diffuse("glass", [0.0; 3]);
    for (name, glass, share) in [
        ("alpha", black.clone().blended(0.25), 0.75),
        ("a clear pane", black.clone().blended(0.0), 1.0),
        ("an opaque pane", black.blended(1.0), 0.0),
        // All of it passes, tinted.
        ("transmission", Surface::diffuse("glass", [0.8; 3]).transmitting(1.0), 0.8),
    ] {
        let found = beyond(kind, Some(glass)) / open;
        println!("{kind}, {name}: {found:.4}, wanted {share}");
        assert!((found - share).abs() < 0.01, "{name}: {found} of the light, wanted {share}");
    }
}

fn room_lit_through_a_pane_alone_agrees_with_the_reference(kind: &'static str) {
    let sun = only(LightKind::Sun { direction: [-0.27, -0.93, -0.23] }, 20.0);
    let sky = only(LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] }, 3.0);
    let inside = |p: Vec3| p.x.abs() < 1.51 && p.z.abs() < 2.01 && p.y < 2.45;
    let tolerance = if kind == "prt" { 0.04 } else { 0.12 };
    for alpha in [0.3, 0.75] {
        let held = Held::new(scenes::skylit_room(alpha), &careful(kind, 0.125)).unwrap();
        let receivers = spread(&held.receivers(|r| inside(r.position_m)), 60);
        assert!(receivers.len() > 40, "{}", receivers.len());
        for (name, lighting) in [("sun", &sun), ("sky", &sky)] {
            let pairs = held.under(lighting).unwrap().compared(&receivers, 0.04).unwrap();
            assert_same_energy(&format!("{kind}: {name} through {alpha}"), &pairs, tolerance);
        }
    }
}
