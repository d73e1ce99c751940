//! Rays of receivers, and rows that are no receivers': coefficients of light at points in free space.

use std::f32::consts::PI;

use glam::Vec3;
use lightkiln_proto::content::COVERAGE_POINTS;
use lightkiln_proto::content::PatchKey;
use lightkiln_proto::harmonics::{ShBasis, band_of, relight_direction};
use lightkiln_proto::kinds::SceneTask;
use lightkiln_proto::kinds::prt::{Settings, first_tasks};
use serde_json::json;

use super::*;
use crate::emitters::EmitterSet;
use crate::factors::{PatchMatrix, TruncationBounds};
use crate::geometry::{Grid, Trail};
use crate::kinds::{BakeKinds, Runner};
use crate::lightmap::{Surface, World};
use crate::patches::PatchTree;
use crate::task::{LocalRun, Progress};

const CORNELL: &[u8] = include_bytes!("../../../tests/scenes/cornell.glb");
const FURNACE: &[u8] = include_bytes!("../../../tests/scenes/furnace.glb");
const ATRIUM: &[u8] = include_bytes!("../../../tests/scenes/atrium.glb");
const RAYS: u32 = 512;
/// Level of the patches whose means are looked at, and how many of their sides away rays come from.
const MEAN_LEVEL: u64 = 3;
const FAR_SIDES: f32 = 1.5;
/// `A_l`: the cosine lobe's coefficient of each band.
const COSINE_LOBE: [f32; 3] = [PI, 2.0 * PI / 3.0, PI / 4.0];

/// Nine rows of a point, one per spherical harmonic: `q_j = A_l 4π/N Σ_k L(y_k) Y_j(ω_k)`.
fn rows_of(world: &World, sources: &Sources, point_m: Vec3) -> Vec<RowHits> {
    let basis = ShBasis::new(2);
    let mut rows = vec![RowHits::default(); basis.coefficients()];
    let mut y = vec![0.0; rows.len()];
    for ray in 0..RAYS {
        let direction = relight_direction(ray, RAYS);
        basis.evaluate(direction, &mut y);
        let hit = world.geometry.tracer.closest(point_m, direction, f32::INFINITY);
        let leaf = hit.and_then(|hit| sources.at(&hit, point_m + direction * hit.t).leaf);
        for (j, row) in rows.iter_mut().enumerate() {
            let weight = COSINE_LOBE[band_of(j)] * y[j];
            row.leaves.extend(leaf.map(|at| RayHit { at, is_even: ray % 2 == 0, weight }));
        }
    }
    rows
}

fn settings() -> Settings {
    Settings::from_json(&json!({ "preset": "draft", "receivers_target": 2000 })).unwrap()
}

/// A run of a scene's shared tasks.
fn prepared<'a>(scene: &[u8], settings: &Settings, progress: &'a Progress) -> LocalRun<'a> {
    let mut run = LocalRun::new(1 << 30, progress);
    let plan = first_tasks(run.shelf.put(scene.to_vec()), settings);
    let is_scene = |kind: &str| SceneTask::ALL.iter().any(|task| task.name() == kind);
    run.run(&Runner::new(&BakeKinds::new()), plan, is_scene, |_| {}).unwrap();
    run
}

#[test]
fn rays_of_a_receiver_leave_from_all_points_of_its_texel_alike() {
    let progress = Progress::new();
    let world = World::of_run(&prepared(CORNELL, &settings(), &progress)).unwrap();
    let (emitters, offset_m) = (EmitterSet::default(), world.geometry.tracer.ray_offset_m(Vec3::ZERO));
    let mut cut = 0;
    for receiver in 0..world.lightmap.receivers.len() as u32 {
        let lender = world.lightmap.receivers[receiver as usize].light_of;
        let points = world.gathering_points_of(receiver);
        cut += u32::from((2..COVERAGE_POINTS as usize).contains(&world.lit_points_of(lender).len()));
        let mut rays = vec![0; points.len()];
        Hemisphere::new(&world, &emitters, receiver, 100).cast(0, &Trail::new(&Grid::default()), |ray, _| {
            let point = points.iter().position(|site| site.ray_origin_m(offset_m) == ray.origin_m).unwrap();
            assert!(ray.direction.dot(points[point].face_normal) >= 0.0);
            rays[point] += 1;
        });
        assert_eq!(rays.iter().sum::<usize>(), 100);
        let even = 100 / points.len();
        assert!(rays.iter().all(|&count| count == even || count == even + 1), "{rays:?}");
    }
    assert!(cut > 20, "{cut} texels are cut by a wall");
}

#[test]
fn rows_of_points_in_free_space_are_cut_factorised_and_bring_the_light_of_a_furnace() {
    let progress = Progress::new();
    let settings = settings();
    let run = prepared(FURNACE, &settings, &progress);
    let world = World::of_run(&run).unwrap();
    let inputs = run.scene_inputs(&["patches/patches"]);
    let tree = PatchTree::of(&run.context(&inputs)).unwrap();

    let sources = Sources::new(&world, &tree, 16);
    let [low, high] = tree.patches.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], patch| {
        [low.min(patch.bounds_m[0]), high.max(patch.bounds_m[1])]
    });
    let points_m = [0.3, 0.5, 0.6].map(|at| low + (high - low) * at);
    let hits: Vec<RowHits> = points_m.iter().flat_map(|&point| rows_of(&world, &sources, point)).collect();
    let scale = 4.0 * PI / RAYS as f32;
    let texel_m = world.lightmap.texel_m;
    let bounds = Some(CutBounds { columns_max: 200, error: 0.01 });
    let cut = patch_rows(&tree, texel_m, &mut hits.clone(), scale, bounds);
    let finest = patch_rows(&tree, texel_m, &mut hits.clone(), scale, None);
    assert!(cut.keys.len() > 6 && cut.keys.len() <= finest.keys.len(), "{} columns", cut.keys.len());

    // Under radiance 1 from everywhere the irradiance is π along every normal, also by the factors.
    let matrix = PatchMatrix::new(&cut.keys, cut.rows.iter().map(|row| (&row.alpha[..], &row.importance)));
    let rows: Vec<usize> = (0..cut.rows.len()).collect();
    let (factors, _) = matrix.factored(&rows, TruncationBounds { rank_max: 48, error_max: 0.01 });
    let columns = matrix.used(&rows).len();
    assert!(factors.rank > 0 && factors.u.len() == rows.len() * factors.rank);
    // Columns of differences then read 0, all others 1.
    let light = |keys: &[u64]| -> Vec<f32> {
        keys.iter().map(|&key| if PatchKey(key).is_difference() { 0.0 } else { 1.0 }).collect()
    };
    let used: Vec<u64> = matrix.used(&rows).iter().map(|&column| cut.keys[column as usize]).collect();
    let read = |alpha: &[f32], light: &[f32]| alpha.iter().zip(light).map(|(a, l)| a * l).sum::<f32>();
    let of_used = light(&used);
    let b: Vec<f32> = factors.vt.chunks_exact(columns).map(|row| read(row, &of_used)).collect();
    let by_factors = factors.u.chunks_exact(factors.rank).map(|u| u.iter().zip(&b).map(|(u, b)| u * b).sum());
    let by_sums = |found: &PatchRows| -> Vec<f32> {
        let light = light(&found.keys);
        found.rows.iter().map(|row| read(&row.alpha, &light)).collect()
    };
    for q in [by_sums(&cut), by_sums(&finest), by_factors.collect::<Vec<f32>>()] {
        for q in q.chunks_exact(9) {
            let mut y = [0.0; 9];
            for normal in [Vec3::X, Vec3::NEG_Y, Vec3::new(0.6, 0.0, 0.8)] {
                ShBasis::new(2).evaluate(normal, &mut y);
                let irradiance: f32 = q.iter().zip(&y).map(|(q, y)| q * y).sum();
                assert!((irradiance - PI).abs() < 0.03 * PI, "{irradiance} along {normal}");
            }
        }
    }
}

/// Light that falls off into folds, read by what is far: a patch's mean is that of its parts as rays meet them.
#[test]
fn means_by_seen_area_are_those_of_far_rays() {
    let progress = Progress::new();
    let settings = Settings::from_json(&json!({ "preset": "draft", "receivers_target": 30_000 })).unwrap();
    let run = prepared(ATRIUM, &settings, &progress);
    let world = World::of_run(&run).unwrap();
    let inputs = run.scene_inputs(&["patches/patches"]);
    let tree = PatchTree::of(&run.context(&inputs)).unwrap();
    let area = |receiver: u32| world.lightmap.receivers[receiver as usize].area.texels();
    let seen_area = |receiver: u32| tree.seen_areas[receiver as usize].texels();
    // Radiance as the share of rays that meet nothing near.
    let emitters = EmitterSet::default();
    let far_m = FAR_SIDES * (1 << MEAN_LEVEL) as f32 * world.lightmap.texel_m;
    let radiances: Vec<f64> = (0..world.lightmap.receivers.len() as u32)
        .map(|receiver| {
            let mut free = 0;
            Hemisphere::new(&world, &emitters, receiver, 64).cast(
                0,
                &Trail::new(&Grid::default()),
                |_, hit| {
                    free += u32::from(hit.is_none_or(|hit| hit.t > 0.5 * far_m));
                },
            );
            f64::from(free) / 64.0
        })
        .collect();
    let radiance = |receiver: u32| radiances[receiver as usize];
    let mean = |patch: u32, weight: &dyn Fn(u32) -> f32| {
        let of = tree.receivers_of(&tree.patches[patch as usize]).iter();
        let weighted = of.map(|&r| [f64::from(weight(r)) * radiance(r), f64::from(weight(r))]);
        let [sum, weights] = weighted.fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        sum / weights
    };
    // The patch of a level around each receiver.
    let mut around = vec![None; world.lightmap.receivers.len()];
    for (index, patch) in (0_u32..).zip(&tree.patches) {
        if patch.key.level() == MEAN_LEVEL {
            tree.receivers_of(patch).iter().for_each(|&receiver| around[receiver as usize] = Some(index));
        }
    }
    let (mut met, mut by_area, mut by_seen_area) = (0.0, 0.0, 0.0);
    for receiver in (0..world.lightmap.receivers.len() as u32).step_by(13) {
        Hemisphere::new(&world, &emitters, receiver, 64).cast(
            0,
            &Trail::new(&Grid::default()),
            |ray, hit| {
                let Some(hit) = hit.filter(|hit| hit.t > far_m) else { return };
                let read = world.linked_surface_at(hit, ray.origin_m + ray.direction * hit.t);
                if let Surface::Receiver(read) = read
                    && let Some(patch) = around[read as usize]
                {
                    met += radiance(read);
                    by_area += mean(patch, &area);
                    by_seen_area += mean(patch, &seen_area);
                }
            },
        );
    }
    println!("texel {} m, {} receivers", world.lightmap.texel_m, world.lightmap.receivers.len());
    println!("by area {:.4} of what rays meet, by seen area {:.4}", by_area / met, by_seen_area / met);
    assert!(by_area < 0.99 * met, "the scene has no folds: the test shows nothing");
    assert!((by_seen_area / met - 1.0).abs() < 0.4 * (1.0 - by_area / met));
}
