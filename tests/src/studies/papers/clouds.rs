//! \[Sukys2014\]: placements by light, tessellations and leak edges, and a ball that is carried.

use anyhow::{Result, bail};
use glam::Vec3;
use lightkiln_proto::harmonics::relight_direction;
use lightkiln_proto::kinds::captured::tasks;
use lightkiln_proto::kinds::field::Between;
use lightkiln_proto::scene::LightKind;
use lightkiln_worker::geometry::Site;

use super::scene::{CapturedScene, Reading, error, mean};
use super::{Table, percent};
use crate::harness::free_points;
use crate::scenes;

/// Placements by light, as `field_placement` has them.
const BY_LIGHT: [(f64, &str); 2] = [(2.0, "spawn and merge"), (3.0, "gradient ascent")];
/// Probes this near to a lamp are beside it, in metres.
const BESIDE_M: f32 = 1.0;

fn cloud(bundle: &[u8], spacing_m: f64, placement: f64, more: &[(&str, f64)]) -> Result<CapturedScene> {
    let own = [("field_structure", 1.0), ("field_spacing_m", spacing_m), ("field_placement", placement)];
    CapturedScene::new(bundle, &[&own, more].concat())
}

/// Share of probes beside a lamp.
fn beside_lamps(scene: &CapturedScene) -> f64 {
    let lamps = scene.geometry.scene.lights.iter().filter_map(|light| match light.kind {
        LightKind::Point { position_m, .. } | LightKind::Spot { position_m, .. } => {
            Some(Vec3::from(position_m))
        }
        _ => None,
    });
    let lamps: Vec<Vec3> = lamps.collect();
    let is_beside = |place_m: &Vec3| lamps.iter().any(|lamp_m| lamp_m.distance(*place_m) < BESIDE_M);
    scene.places_m().filter(is_beside).count() as f64 / scene.field.len().max(1) as f64
}

/// Figures 6, 7 and 15 to 17: probes by round, and beside lamps.
pub fn rounds() -> Result<Table> {
    let mut table = Table::new(
        "[Sukys2014] figures 6, 7, 15 to 17: placements",
        "Probes of the first grid, after each round of spawning and merging, or moved in each of ascent, and at the end with those that no tetrahedron's corners saw; and the share of them within \
         1 m of a lamp, beside that of even placement. The paper shows pictures alone.",
        &["scene", "placement", "rounds", "probes", "beside lamps", "even: probes", "beside lamps"],
    );
    for (name, bundle, spacing_m) in
        [("two rooms", scenes::two_rooms(0.1), 1.0), ("corridor", scenes::u_corridor(), 1.0)]
    {
        let even = cloud(&bundle, spacing_m, 0.0, &[])?;
        for (placement, how) in BY_LIGHT {
            let scene = cloud(&bundle, spacing_m, placement, &[])?;
            let counts = scene.counts()?;
            let of = |stem: &str| -> Vec<u64> {
                let mut found: Vec<(u32, u64)> = counts
                    .iter()
                    .filter_map(|(key, count)| Some((key.strip_prefix(stem)?.parse().ok()?, *count)))
                    .collect();
                found.sort_unstable();
                found.into_iter().map(|(_, count)| count).collect()
            };
            let steps = if placement == 2.0 { of("probes_") } else { of("moved_") };
            let steps: Vec<String> = steps.iter().map(u64::to_string).collect();
            let first = counts.get("probes_first").copied().unwrap_or_default();
            table.row([
                name.to_owned(),
                how.to_owned(),
                format!("{first}: {}", steps.join(", ")),
                scene.field.len().to_string(),
                percent(beside_lamps(&scene)),
                even.field.len().to_string(),
                percent(beside_lamps(&even)),
            ]);
        }
    }
    Ok(table)
}

/// Figures 6 and 7: time by the number of probes begun with.
pub fn seconds() -> Result<Table> {
    let mut table = Table::new(
        "[Sukys2014] time of placements",
        "Seconds of the plan of two rooms, from grids of more and more probes. The paper compares all pairs of probes, n²; near ones alone are compared here. The first row is mostly the reference's, at 4,096 sites; *growth* is the exponent from the row above.",
        &["placement", "step, m", "probes of the grid", "seconds", "growth"],
    );
    for (placement, how) in BY_LIGHT {
        let mut before: Option<(f64, f64)> = None;
        for spacing_m in [1.0, 0.7, 0.5, 0.35] {
            let scene = cloud(&scenes::two_rooms(0.1), spacing_m, placement, &[])?;
            let first = scene.counts()?.get("probes_first").copied().unwrap_or_default() as f64;
            let secs = scene.seconds(tasks::PLAN.name);
            let growth = before.map_or(String::new(), |(count, former)| {
                format!("{:.2}", (secs / former).ln() / (first / count).ln())
            });
            before = Some((first, secs));
            table.row([
                how.to_owned(),
                spacing_m.to_string(),
                first.to_string(),
                format!("{secs:.2}"),
                growth,
            ]);
        }
    }
    Ok(table)
}

/// §3.1.3: six directions or 26, and mean squares, as contrast.
pub fn directions() -> Result<Table> {
    let mut table = Table::new(
        "[Sukys2014] §3.1.3: contrast",
        "Of pairs of even probes within 1.5 h: those of little contrast (below 0.1, merged where they are closer than 0.75 h) and of much (above 0.5: a third is put between), by 26 directions, by the 6 of the axes, and by the root of the \
         mean square over 26; and how many are told otherwise than by 26. The paper takes 26, as 6 miss light from corners.",
        &["scene", "pairs", "contrast by", "little", "much", "told otherwise"],
    );
    for (name, bundle, spacing_m) in
        [("two rooms", scenes::two_rooms(0.1), 0.7), ("corridor", scenes::u_corridor(), 0.7)]
    {
        let scene = cloud(&bundle, spacing_m, 0.0, &[])?;
        let places_m: Vec<Vec3> = scene.places_m().collect();
        let ways: Vec<Vec3> = (0..27)
            .filter(|&way| way != 13)
            .map(|way: i32| Vec3::new((way % 3 - 1) as f32, (way / 3 % 3 - 1) as f32, (way / 9 - 1) as f32))
            .collect();
        let light = |place_m: &Vec3| -> Vec<f64> {
            ways.iter().map(|way| scene.light(*place_m, way.normalize())).collect()
        };
        let lights: Vec<Vec<f64>> = places_m.iter().map(light).collect();
        let floor = 1e-3 * lights.iter().flatten().sum::<f64>() / (26 * lights.len()).max(1) as f64;
        let mut decided: Vec<[i8; 3]> = Vec::new();
        for a in 0..places_m.len() {
            for b in 0..a {
                if places_m[a].distance(places_m[b]) > 1.5 * spacing_m as f32 {
                    continue;
                }
                let of = |way: usize| {
                    let (a, b) = (lights[a][way], lights[b][way]);
                    (a - b).abs() / (a + b + floor)
                };
                let all = (0..26).map(of).fold(0.0, f64::max);
                let axes =
                    (0..26).filter(|&way| ways[way].abs().element_sum() == 1.0).map(of).fold(0.0, f64::max);
                let mean = ((0..26).map(|way| of(way).powi(2)).sum::<f64>() / 26.0).sqrt();
                decided.push(
                    [all, axes, mean].map(|contrast| i8::from(contrast > 0.5) - i8::from(contrast < 0.1)),
                );
            }
        }
        let count = decided.len().max(1) as f64;
        for (which, how) in ["26 directions", "6 directions", "root mean square"].into_iter().enumerate() {
            let share = |is: &dyn Fn(&[i8; 3]) -> bool| {
                percent(decided.iter().filter(|of| is(of)).count() as f64 / count)
            };
            table.row([
                name.to_owned(),
                decided.len().to_string(),
                how.to_owned(),
                share(&|of| of[which] == -1),
                share(&|of| of[which] == 1),
                share(&|of| of[which] != of[0]),
            ]);
        }
    }
    Ok(table)
}

/// Figures 13, 14 and 18 to 20: tessellations, and leaks before and after leak edges.
pub fn tessellations() -> Result<Table> {
    let mut table = Table::new(
        "[Sukys2014] figures 13, 14, 18 to 20: tessellations and leaks",
        "Two rooms behind a wall of 10 cm, the right one dark. *Through walls* are edges between probes that a surface cuts; a leak is light of the dark room over that of the lit one, at 200 points each. The paper shows pictures alone.",
        &[
            "placement",
            "leak edges",
            "probes",
            "tetrahedra a probe",
            "least dihedral angle: least, quarter, half",
            "through walls",
            "leak by all corners",
            "leak by depth maps",
        ],
    );
    for (placement, how) in [(0.0, "even"), (2.0, "spawn and merge"), (3.0, "gradient ascent")] {
        for leak_edges in [0.0, 1.0] {
            let scene = cloud(&scenes::two_rooms(0.1), 1.0, placement, &[("field_leak_edges", leak_edges)])?;
            let Between::Tetrahedra(found) = &scene.field.between else { bail!("there are no tetrahedra") };
            let places_m: Vec<Vec3> = found.places_m.iter().map(|place_m| place_m.truncate()).collect();
            let is_inner = |of: &&[u32; 4]| of.iter().all(|&vertex| (vertex as usize) < scene.field.len());
            let inner = found.vertices.iter().filter(is_inner);
            let corners: Vec<[Vec3; 4]> =
                inner.clone().map(|of| of.map(|vertex| places_m[vertex as usize])).collect();
            let mut angles: Vec<f32> = corners.iter().map(least_dihedral_angle).collect();
            angles.sort_unstable_by(f32::total_cmp);
            let angle = |share: f64| {
                angles.get((share * angles.len() as f64) as usize).map_or(0.0, |angle| angle.to_degrees())
            };
            let mut edges: Vec<[u32; 2]> = inner
                .flat_map(|of| {
                    (0..4).flat_map(move |b| (0..b).map(move |a| [of[a].min(of[b]), of[a].max(of[b])]))
                })
                .collect();
            edges.sort_unstable();
            edges.dedup();
            let is_cut = |edge: &&[u32; 2]| {
                let [a, b] = edge.map(|vertex| places_m[vertex as usize]);
                scene.geometry.tracer.is_occluded(a, b)
            };
            let cut = edges.iter().filter(is_cut).count() as f64 / edges.len().max(1) as f64;
            let [low_m, high_m] = scene.geometry.near_bounds_m();
            let lit_m = scene.free_points([low_m, high_m.with_x(-0.07)], 200)?;
            let dark_m = scene.free_points([low_m.with_x(0.07), high_m], 200)?;
            let leak =
                |light: &dyn Fn(Vec3, Vec3) -> f64| percent(mean(&dark_m, light) / mean(&lit_m, light));
            table.row([
                how.to_owned(),
                if leak_edges == 1.0 { "yes" } else { "no" }.to_owned(),
                scene.field.len().to_string(),
                format!("{:.1}", found.vertices.len() as f64 / scene.field.len().max(1) as f64),
                format!("{:.1}°, {:.1}°, {:.1}°", angle(0.0), angle(0.25), angle(0.5)),
                percent(cut),
                leak(&|point_m, normal| scene.read(Reading::Valid, point_m, normal)),
                leak(&|point_m, normal| scene.light(point_m, normal)),
            ]);
        }
    }
    Ok(table)
}

/// The least angle between two faces of a tetrahedron, in radians.
fn least_dihedral_angle(corners: &[Vec3; 4]) -> f32 {
    let faces = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];
    let outward = |face: usize| {
        let [a, b, c] = faces[face].map(|corner: usize| corners[corner]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if normal.dot(corners[face] - a) > 0.0 { -normal } else { normal }
    };
    let normals = [0, 1, 2, 3].map(outward);
    let pairs = (0..4).flat_map(|b| (0..b).map(move |a| (a, b)));
    pairs
        .map(|(a, b)| std::f32::consts::PI - normals[a].dot(normals[b]).clamp(-1.0, 1.0).acos())
        .fold(f32::INFINITY, f32::min)
}

/// Figures 21 to 28: a ball in eight places.
pub fn carried() -> Result<Table> {
    let mut table = Table::new(
        "[Sukys2014] figures 21 to 28: an object in eight places",
        "A ball of 0.3 m at eight free places, 64 normals each, in the corridor: bounced light on it without probes (none), with probes placed each way, and by paths. Error over the mean of all; time is that of all 512 reads, over a frame of 1/60 s. The paper shows pictures, \
         and could not tell the time of a frame with probes from that without.",
        &["probes", "light over paths'", "error", "share of a frame"],
    );
    let bundle = scenes::u_corridor();
    let mut is_first = true;
    for (placement, how) in [(0.0, "even"), (2.0, "spawn and merge"), (3.0, "gradient ascent")] {
        let scene = cloud(&bundle, 1.0, placement, &[])?;
        let [low_m, high_m] = scene.geometry.near_bounds_m();
        let away_m = Vec3::splat(0.4);
        let middles_m = free_points(&scene.geometry, [low_m + away_m, high_m - away_m], 0.32, 8)?;
        let sites: Vec<Site> = middles_m
            .iter()
            .flat_map(|&middle_m| {
                (0..64).map(move |index| {
                    let normal = relight_direction(index, 64);
                    Site { position_m: middle_m + 0.3 * normal, normal, face_normal: normal }
                })
            })
            .collect();
        let traced = scene.traced(&sites)?;
        if is_first {
            table.row([
                "none".to_owned(),
                percent(0.0),
                percent(error(&vec![0.0; traced.len()], &traced)),
                String::new(),
            ]);
            is_first = false;
        }
        let started = std::time::Instant::now();
        let found: Vec<f64> = sites.iter().map(|site| scene.light(site.position_m, site.normal)).collect();
        let secs = started.elapsed().as_secs_f64();
        table.row([
            format!("{how}, {}", scene.field.len()),
            percent(found.iter().sum::<f64>() / traced.iter().sum::<f64>()),
            percent(error(&found, &traced)),
            percent(secs * 60.0),
        ]);
    }
    Ok(table)
}
