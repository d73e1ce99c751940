use std::sync::Arc;

use glam::{Affine3A, Mat3, Quat, Vec3, Vec4};

use super::*;
use crate::content::{PatchKey, PatchSet};
use crate::relight::{PatchTable, SlotTable};

/// A ball of radius 1 m in one part of no patch, of all levels: F = π sin²α towards it, Ω = 2π(1 − cosα).
fn ball(nodes: u32) -> Vec<TransferLevel> {
    let box_m = [[-1.0; 3], [1.0; 3]];
    let of_level = |level: u32| {
        let lattice = Lattice::new(box_m, level, nodes);
        let at = |index: usize| {
            let from_m = lattice.node_m(index);
            let sine = (1.0 / from_m.length()).min(1.0);
            let omega = std::f32::consts::TAU * (1.0 - (1.0 - sine * sine).sqrt());
            let vector = -from_m.normalize() * std::f32::consts::PI * sine * sine;
            [vector.x, vector.y, vector.z, omega]
        };
        let numbers: Vec<[f32; 4]> = (0..(nodes as usize).pow(3)).map(at).collect();
        let (codes, steps) = node_codes(&numbers, |_| true);
        let glows = vec![PartGlow { emitter: 0, share: [1.0; 3] }];
        TransferLevel {
            level,
            box_m,
            nodes,
            parts: vec![TransferPart { glows, steps, ..TransferPart::default() }],
            codes,
        }
    };
    (0..LEVELS).map(of_level).collect()
}

fn table(levels: Vec<TransferLevel>) -> TransferTable {
    let slots = SlotTable::new([]).unwrap();
    let patches = PatchTable::new(&PatchSet { leaf_starts: vec![0], ..PatchSet::default() }, &slots).unwrap();
    TransferTable::new(levels, &patches).unwrap()
}

#[test]
fn nodes_stand_on_the_bounds_of_the_object_and_fill_the_cube() {
    for (box_m, nodes) in [
        ([[-1.0; 3], [1.0; 3]], 16),
        ([[0.0, 0.0, 0.0], [0.02, 2.0, 1.0]], 16),
        ([[0.0; 3], [1.0, 0.0, 0.3]], 24),
        ([[-1.0; 3], [1.0; 3]], 5),
    ] {
        for level in 0..LEVELS {
            let Lattice { axes, middle_m, half_m, .. } = Lattice::new(box_m, level, nodes);
            for (axis, along) in axes.iter().enumerate() {
                assert_eq!(along.inner + 2 * along.outer, nodes - 1, "{along:?}");
                let places: Vec<f32> = (0..nodes).map(|node| along.node_m(node)).collect();
                assert!(places.windows(2).all(|pair| pair[0] < pair[1]), "{places:?}");
                let bounds = [places[0] - middle_m[axis], places[nodes as usize - 1] - middle_m[axis]];
                assert!((bounds[0] + half_m).abs() < 1e-5 && (bounds[1] - half_m).abs() < 1e-5, "{bounds:?}");
                let [low, high] = [box_m[0][axis], box_m[1][axis]];
                let before = places.iter().rfind(|place| **place < low).unwrap();
                let behind = places.iter().find(|place| **place > high).unwrap();
                assert!(low - before < 0.01 && behind - high < 0.01, "{low} {high}: {places:?}");
                for (node, place) in places.iter().enumerate() {
                    assert!(
                        (along.at(*place) - node as f32).abs() < 1e-3,
                        "{node} {place}: {}",
                        along.at(*place)
                    );
                }
            }
        }
    }
}

#[test]
fn levels_are_stored_without_loss_in_less() {
    let levels = ball(16);
    for level in &levels {
        let bytes = encode_transfer(level).unwrap();
        assert_eq!(&decode_transfer(&bytes).unwrap(), level);
        assert!(bytes.len() < 4 * level.codes.len(), "{}", bytes.len());
    }
    let with = TransferPart {
        patches: vec![
            PartPatch { key: PatchKey(3), share: 0.25 },
            PartPatch { key: PatchKey(9), share: 0.75 },
        ],
        plane: [0.0, 0.6, 0.8, -0.5],
        ..levels[0].parts[0].clone()
    };
    let level = TransferLevel { parts: vec![with], ..levels[0].clone() };
    assert_eq!(decode_transfer(&encode_transfer(&level).unwrap()).unwrap(), level);
}

#[test]
fn wrong_levels_are_refused_with_the_reason() {
    let level = &ball(5)[1];
    let refused = |change: &dyn Fn(&mut TransferLevel)| {
        let mut wrong = level.clone();
        change(&mut wrong);
        encode_transfer(&wrong).unwrap_err().to_string()
    };
    for (error, word) in [
        (refused(&|level| level.level = 4), "level"),
        (refused(&|level| level.nodes = 65), "nodes"),
        (refused(&|level| level.codes.truncate(9)), "codes"),
        (refused(&|level| level.codes[3][2] = -128), "code"),
        (refused(&|level| level.box_m[0][1] = 2.0), "edges"),
        (refused(&|level| level.box_m = [[1.0; 3]; 2]), "longest edge"),
        (refused(&|level| level.parts[0].steps[1] = f32::NAN), "step"),
        (refused(&|level| level.parts[0].plane[0] = 0.5), "plane"),
        (refused(&|level| level.parts[0].glows[0].share[1] = -1.0), "glow"),
        (
            refused(&|level| level.parts[0].patches = vec![PartPatch { key: PatchKey(1), share: 0.5 }; 2]),
            "patch",
        ),
    ] {
        assert!(error.contains(word), "{word}: {error}");
    }
    let bytes = encode_transfer(level).unwrap();
    for length in 0..bytes.len() {
        assert!(decode_transfer(&bytes[..length]).is_err());
    }
    let slots = SlotTable::new([]).unwrap();
    let patches = PatchTable::new(&PatchSet { leaf_starts: vec![0], ..PatchSet::default() }, &slots).unwrap();
    let mut levels = ball(5);
    levels[2].parts[0].patches = vec![PartPatch { key: PatchKey(5), share: 1.0 }];
    let error = TransferTable::new(levels.clone(), &patches).unwrap_err().to_string();
    assert!(error.contains("level 2") && error.contains("patch 5"), "{error}");
    levels.pop();
    assert!(TransferTable::new(levels, &patches).unwrap_err().to_string().contains("wanted 0 to 3"));
}

/// A ball of radiance 1 in black surroundings gives π sin²α cosθ; in surroundings of 1 it changes nothing; a dark one takes as much.
#[test]
fn ball_gives_its_form_factor_and_takes_what_it_hides() {
    let table = table(ball(16));
    let [black, white] = [0.0, 1.0].map(|light| Surroundings::new(64, |_| Vec3::splat(light)));
    let place = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.5),
        Quat::from_rotation_y(0.7),
        Vec3::new(3.0, 1.0, 0.0),
    );
    let radiance = |light: f32| Arc::new(table.radiance(&[] as &[Vec4], &[Vec3::splat(light)]));
    let [black, white] = [black, white].map(|around| {
        Arc::new(table.hidden(&Viewpoints::new(ViewpointLattice::new([[0.0; 3], [1.0; 3]], 0.1), |_| {
            Some(around.clone())
        })))
    });
    let standing =
        |light, hidden: &Arc<Vec<Vec<Hidden>>>| Standing::new(&table, place, radiance(light), hidden.clone());
    let (mut worst, mut points) = (0.0_f32, 0);
    for step in 0..512_u32 {
        let direction = crate::harmonics::relight_direction(step, 512);
        let away_m = 0.51 + 4.0 * (step as f32 / 512.0);
        let at_m = Vec3::new(3.0, 1.0, 0.0) + direction * away_m;
        let normal = (-direction + 0.3 * Vec3::Y).normalize();
        let sine = 0.5 / away_m;
        let wanted = std::f32::consts::PI * sine * sine * normal.dot(-direction).max(0.0);
        let found = standing(1.0, &black).change(at_m, normal).x;
        worst = worst.max((found - wanted).abs());
        let taken = standing(0.0, &white).change(at_m, normal).x;
        assert!((found + taken).abs() < 1e-5, "{found} {taken}");
        assert!(standing(1.0, &white).change(at_m, normal).abs().max_element() < 1e-6);
        assert_eq!(
            standing(1.0, &black).change(at_m, direction).max_element().max(0.0),
            standing(1.0, &black).change(at_m, direction).x
        );
        points += 1;
    }
    println!("worst of {points}: {worst}");
    assert!(points == 512 && worst < 0.12, "{worst}");
    // Beyond 12 H nothing changes, and it fades before.
    let along = Quat::from_rotation_y(0.7) * Vec3::X;
    let at = |h: f32| standing(1.0, &black).change(Vec3::new(3.0, 1.0, 0.0) + 0.5 * h * along, -along).x;
    assert!(at(9.9) > 0.0 && at(11.0) < at(9.9) && at(12.01) == 0.0 && at(100.0) == 0.0);
}

#[test]
fn parts_are_not_seen_from_behind_their_planes() {
    let mut levels = ball(8);
    levels.iter_mut().for_each(|level| level.parts[0].plane = [1.0, 0.0, 0.0, 0.0]);
    let table = table(levels);
    let seen = |at_m: Vec3| {
        let mut count = 0;
        table.covered(at_m, |_, _| count += 1);
        count
    };
    assert_eq!([seen(Vec3::X * 1.2), seen(-Vec3::X * 1.2)], [1, 0]);
    assert!(seen(Vec3::X * 1.45) == 2 && seen(Vec3::X * 13.0) == 0);
}

#[test]
fn cap_has_the_mean_of_the_directions_within() {
    let half = Surroundings::new(64, |direction| Vec3::splat(f32::from(u8::from(direction.x > 0.0))));
    assert!((half.mean(Vec3::X, 0.5, 0.06).x - 1.0).abs() < 1e-6 && half.mean(-Vec3::X, 0.5, 0.06).x < 1e-6);
    let across = half.mean(Vec3::Y, 0.2, 0.06).x;
    assert!((across - 0.5).abs() < 0.1, "{across}");
    for direction in (0..512).map(|step| crate::harmonics::relight_direction(step, 512)) {
        let least = half.mean(direction, libm::cosf(0.2), 0.06).x;
        assert!(
            (0.0..=1.0).contains(&least) && (direction.x.abs() < 0.5 || (least > 0.5) == (direction.x > 0.0)),
            "{direction}"
        );
    }
    let turned = Surroundings::new(64, |direction| Mat3::from_rotation_y(1.0) * direction);
    // Interpolated from nodes and widths it is nearly that.
    let hidden = Hidden::of(&turned);
    let (mut sum, mut worst) = (0.0, 0.0_f32);
    for (step, axis) in (0..512).map(|step| (step, crate::harmonics::relight_direction(step, 512))) {
        let solid_angle = 0.1 * 1.008_f32.powi(step as i32);
        let cosine = (1.0 - solid_angle / std::f32::consts::TAU).min(libm::cosf(0.2));
        let off = hidden.mean(axis, solid_angle).distance(turned.mean(axis, cosine, 0.06));
        (sum, worst) = (sum + off, worst.max(off));
    }
    assert!(sum / 512.0 < 0.025 && worst < 0.05, "mean {} worst {worst}", sum / 512.0);
    assert_eq!(Hidden::default().mean(Vec3::X, 1.0), Vec3::ZERO);
    assert_eq!(turned.radiance().len(), 64);
}

/// An object turned, moved and scaled together with the point and its surroundings changes as much, turned with it.
#[test]
fn turned_and_scaled_with_all_around_it_it_changes_as_much() {
    let mut levels = ball(12);
    levels.iter_mut().for_each(|level| level.parts[0].plane = [0.0, 1.0, 0.0, -0.5]);
    let table = table(levels);
    // Surroundings are in the object's frame, and so go with it.
    let around =
        Surroundings::new(64, |direction| Vec3::new(1.0 + direction.x, 1.0, 0.5 - 0.5 * direction.z));
    let radiance = Arc::new(table.radiance(&[] as &[Vec4], &[Vec3::new(0.5, 2.0, 0.0)]));
    let hidden =
        Arc::new(table.hidden(&Viewpoints::new(ViewpointLattice::new([[0.0; 3], [1.0; 3]], 0.1), |_| {
            Some(around.clone())
        })));
    let first = Affine3A::from_translation(Vec3::new(0.3, -0.2, 5.0));
    let moved = Affine3A::from_scale_rotation_translation(
        Vec3::splat(3.5),
        Quat::from_euler(glam::EulerRot::XYZ, 0.4, 1.7, -0.9),
        Vec3::new(-7.0, 2.0, 1.0),
    );
    let standing = |place| Standing::new(&table, place, radiance.clone(), hidden.clone());
    let mut most = 0.0_f32;
    for step in 0..256_u32 {
        let direction = crate::harmonics::relight_direction(step, 256);
        let at_m = first.transform_point3(direction * (1.1 + 0.03 * step as f32));
        let normal = (Vec3::Y - direction).normalize();
        let [one, other] = [
            standing(first).change(at_m, normal),
            standing(moved * first)
                .change(moved.transform_point3(at_m), (Mat3::from(moved.matrix3) * normal).normalize()),
        ];
        most = most.max(one.abs().max_element());
        assert!(one.distance(other) < 2e-4, "{step}: {one} {other}");
    }
    assert!(most > 0.1, "{most}");
}

/// A ball close before another one hides it as far as it covers it; one beside or behind it hides nothing.
#[test]
fn nearer_ball_hides_what_it_covers() {
    let cap = |towards: Vec3, distance_m: f32, half_angle_rad: f32| Cap {
        towards: towards.normalize(),
        distance_m,
        half_angle_rad,
    };
    let far = cap(Vec3::Z, 4.0, 0.2);
    assert!((far.hidden_by(&cap(Vec3::Z, 2.0, 0.5)) - 1.0).abs() < 1e-5);
    let quarter = far.hidden_by(&cap(Vec3::Z, 2.0, 0.1));
    assert!((quarter - 0.25).abs() < 0.01, "{quarter}");
    let some = far.hidden_by(&cap(Vec3::new(0.3, 0.0, 1.0), 2.0, 0.25));
    assert!(some > 0.05 && some < 0.95, "{some}");
    for beside in
        [cap(Vec3::X, 2.0, 0.5), cap(Vec3::Z, 4.0, 0.5), cap(Vec3::Z, 9.0, 0.5), cap(Vec3::Z, 1.0, 0.0)]
    {
        assert_eq!(far.hidden_by(&beside), 0.0);
    }
    let table = table(ball(16));
    let place = Affine3A::from_scale_rotation_translation(
        Vec3::splat(2.0),
        Quat::from_rotation_z(0.8),
        Vec3::X * 8.0,
    );
    let seen = Standing::new(&table, place, Arc::default(), Arc::default()).cap(Vec3::ZERO);
    assert!((seen.distance_m - 8.0).abs() < 1e-4 && seen.towards.distance(Vec3::X) < 0.03, "{seen:?}");
    assert!((seen.half_angle_rad - 0.25_f32.asin()).abs() < 0.02, "{seen:?}");
}

/// Viewpoints that see nothing leave their weight to the others, and those of a rug lie off its floor.
#[test]
fn viewpoints_in_geometry_count_no_more() {
    let look = |at_m: Vec3| (at_m.y > 0.0).then(|| Surroundings::new(64, |_| at_m));
    let rug = [[-1.0, 0.0, -0.5], [1.0, 0.0, 0.5]];
    let lattice = ViewpointLattice::new(rug, 1.0);
    assert_eq!((lattice.counts.to_array(), lattice.count()), ([4, 2, 4], 32));
    let viewpoints = Viewpoints::new(lattice, look);
    assert_eq!(viewpoints.seen().iter().flatten().count(), 16);
    for at_m in [Vec3::ZERO, Vec3::new(0.9, 0.0, 0.2), Vec3::new(-3.0, -1.0, 0.0)] {
        let weights = viewpoints.weights(at_m);
        assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{weights:?}");
        let there = viewpoints
            .seen()
            .iter()
            .zip(&weights)
            .filter_map(|(seen, weight)| Some((Hidden::of(seen.as_ref()?), *weight)));
        let there: Vec<(Hidden, f32)> = there.collect();
        let seen = Hidden::mixed(there.iter().map(|(seen, weight)| (seen, *weight))).mean(Vec3::X, 3.0);
        let wanted = at_m.clamp(Vec3::new(-0.97, 0.05, -0.485), Vec3::new(0.97, 0.05, 0.485));
        let off = if at_m.y < 0.0 { 0.2 } else { 1e-4 };
        assert!(seen.distance(wanted) < off, "{seen} {wanted}");
    }
    let none = Viewpoints::new(lattice, |_| None);
    assert!(none.weights(Vec3::ZERO).iter().all(|weight| *weight == 0.0));
    // A thing of a decimetre has its corners.
    assert_eq!(ViewpointLattice::new(rug, 0.05).counts.to_array(), [2; 3]);
}

/// Nodes that no point of a level reads do not coarsen its steps; all that are read come back within half a step.
#[test]
fn steps_are_those_of_nodes_that_are_read() {
    for level in ball(16) {
        let lattice = Lattice::new(level.box_m, level.level, level.nodes);
        let is_read = lattice.read_nodes(level.level);
        let at = |index: usize| {
            let from_m = lattice.node_m(index);
            let sine = (1.0 / from_m.length()).min(1.0);
            let vector = -from_m.normalize() * std::f32::consts::PI * sine * sine;
            vector.extend(std::f32::consts::TAU * (1.0 - (1.0 - sine * sine).sqrt())).to_array()
        };
        let numbers: Vec<[f32; 4]> = (0..4096).map(at).collect();
        let (codes, [step, of_angle]) = node_codes(&numbers, |index| is_read[index]);
        let coarse = node_codes(&numbers, |_| true).1[0];
        for index in (0..4096).filter(|index| is_read[*index]) {
            let off = |axis: usize, step: f32| {
                (f32::from(codes[index][axis]) * step - numbers[index][axis]).abs() / step
            };
            assert!((0..3).all(|axis| off(axis, step) < 0.501) && off(3, of_angle) < 0.501);
        }
        println!("level {}: steps {step:.5}, of all nodes {coarse:.5}", level.level);
        assert_eq!(level.level == 0, is_read.iter().all(|is_read| *is_read));
        assert!(step < [1.01, 1.01, 0.4, 0.3][level.level as usize] * coarse);
    }
}
