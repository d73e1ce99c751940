use std::collections::BTreeMap;

use super::*;
use crate::rays::sampling::{Sequence, seed_of};

const BOX: [IVec3; 2] = [IVec3::ZERO, IVec3::splat(64)];

/// A box, and points with keys.
type Set = ([IVec3; 2], Vec<(IVec3, u64)>);

/// Points in a box: at random, of a lattice, in layers, on a line, far from the origin, and in the middle of a large box.
fn sets() -> Vec<Set> {
    let mut numbers = Sequence::new(seed_of(&[1]));
    let mut within = |side: i32| 1 + (numbers.next_f32() * (side - 2) as f32) as i32;
    let keyed = |points: Vec<IVec3>| -> Vec<(IVec3, u64)> {
        let distinct: BTreeMap<[i32; 3], IVec3> = points.into_iter().map(|at| (at.to_array(), at)).collect();
        distinct.into_values().map(|at| (at, seed_of(&[at.x as u64, at.y as u64, at.z as u64]))).collect()
    };
    let random = keyed((0..200).map(|_| IVec3::new(within(64), within(64), within(64))).collect());
    let lattice =
        (1..6).flat_map(|z| (1..6).flat_map(move |y| (1..6).map(move |x| IVec3::new(x, y, z) * 10)));
    let lattice = keyed(lattice.collect());
    let layers = keyed((0..120).map(|at| IVec3::new(within(64), within(64), 20 + at % 2)).collect());
    let line = keyed((1..60).map(|at| IVec3::new(at, 31, 31)).collect());
    let far = IVec3::new(1 << 20, -(1 << 20), 12_345);
    let moved = random.iter().map(|&(at, key): &(IVec3, u64)| (at + far, key)).collect();
    let in_large = random.clone();
    vec![
        (BOX, random),
        (BOX, lattice),
        (BOX, layers),
        (BOX, line),
        ([far, far + 64], moved),
        ([IVec3::splat(-COORDINATE_MAX / 2), IVec3::splat(COORDINATE_MAX / 2)], in_large),
    ]
}

fn places([low, high]: [IVec3; 2], points: &[(IVec3, u64)]) -> Vec<IVec3> {
    let corner = |at: i32| low + (high - low) * IVec3::new(at & 1, at >> 1 & 1, at >> 2);
    points.iter().map(|of| of.0).chain((0..8).map(corner)).collect()
}

#[test]
fn spheres_are_empty_volumes_fill_the_box_and_faces_are_shared() {
    for (of_box, points) in sets() {
        let found = tetrahedra(of_box, &points).unwrap();
        let at = places(of_box, &points);
        let mut sum = 0;
        let mut faces: BTreeMap<[u32; 3], u32> = BTreeMap::new();
        for of in &found {
            let mut places = of.map(|vertex| at[vertex as usize]);
            if volume(places) < 0 {
                places.swap(0, 1);
            }
            assert!(volume(places) > 0, "{of:?} is flat");
            sum += volume(places);
            for (index, &point) in at.iter().enumerate() {
                assert!(power(places, point).1 >= 0, "{index} is within the sphere of {of:?}");
            }
            for side in 0..4 {
                let face: Vec<u32> = (0..4).filter(|other| *other != side).map(|other| of[other]).collect();
                *faces.entry(face.try_into().unwrap()).or_default() += 1;
            }
        }
        let extent = of_box[1] - of_box[0];
        assert_eq!(sum, 6 * extent.to_array().into_iter().map(i128::from).product::<i128>());
        for (face, count) in faces {
            let places = face.map(|vertex| at[vertex as usize]);
            let is_outer = (0..3).any(|axis| {
                [of_box[0][axis], of_box[1][axis]]
                    .iter()
                    .any(|side| places.iter().all(|at| at[axis] == *side))
            });
            assert_eq!(count, if is_outer { 1 } else { 2 }, "{face:?}");
        }
        let used: std::collections::BTreeSet<u32> = found.iter().flatten().copied().collect();
        assert_eq!(used.len(), at.len(), "some point is in no tetrahedron");
    }
}

#[test]
fn any_order_of_points_gives_the_same_and_keys_decide_ties() {
    for (of_box, points) in sets() {
        let keys = |points: &[(IVec3, u64)], found: Vec<[u32; 4]>| {
            let key = |vertex: u32| {
                points.get(vertex as usize).map_or_else(|| u64::from(vertex) - points.len() as u64, |of| of.1)
            };
            let mut all: Vec<[u64; 4]> = found.into_iter().map(|of| of.map(key)).collect();
            all.iter_mut().for_each(|of| of.sort_unstable());
            all.sort_unstable();
            all
        };
        let first = keys(&points, tetrahedra(of_box, &points).unwrap());
        let mut other = points.clone();
        other.reverse();
        other.rotate_left(points.len() / 3);
        assert_eq!(keys(&other, tetrahedra(of_box, &other).unwrap()), first);
    }
    let (of_box, lattice) = sets().swap_remove(1);
    let other: Vec<(IVec3, u64)> = lattice.iter().map(|&(at, key)| (at, key.rotate_left(17))).collect();
    assert_ne!(tetrahedra(of_box, &lattice).unwrap(), tetrahedra(of_box, &other).unwrap());
}

#[test]
fn far_points_change_nothing_near() {
    let (of_box, lattice) = sets().swap_remove(1);
    let mut more = lattice.clone();
    more.push((IVec3::splat(57), 5));
    let near = |found: Vec<[u32; 4]>, points: &[(IVec3, u64)]| {
        let is_near = |vertex: &u32| points.get(*vertex as usize).is_some_and(|of| of.0.max_element() <= 30);
        found.into_iter().filter(|of| of.iter().all(is_near)).collect::<Vec<_>>()
    };
    let before = near(tetrahedra(of_box, &lattice).unwrap(), &lattice);
    assert!(before.len() > 20);
    assert_eq!(near(tetrahedra(of_box, &more).unwrap(), &more), before);
}

#[test]
fn points_without_tetrahedra_are_refused() {
    let of = |points: &[IVec3]| {
        let points: Vec<(IVec3, u64)> = points.iter().copied().zip(1..).collect();
        tetrahedra(BOX, &points)
    };
    let [a, b] = [IVec3::splat(3), IVec3::splat(9)];
    assert_eq!(of(&[a, b, a]), Err(Degenerate::Doubled(0, 2)));
    assert_eq!(of(&[a, IVec3::new(0, 5, 5)]), Err(Degenerate::Outside(1)));
    assert_eq!(tetrahedra([a, a], &[]), Err(Degenerate::Box));
    assert_eq!(of(&[]).unwrap().len(), 6);
}

/// Prints seconds for as many points of a lattice as a large field has.
#[test]
#[ignore = "a measurement"]
fn hundred_thousand_points_of_a_lattice() {
    let side = 47;
    let points =
        (0..side * side * 46).map(|at| IVec3::new(at % side, at / side % side, at / (side * side)) + 1);
    let points: Vec<(IVec3, u64)> =
        points.map(|at| (at, seed_of(&[at.x as u64, at.y as u64, at.z as u64]))).collect();
    let start = std::time::Instant::now();
    let found = tetrahedra([IVec3::ZERO, IVec3::splat(side + 1)], &points).unwrap();
    println!("{} points, {} tetrahedra, {:.2} s", points.len(), found.len(), start.elapsed().as_secs_f64());
}
