use std::f32::consts::{FRAC_PI_2, PI};

use glam::{IVec3, Vec3};
use lightkiln_worker::geometry::Geometry;
use lightkiln_worker::scene::{Bundle, Limits, import};

use super::brick::{corners, trilinear};
use super::build::{Build, built};
use super::cone::{Cone, Met, Volume, diffuse_cones};
use super::corner::Corner;
use super::fill::Leaves;
use super::filter::{composited, filtered, largest_along};
use super::inject::{Lamp, inject, shadow_map};
use super::shade::shaded;
use super::tree::{Cube, Tree};
use super::{Kind, Manner, Model, Sampling};
use crate::scenes;

const AXES: [Kind; 2] = [Kind::ALL[0], Kind::ALL[1]];

fn full(value: f32) -> Corner {
    Corner { opacity: Vec3::ONE, weight: 1.0, values: [Vec3::splat(value); 6] }
}

fn cube(depth: u32) -> Cube {
    Cube { low_m: Vec3::ZERO, side_m: (1u32 << depth) as f32, depth }
}

/// Voxels of side 1 from the origin on.
fn volume(kind: Kind, depth: u32, voxels: &[(IVec3, Corner)]) -> Volume {
    let tree = Tree::new(cube(depth), voxels.iter().map(|(cell, _)| *cell));
    let leaves = Leaves::new(voxels.iter().map(|(cell, row)| (*cell, *row, Vec3::ONE)));
    let (levels, _) = filtered(&tree, &leaves, kind);
    Volume { tree, levels, kind, sampling: Sampling::Diameters, start: 2.0 }
}

/// A wall of voxels across an axis, from side to side of the cube.
fn wall(axis: usize, depth: u32, at: i32) -> Vec<(IVec3, Corner)> {
    let side = 1 << depth;
    let cell = |index: i32| {
        let mut cell = IVec3::ZERO;
        cell[axis] = at;
        cell[(axis + 1) % 3] = index % side;
        cell[(axis + 2) % 3] = index / side;
        (cell, full(1.0))
    };
    (0..side * side).map(cell).collect()
}

fn traced(volume: &Volume, from_m: Vec3, direction: Vec3, half_angle_rad: f32) -> Met {
    volume.trace(&Cone { from_m, normal: direction, direction, half_angle_rad }, 1e6)
}

#[test]
fn wall_across_an_axis_is_opaque_along_it_and_in_part_along_others_at_every_level() {
    for axis in 0..3 {
        for at in 0..3 {
            let found: Vec<Corner> = corners()
                .map(|corner| if corner[axis] == at { full(1.0) } else { Corner::default() })
                .collect();
            let written = largest_along(&found, [3; 3]).opacity;
            let mended = composited(&found, &[0.5, 1.0, 0.5], Model::Axes).opacity;
            let share = [0.25, 0.5, 0.25][at as usize];
            for other in 0..3 {
                let wanted = if other == axis { [1.0, 1.0] } else { [1.0 / 3.0, share] };
                assert!((written[other] - wanted[0]).abs() < 1e-6, "{axis} {at} {other}: {written}");
                assert!((mended[other] - wanted[1]).abs() < 1e-6, "{axis} {at} {other}: {mended}");
            }
        }
    }
}

#[test]
fn light_towards_an_axis_is_that_of_what_stands_in_front() {
    let bright =
        |value: f32| Corner { opacity: Vec3::splat(0.5), weight: 0.5, values: [Vec3::splat(0.5 * value); 6] };
    // x = 0 has radiance 1, x = 1 radiance 3; both stop half.
    let found: Vec<Corner> = (0..8).map(|at| bright(if at % 2 == 0 { 1.0 } else { 3.0 })).collect();
    let mean = composited(&found, &[1.0, 1.0], Model::Axes);
    assert!((mean.opacity.x - 0.75).abs() < 1e-6);
    let [down, up] = [0, 1].map(|at| mean.values[at].x);
    assert!((down - (0.5 + 0.25 * 3.0)).abs() < 1e-6 && (up - (1.5 + 0.25)).abs() < 1e-6, "{down} {up}");
}

#[test]
fn mended_cone_of_any_width_is_stopped_by_a_wall_and_has_its_radiance() {
    for axis in 0..3 {
        let mut direction = Vec3::ZERO;
        direction[axis] = 1.0;
        let from_m = Vec3::splat(8.5) - 8.0 * direction;
        let volumes = AXES.map(|kind| volume(kind, 4, &wall(axis, 4, 9)));
        for half_angle_rad in [0.03_f32, 0.15, 0.5] {
            let [written, mended] =
                volumes.each_ref().map(|volume| traced(volume, from_m, direction, half_angle_rad));
            assert!(mended.opacity > 0.995, "{axis} {half_angle_rad}: {mended:?}");
            let radiance = mended.light / mended.opacity;
            assert!((radiance - 1.0).abs().max_element() < 1e-3, "{axis} {half_angle_rad}: {mended:?}");
            assert!(written.opacity <= 1.0, "{written:?}");
        }
    }
}

#[test]
fn empty_space_stops_nothing() {
    let volume = volume(AXES[1], 5, &wall(0, 5, 30));
    assert_eq!(traced(&volume, Vec3::splat(16.5), Vec3::NEG_X, 0.3), Met::default());
}

#[test]
fn written_samples_count_up_to_the_root_of_three_on_the_diagonal_and_mended_ones_once() {
    let diagonal = Vec3::ONE.normalize();
    let [written, mended] = AXES.map(|kind| shaded(&full(1.0), diagonal, 0.1, kind));
    assert!(
        (written.1 - 3f32.sqrt()).abs() < 1e-5 && (written.0.x - 3f32.sqrt()).abs() < 1e-5,
        "{written:?}"
    );
    assert!((mended.1 - 1.0).abs() < 1e-6 && (mended.0.x - 1.0).abs() < 1e-6, "{mended:?}");
    let [straight, _] = AXES.map(|kind| shaded(&full(1.0), Vec3::X, 0.1, kind));
    assert_eq!(straight, (Vec3::ONE, 1.0));
}

/// Any values in [0, 1).
fn varied(cell: IVec3) -> Corner {
    let share = |salt: i32| ((cell.x * 7 + cell.y * 13 + cell.z * 29 + salt * 5) % 17) as f32 / 17.0;
    Corner {
        opacity: Vec3::ONE,
        weight: 1.0,
        values: std::array::from_fn(|at| Vec3::splat(share(at as i32))),
    }
}

/// Of voxels that fill a block of nodes, values go on without a jump from brick to brick.
#[test]
fn neighbours_agree_where_they_touch() {
    let block: Vec<(IVec3, Corner)> =
        (0..512).map(|at| IVec3::new(at % 8, at / 8 % 8, at / 64)).map(|cell| (cell, varied(cell))).collect();
    for kind in AXES {
        let volume = volume(kind, 3, &block);
        for level in 0..2 {
            let side_m = (2 << level) as f32;
            for across in [0.3, 1.1, 1.9, 3.7] {
                let face_m = Vec3::new(side_m, across, 0.8 * across + 0.1);
                let [below, above] = [-1e-4, 1e-4].map(|step| {
                    let point_m = face_m + Vec3::X * step;
                    trilinear(&volume.tree, &volume.levels, level, point_m, kind.manner)
                });
                for at in 0..6 {
                    let jump = (below.values[at] - above.values[at]).abs().max_element();
                    assert!(jump < 2e-3, "{kind:?} {level} {face_m}: {jump}");
                }
            }
        }
    }
}

/// Figure 5.10: where a neighbour is missing, edges of written bricks are not halved.
#[test]
fn written_edges_keep_their_value_where_a_neighbour_is_missing() {
    let lone = [(IVec3::new(2, 2, 2), full(1.0))];
    let with_neighbour = [lone[0], (IVec3::new(0, 3, 3), full(0.0))];
    let corner = |voxels: &[(IVec3, Corner)]| {
        let volume = volume(AXES[0], 3, voxels);
        trilinear(&volume.tree, &volume.levels, 0, Vec3::splat(2.0), Manner::Written).values[0].x
    };
    assert_eq!(corner(&lone), 1.0);
    assert_eq!(corner(&with_neighbour), 0.5);
}

#[test]
fn diffuse_cones_fill_the_hemisphere() {
    for count in [4, 6, 8, 12, 64] {
        let (half_angle_rad, cones) = diffuse_cones(count);
        let solid = count as f32 * 2.0 * PI * (1.0 - half_angle_rad.cos());
        assert!((solid - 2.0 * PI).abs() < 1e-4);
        let weight: f32 = cones.iter().map(|(_, weight)| weight).sum();
        assert!((weight - 1.0).abs() < 1e-5 && cones.len() == count as usize);
        assert!(
            cones.iter().all(|(axis, _)| axis.z.acos() < FRAC_PI_2 && (axis.length() - 1.0).abs() < 1e-5)
        );
    }
}

fn geometry(scene: Vec<u8>) -> Geometry {
    let limits = Limits::default();
    Geometry::new(import(&Bundle::from_bytes(scene, &limits).unwrap(), &limits).unwrap().scene).unwrap()
}

const BUILD: Build = Build { depth: 6, shadow_map: 128, sampling: Sampling::Paper, start: 2.0 };

/// A closed room whose walls have radiance 1 is of radiance 1 in every cone.
#[test]
fn mended_models_have_the_light_of_a_white_furnace() {
    let geometry = geometry(scenes::furnace(0.5, 1.0, 4.0));
    let [low_m, high_m] = geometry.bounds_m();
    let middle_m = 0.5 * (low_m + high_m);
    for model in [Model::Axes, Model::Lobes] {
        let kind = Kind { model, manner: Manner::Mended };
        let volume = built(&geometry, kind, &BUILD, None, |_| Vec3::ONE).volume;
        let lights: Vec<f32> = (0..64)
            .map(|at| {
                let direction = lightkiln_proto::harmonics::relight_direction(at, 64);
                let met = traced(&volume, middle_m, direction, 0.1);
                assert!(met.opacity > 0.8, "{kind:?} {direction}: {met:?}");
                met.light.x / met.opacity
            })
            .collect();
        let mean = lights.iter().sum::<f32>() / 64.0;
        println!("{kind:?}: {mean:.4}");
        // Lobes see some backs in corners, where normals differ.
        let most = if model == Model::Axes { 1e-3 } else { 0.1 };
        assert!(lights.iter().all(|light| (light - 1.0).abs() < most), "{kind:?}: {lights:?}");
        assert!((mean - 1.0).abs() < 0.02, "{kind:?}: {mean}");
    }
}

#[test]
fn one_texel_writes_a_voxel_and_light_falls_with_the_square() {
    let geometry = geometry(scenes::furnace(0.5, 0.0, 4.0));
    let [low_m, high_m] = geometry.bounds_m();
    let lamp = Lamp { position_m: 0.5 * (low_m + high_m), intensity: Vec3::splat(8.0) };
    let kind = AXES[0];
    let made = built(&geometry, kind, &BUILD, Some(&lamp), |_| Vec3::ZERO);
    assert!(made.injected.dropped > 0 && made.injected.written > 0, "{:?}", made.injected);
    let cube = made.volume.tree.cube;
    let mut leaves =
        super::fill::leaves(&geometry, &super::fill::fragments(&geometry, &cube), kind, |_| Vec3::ZERO);
    let seen = shadow_map(&geometry, &lamp, BUILD.shadow_map);
    let counts = inject(&mut leaves, &cube, kind.model, &lamp, &seen);
    assert_eq!(counts.written + counts.dropped + counts.lost, 6 * 128 * 128);
    let lit = leaves.rows.iter().filter(|row| row.values.iter().any(|value| value.x > 0.0)).count();
    assert_eq!(lit, counts.written);
    // Straight below, at half of the room's height, a voxel has I ρ/d² towards the lamp.
    let below_m = Vec3::new(lamp.position_m.x + 0.03, low_m.y, lamp.position_m.z + 0.03);
    let row = leaves.find(cube.voxel_of(below_m)).unwrap();
    let wanted = 8.0 * 0.5 / (lamp.position_m.y - low_m.y).powi(2);
    assert!((row.values[3].x / wanted - 1.0).abs() < 0.02 && row.values[2].x == 0.0, "{row:?}, not {wanted}");
}
