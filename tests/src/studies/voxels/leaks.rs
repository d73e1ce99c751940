//! Light that comes through walls, and the share of cones that walls of closed rooms do not stop.

use anyhow::Result;
use glam::{Quat, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_proto::voxels::{
    Bundle, IRRADIANCE_WALKS, OCCLUSION_REACH_M, Seen, Start, WalkLight, irradiance,
};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::reference::{Lighting, luminance};
use rayon::prelude::*;

use super::Kind;
use super::build::{Build, built};
use super::measure::lamp_of;
use crate::harness::{Held, Recipe};
use crate::scenes;
use crate::studies::walks::Lights;

/// Receivers on either side of a wall.
const SITES: usize = 400;
/// Diffuse cones.
const CONES: u32 = 6;

struct Case {
    name: &'static str,
    scene: Vec<u8>,
    lamp_m: Vec3,
    is_dark: fn(Vec3) -> bool,
}

fn cases() -> [Case; 3] {
    let is_right: fn(Vec3) -> bool = |at_m| at_m.x > 0.02;
    let is_inside: fn(Vec3) -> bool = |at_m| (at_m - Vec3::Y * 2.25).abs().max_element() < 1.95;
    let lamp_m = Vec3::new(-2.0, 1.5, 0.3);
    [
        Case { name: "two_rooms", scene: scenes::two_rooms(0.02), lamp_m, is_dark: is_right },
        Case { name: "two_rooms_sheet", scene: scenes::two_rooms(0.0), lamp_m, is_dark: is_right },
        Case {
            name: "sealed_box",
            scene: scenes::sealed_box(0.1),
            lamp_m: Vec3::new(3.0, 5.0, 4.0),
            is_dark: is_inside,
        },
    ]
}

/// Bounced light behind walls over all light, direct and bounced, on the lamp's side, of all models and of walks; a table in Markdown.
pub fn leaks(build: &Build) -> Result<String> {
    let names: Vec<String> = Kind::ALL.iter().map(|kind| kind.words()).collect();
    let mut page =
        format!("| scene | walks | {} |\n|---|---|{}\n", names.join(" | "), "---|".repeat(names.len()));
    let odd = Quat::from_axis_angle(Vec3::new(0.3, -0.7, 0.64).normalize(), 0.87);
    for case in cases() {
        for (words, turn) in [("", Quat::IDENTITY), (", turned", odd)] {
            page += &format!("| `{}`{words} |", case.name);
            for [light, unstopped] in shares(&case, turn, build)? {
                page += &format!(" {}, {} |", percent(light), percent(unstopped));
            }
            page += "\n";
        }
    }
    Ok(page)
}

fn percent(share: f64) -> String {
    if share == 0.0 { "0".to_owned() } else { format!("{:.3} %", 100.0 * share) }
}

/// Light behind the wall over that before it, and the share of cones there that nothing stops, by walks and by each model.
fn shares(case: &Case, turn: Quat, build: &Build) -> Result<Vec<[f64; 2]>> {
    let settings = serde_json::json!({ "preset": "draft", "receivers_target": 20_000, "transport_rays": 128, "voxels": "on" });
    let held = Held::new(scenes::turned(&case.scene, turn), &Recipe { kind: "prt", settings })?;
    let (table, patches) = held.decoded.voxels(&held.bake)?;
    let position_m = (turn * case.lamp_m).to_array();
    let kind = LightKind::Point { position_m, range_m: None };
    let lamp = SceneLight { name: "lamp".to_owned(), kind, strength: [10.0; 3] };
    let lighting = Lighting { lights: vec![lamp], emitter_scale: 0.0, ..Lighting::default() };
    let lit = held.under(&lighting)?;
    let light = WalkLight::new(&table, patches, &lit.light().settled.lambda, |_| Vec3::ZERO);
    let patch_of_slot = patches.finest_of_slots();
    let lights = Lights { held: &held, light, table: &table, patch_of_slot, emitter_scale: 0.0 };
    let [dark, bright] = [true, false].map(|dark| {
        let all = held.receivers(|receiver| (case.is_dark)(turn.inverse() * receiver.position_m) == dark);
        let step = (all.len() / SITES).max(1);
        all.into_iter()
            .step_by(step)
            .map(|receiver| (receiver, held.world.lightmap.receivers[receiver as usize].site()))
            .collect::<Vec<(u32, Site)>>()
    });
    let all_light = |(receiver, site): &(u32, Site)| {
        [luminance(lit.reference().direct_irradiance(site, 1) + lit.baked(*receiver)), 0.0]
    };
    let [before, _] = mean(&bright, all_light);
    let walked = |(receiver, site): &(u32, Site)| {
        let start = Start::on(site.position_m, site.face_normal);
        let bundle = Bundle::new(IRRADIANCE_WALKS, *receiver);
        let found = irradiance(&table, &start, site.face_normal, &bundle, |seen| lights.light.radiance(seen));
        let out = irradiance(&table, &start, site.face_normal, &bundle, |seen| match seen {
            Seen::Sky(_) => Vec3::ONE,
            Seen::Hit(_) => Vec3::ZERO,
        });
        [luminance(found.as_dvec3()), f64::from(out.x) / std::f64::consts::PI]
    };
    let mut found = vec![mean(&dark, walked)];
    let lamp = lamp_of(&lighting);
    for kind in Kind::ALL {
        let volume = built(&held.world.geometry, kind, build, lamp.as_ref(), |hit| lights.of_hit(hit)).volume;
        let coned = |(_, site): &(u32, Site)| {
            let place = (site.position_m, site.face_normal);
            let found = volume.diffuse(place, CONES, OCCLUSION_REACH_M, |_| Vec3::ZERO);
            [luminance(found.irradiance.as_dvec3()), f64::from(found.unstopped)]
        };
        found.push(mean(&dark, coned));
    }
    anyhow::ensure!(before > 0.0, "{} is dark", case.name);
    Ok(found.into_iter().map(|[light, unstopped]| [light / before, unstopped]).collect())
}

/// Means of two figures over receivers.
fn mean(sites: &[(u32, Site)], of: impl Fn(&(u32, Site)) -> [f64; 2] + Sync + Send) -> [f64; 2] {
    let all: Vec<[f64; 2]> = sites.par_iter().map(of).collect();
    [0, 1].map(|which| all.iter().map(|found| found[which]).sum::<f64>() / all.len().max(1) as f64)
}
