//! Light in free space: what probes tell of it between them, beside the path tracer, closed forms and walls.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};
use lightkiln_proto::harmonics::{ShBasis, relight_direction};
use lightkiln_proto::kinds::field::{self, FieldTable};
use lightkiln_proto::kinds::{cloud, grid};
use lightkiln_proto::manifest::CLUSTERS;
use lightkiln_proto::scene::LightKind;
use lightkiln_tests::harness::{self, Held, Lit, Recipe, bake};
use lightkiln_tests::scenes;
use lightkiln_worker::factors::Threads;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::rays::sampling::{Sequence, seed_of};
use lightkiln_worker::reference::{IrradianceEstimate, Lighting, Precision, luminance};
use lightkiln_worker::task::Progress;
use serde_json::json;

use super::setup::{lamp_at, only};

/// Kinds of bake with a field.
const KINDS: [&str; 2] = [grid::NAME, cloud::NAME];

/// A field of about so many probes over small surfaces.
fn small(kind: &'static str, probes: u32) -> Recipe {
    let settings = json!({
        "preset": "draft",
        "receivers_target": 20_000,
        "transport_rays": 128,
        "field_probes": probes,
        "probe_rays": 1024,
        "field_rank_error": 0.03,
    });
    Recipe { kind, settings }
}

/// A field, and its light under some lights.
struct LitField {
    table: FieldTable,
    rows: Vec<Vec4>,
}

impl LitField {
    fn of(held: &Held, lit: &Lit<'_>) -> Self {
        let table = held.decoded.field(&held.bake).unwrap();
        let light = lit.light();
        let rows = table.relit(&Threads, &light.settled.lambda, &light.emitter_scale);
        Self { table, rows }
    }

    fn at(&self, position_m: Vec3, normal: Vec3) -> Vec3 {
        self.table.irradiance(&self.rows, position_m, normal)
    }

    /// The same probes, each of which counts whatever stands between it and a point.
    fn without_depths(mut self) -> Self {
        self.table.depths.fill(0);
        self
    }
}

/// So many free points of a box, at least `off_m` from all surfaces.
fn free_points(geometry: &Geometry, box_m: [Vec3; 2], off_m: f32, count: usize) -> Vec<Vec3> {
    harness::free_points(geometry, box_m, off_m, count).unwrap()
}

#[test]
fn white_furnace_has_the_same_light_in_all_of_its_space() {
    for (kind, albedo) in [(grid::NAME, 0.2), (grid::NAME, 0.8), (cloud::NAME, 0.8)] {
        let held =
            Held::new(scenes::furnace(albedo, 1.0, 4.0), &small(kind, 100).with("field_fit", 1)).unwrap();
        let lit = held.under(&Lighting { emitter_scale: 1.0, ..Lighting::default() }).unwrap();
        let field = LitField::of(&held, &lit);
        let geometry = &held.world.geometry;
        let wanted = PI / (1.0 - albedo);
        let (mut sum, mut worst) = (0.0, 0.0_f32);
        let points = free_points(geometry, geometry.bounds_m(), 0.02, 200);
        for (index, &point_m) in points.iter().enumerate() {
            let found = field.at(point_m, relight_direction(index as u32, 256)).y / wanted;
            sum += found;
            worst = worst.max((found - 1.0).abs());
        }
        let mean = sum / points.len() as f32;
        println!("{kind}, albedo {albedo}: mean {mean:.4} of what is wanted, worst {worst:.4}");
        assert!((mean - 1.0).abs() < 0.01, "{kind}, albedo {albedo}: {mean} of what is wanted");
        assert!(worst < 0.05, "{kind}, albedo {albedo}: a point is off by {worst}");
    }
}

#[test]
fn light_in_a_box_is_near_the_path_tracers() {
    KINDS.into_iter().for_each(light_in_a_box);
}

fn light_in_a_box(kind: &'static str) {
    let held = Held::new(scenes::cornell(), &small(kind, 400)).unwrap();
    let geometry = &held.world.geometry;
    let points = free_points(geometry, geometry.near_bounds_m(), 0.02, 150);
    let sites: Vec<Site> = points
        .iter()
        .zip(0..)
        .map(|(&position_m, index)| {
            let normal = relight_direction(index, 256);
            Site { position_m, normal, face_normal: normal }
        })
        .collect();
    let sky = LightKind::Sky { zenith: [0.3, 0.5, 1.0], horizon: [1.0; 3] };
    // Not its lamp: beside that, light changes within a step of the lattice more than all the rest together.
    for (name, lighting) in
        [("a point light", lamp_at(Vec3::new(0.3, 3.0, -2.0))), ("the sky", only(sky, 1.0))]
    {
        let lit = held.under(&lighting).unwrap();
        let precision = Precision { rel_error: 0.02, paths_max: 1 << 13 };
        let traced = lit.reference().irradiance(&sites, &precision, &Progress::new()).unwrap();
        let wanted: Vec<f64> = traced.iter().map(|of| of.indirect.luminance()).collect();
        let noise: f64 = traced.iter().map(|of| of.indirect.luminance_error.powi(2)).sum();
        let mean = wanted.iter().sum::<f64>() / wanted.len() as f64;
        let compared = |field: &LitField| {
            let found = sites.iter().map(|site| luminance(field.at(site.position_m, site.normal).as_dvec3()));
            let found: Vec<f64> = found.collect();
            let squares: f64 =
                found.iter().zip(&wanted).map(|(found, wanted)| (found - wanted).powi(2)).sum();
            let rms = ((squares - noise).max(0.0) / wanted.len() as f64).sqrt();
            [rms / mean, found.iter().sum::<f64>() / wanted.iter().sum::<f64>()]
        };
        let field = LitField::of(&held, &lit);
        let probes = field.table.len();
        let [error, energy] = compared(&field);
        let [plain, _] = compared(&field.without_depths());
        println!(
            "{kind}, {name}: {probes} probes, error {error:.3} (without depths {plain:.3}), energy {energy:.3}"
        );
        assert!(error < 0.25, "{kind}, {name}: error {error}");
        // Two boxes hide little from probes: walls between rooms are what depths are for.
        assert!(error < 1.02 * plain, "{kind}, {name}: error {error}, without depths {plain}");
        assert!((energy - 1.0).abs() < 0.05, "{kind}, {name}: energy {energy}");
    }
}

/// An object that is carried through a room changes its light evenly, but where a box comes between it and a probe.
#[test]
fn light_along_a_way_has_few_steps() {
    let held = Held::new(scenes::cornell(), &small(grid::NAME, 400)).unwrap();
    let lit = held.under(&lamp_at(Vec3::new(0.3, 3.0, -2.0))).unwrap();
    let field = LitField::of(&held, &lit);
    let geometry = &held.world.geometry;
    let [low_m, high_m] = geometry.near_bounds_m();
    let mut numbers = Sequence::new(seed_of(&[78]));
    let mut steps = Vec::new();
    let mut sum = 0.0;
    let mut worst = (0.0_f32, Vec3::ZERO);
    for _ in 0..60 {
        let mut place = || low_m + (high_m - low_m) * Vec3::from([(); 3].map(|()| numbers.next_f32()));
        let (from_m, to_m) = (place(), place());
        let count = (100.0 * from_m.distance(to_m)).ceil() as usize;
        let mut before: Option<[Vec3; 6]> = None;
        for step in 0..=count {
            let at_m = from_m.lerp(to_m, step as f32 / count as f32);
            // Walls part what lies before and behind them, and nothing is carried so near to one.
            let is_free = (0..32).all(|ray| {
                let hit = geometry.tracer.closest(at_m, relight_direction(ray, 32), f32::INFINITY);
                hit.is_none_or(|hit| hit.t > 0.05 && !geometry.is_back(&hit))
            });
            let light = is_free.then(|| {
                let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
                axes.map(|normal| field.at(at_m, normal))
            });
            if let (Some(light), Some(before)) = (light, before) {
                for (now, before) in light.iter().zip(before) {
                    let step = luminance((*now - before).abs().as_dvec3()) as f32;
                    steps.push(step);
                    sum += luminance(now.as_dvec3()) as f32;
                    if step > worst.0 {
                        worst = (step, at_m);
                    }
                }
            }
            before = light;
        }
    }
    let mean = sum / steps.len() as f32;
    steps.sort_by(f32::total_cmp);
    let share = |of: f32| steps[((steps.len() - 1) as f32 * of) as usize] / mean;
    println!(
        "{} steps of 1 cm: 99 % below {:.4} of the mean, 99.9 % below {:.4}, worst {:.4} at {}",
        steps.len(),
        share(0.99),
        share(0.999),
        share(1.0),
        worst.1
    );
    assert!(share(0.99) < 0.04, "one of a hundred steps is of {} of the mean", share(0.99));
    assert!(share(0.999) < 0.25, "one of a thousand steps is of {} of the mean", share(0.999));
}

/// At probes nothing is read between them: what is left is the angle of nine harmonics, rays, the cut and factors.
#[test]
fn light_at_probes_themselves_is_the_path_tracers() {
    let mut recipe = small(grid::NAME, 400);
    recipe.settings["field_fit"] = 0.into();
    recipe.settings["field_rank_error"] = 0.01.into();
    let held = Held::new(scenes::cornell(), &recipe).unwrap();
    let lit = held.under(&lamp_at(Vec3::new(0.3, 3.0, -2.0))).unwrap();
    let field = LitField::of(&held, &lit);
    // Not those before the room's open side: nine harmonics do not tell light that comes through one opening.
    let [low_m, high_m] = held.world.geometry.near_bounds_m();
    let is_within = |at_m: &Vec4| at_m.truncate().cmpge(low_m).all() && at_m.truncate().cmple(high_m).all();
    let probes = field.table.position_m.iter().enumerate().filter(|(_, at_m)| is_within(at_m));
    let (probes, sites): (Vec<usize>, Vec<Site>) = probes
        .map(|(probe, position_m)| {
            let normal = relight_direction(probe as u32, 1024);
            (probe, Site { position_m: position_m.truncate(), normal, face_normal: normal })
        })
        .unzip();
    let precision = Precision { rel_error: 0.02, paths_max: 1 << 12 };
    let traced = lit.reference().irradiance(&sites, &precision, &Progress::new()).unwrap();
    let mean = traced.iter().map(|of| of.indirect.luminance()).sum::<f64>() / sites.len() as f64;
    let error_of = |rows: &[Vec4]| {
        let square = |(&probe, (site, of)): (&usize, (&Site, &IrradianceEstimate))| {
            let own = &rows[field::PROBE_ROWS * probe..][..field::PROBE_ROWS];
            let mut harmonics = [0.0; field::PROBE_ROWS];
            ShBasis::new(2).evaluate(site.normal, &mut harmonics);
            let found: Vec4 = own.iter().zip(harmonics).map(|(row, harmonic)| *row * harmonic).sum();
            (luminance(found.truncate().as_dvec3()) - of.indirect.luminance()).powi(2)
                - of.indirect.luminance_error.powi(2)
        };
        let squares: f64 = probes.iter().zip(sites.iter().zip(&traced)).map(square).sum();
        (squares.max(0.0) / sites.len() as f64).sqrt() / mean
    };
    let light = lit.light();
    let FieldTable { clusters, emitters, .. } = &field.table;
    let direct = emitters.irradiance(field::PROBE_ROWS * field.table.len(), &light.emitter_scale);
    let b = clusters.basis(&Threads, &light.settled.lambda);
    let ringing = error_of(&clusters.reconstruct(&Threads, &b, &direct, None));
    let error = error_of(&field.rows);
    println!("{} probes: error {error:.4} at their own places, {ringing:.4} with ringing", sites.len());
    assert!(error < 0.1, "{error}");
    assert!(error < 1.05 * ringing, "{error}, with ringing {ringing}");
}

#[test]
fn no_light_passes_a_wall_of_two_centimetres_in_free_space() {
    for (kind, thickness_m) in KINDS.into_iter().flat_map(|kind| [(kind, 0.02), (kind, 0.0)]) {
        let held = Held::new(scenes::two_rooms(thickness_m), &small(kind, 300)).unwrap();
        let lit = held.under(&lamp_at(Vec3::new(-2.2, 2.2, 0.4))).unwrap();
        let field = LitField::of(&held, &lit);
        let geometry = &held.world.geometry;
        let [low_m, high_m] = geometry.near_bounds_m();
        let clear_m = 0.5 * thickness_m + 0.02;
        // Half of them within 20 cm of the wall.
        let of_side = |side: f32| -> Vec<Vec3> {
            let ends = |reach_m: f32| {
                let (a, b) = (side * clear_m, side * reach_m);
                [Vec3::new(a.min(b), low_m.y, low_m.z), Vec3::new(a.max(b), high_m.y, high_m.z)]
            };
            let all = free_points(geometry, ends(high_m.x), 0.02, 100);
            [all, free_points(geometry, ends(clear_m + 0.2), 0.02, 100)].concat()
        };
        let mean_of = |field: &LitField, points: &[Vec3]| {
            let normals = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::Z];
            let all = points.iter().flat_map(|&point_m| normals.map(|normal| field.at(point_m, normal).y));
            all.sum::<f32>() / (4 * points.len()) as f32
        };
        let [lit_side, dark_side] = [-1.0, 1.0].map(of_side);
        let (light, leak) = (mean_of(&field, &lit_side), mean_of(&field, &dark_side));
        let unseen =
            lit_side.iter().chain(&dark_side).filter(|point_m| field.table.weights(**point_m).is_empty());
        let unseen = unseen.count();
        let without = mean_of(&field.without_depths(), &dark_side);
        println!(
            "{kind}, {thickness_m} m: {leak} against {light}, {without} without depths; {unseen} of 400 points unseen"
        );
        assert!(light > 0.1, "the lit room is dark: the test shows nothing");
        assert!(leak <= 1e-3 * light, "{kind}, {thickness_m} m: {leak} against {light}");
        assert!(without > 1e-2 * light, "without depths {without}: the comparison must fail");
        assert!(unseen <= 4, "{kind}: {unseen} points see no probe");
    }
}

#[test]
fn sealed_box_in_full_sun_is_exactly_dark_in_its_space() {
    KINDS.into_iter().for_each(sealed_box_is_dark);
}

fn sealed_box_is_dark(kind: &'static str) {
    let held = Held::new(scenes::sealed_box(0.1), &small(kind, 3000)).unwrap();
    let sun = LightKind::Sun { direction: [-0.5, -0.7, -0.5] };
    let lit = held.under(&only(sun, 100.0)).unwrap();
    let field = LitField::of(&held, &lit);
    let geometry = &held.world.geometry;
    let inside = [Vec3::new(-1.85, 0.4, -1.85), Vec3::new(1.85, 4.1, 1.85)];
    for (&point_m, index) in free_points(geometry, inside, 0.02, 200).iter().zip(0..) {
        let found = field.at(point_m, relight_direction(index, 256));
        assert_eq!(found, Vec3::ZERO, "{kind}: light inside at {point_m}");
    }
    let outside = [Vec3::new(3.0, 0.2, -6.0), Vec3::new(6.0, 3.0, 6.0)];
    let points = free_points(geometry, outside, 0.02, 50);
    let mean = points.iter().map(|&point_m| field.at(point_m, Vec3::NEG_Y).y).sum::<f32>() / 50.0;
    assert!(mean > 1.0, "{kind}: the outside is dark, {mean}: the test shows nothing");
    // Nor does the field end with the scene's bounds, which are the box's roof.
    let sky = LightKind::Sky { zenith: [1.0; 3], horizon: [1.0; 3] };
    let lit = held.under(&only(sky, 1.0)).unwrap();
    let field = LitField::of(&held, &lit);
    let roof_m = geometry.near_bounds_m()[1].y;
    for (x, z) in [(0.0, 0.0), (1.5, -1.2), (-0.7, 1.6)] {
        for above_m in [0.02, 0.2, 0.4] {
            let found = field.at(Vec3::new(x, roof_m + above_m, z), Vec3::Y).y / PI;
            assert!((found - 1.0).abs() < 0.1, "{kind}: {found} of the sky's light {above_m} m above a roof");
        }
    }
}

/// Receivers of things that the recipe has lit by probes, of a scene whose largest such thing is smaller than that.
fn receivers_of_things(held: &Held, below_m: f32) -> Vec<u32> {
    let world = &held.world;
    let is_small = |block: u32| {
        let instance = world.lightmap.blocks[block as usize].instance;
        world.geometry.scene.instances[instance as usize].size_m() < below_m
    };
    held.receivers(|receiver| is_small(receiver.block))
}

#[test]
fn things_that_probes_light_have_nearly_the_light_of_paths_and_let_it_bounce() {
    for kind in KINDS {
        let lit_below_m = 3.9;
        let recipe = small(kind, 400).with("probe_lit_m", lit_below_m);
        let [by_probes, by_rays] =
            [recipe, small(kind, 400)].map(|recipe| Held::new(scenes::cornell(), &recipe).unwrap());
        let things = receivers_of_things(&by_probes, lit_below_m);
        let count = by_probes.world.lightmap.receivers.len();
        assert!(things.len() > count / 10 && things.len() < count / 2, "{} of {count}", things.len());
        let lighting = lamp_at(Vec3::new(0.3, 3.0, -2.0));
        let compared = |held: &Held, of: &[u32]| {
            let found = held.under(&lighting).unwrap().compared(of, 0.03).unwrap();
            let sums = found.iter().fold([0.0; 3], |[baked, wanted, squares], at| {
                let square = (at.baked - at.reference).powi(2) - at.error.powi(2);
                [baked + at.baked, wanted + at.reference, squares + square]
            });
            let [baked, wanted, squares] = sums;
            let mean = wanted / found.len() as f64;
            [(squares.max(0.0) / found.len() as f64).sqrt() / mean, baked / wanted]
        };
        let few = |of: &[u32]| of.iter().copied().step_by(of.len() / 120).collect::<Vec<_>>();
        let [error, energy] = compared(&by_probes, &few(&things));
        let [error_of_rays, _] = compared(&by_rays, &few(&things));
        let others: Vec<u32> = (0..count as u32).filter(|receiver| !things.contains(receiver)).collect();
        let [beside, energy_beside] = compared(&by_probes, &few(&others));
        let [beside_rays, _] = compared(&by_rays, &few(&others));
        println!(
            "{kind}: {} receivers by probes, error {error:.3} (by rays {error_of_rays:.3}), energy {energy:.3}; \
             others {beside:.3} (with things by rays {beside_rays:.3}), {energy_beside:.3}",
            things.len()
        );
        assert!(error < 0.3, "{kind}: error {error}");
        assert!((energy - 1.0).abs() < 0.06, "{kind}: energy {energy}");
        assert!(
            error > 1.5 * error_of_rays,
            "{kind}: rays err by {error_of_rays}: the things had rays of their own"
        );
        assert!(beside < 1.2 * beside_rays + 0.005, "{kind}: {beside}, {beside_rays} with things by rays");
        assert!((energy_beside - 1.0).abs() < 0.02, "{kind}: {energy_beside}");
    }
}

#[test]
fn box_in_a_sealed_one_is_exactly_dark_by_probes_and_a_furnace_stays_one_without_any_ray_of_its_own() {
    for kind in KINDS {
        let recipe = small(kind, 3000).with("probe_lit_m", 2.0);
        let held = Held::new(scenes::sealed_box(0.1), &recipe).unwrap();
        let lit = held.under(&only(LightKind::Sun { direction: [-0.5, -0.7, -0.5] }, 100.0)).unwrap();
        let inner = receivers_of_things(&held, 2.0);
        assert!(inner.len() > 30, "{} receivers on the inner box", inner.len());
        for receiver in inner {
            assert_eq!(lit.baked(receiver), glam::DVec3::ZERO, "{kind}: light on the inner box");
        }
        let albedo = 0.6;
        let recipe = small(kind, 100).with("probe_lit_m", 100.0);
        let held = Held::new(scenes::furnace(albedo, 3.0, 4.0), &recipe).unwrap();
        let lit = held.under(&Lighting { emitter_scale: 1.0, ..Lighting::default() }).unwrap();
        let wanted = f64::from(3.0 * PI / (1.0 - albedo));
        let all = held.receivers(|_| true);
        let sum: f64 = all.iter().map(|&receiver| luminance(lit.baked(receiver))).sum();
        // By rays E_ind has the light of emitters too.
        let mean = sum / all.len() as f64 / wanted;
        println!("{kind}: a furnace by probes alone has {mean:.4} of what is wanted");
        assert!((mean - 1.0).abs() < 0.01, "{kind}: {mean}");
    }
}

#[test]
fn fields_have_the_same_bytes_on_any_number_of_threads() {
    for kind in KINDS {
        // Its boxes have the light of probes.
        let recipe = small(kind, 60).with("field_fit", 1).with("probe_lit_m", 3.9);
        let field = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let baked = pool.install(|| bake(scenes::cornell(), &recipe).unwrap());
            [field::FIELD, cloud::TETRAHEDRA, CLUSTERS].map(|role| baked.manifest.chunks(role).to_vec())
        };
        let one = field(1);
        assert!(!one[0].is_empty() && one[1].is_empty() == (kind == grid::NAME), "{kind}");
        assert_eq!(one, field(5), "{kind}");
    }
}
