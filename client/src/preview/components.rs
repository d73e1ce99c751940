//! Components: probes that see each other, by way of others or at once. A sealed room has its own, and no light of others.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use crate::bake::FreeSpace;

/// Farthest neighbour over the distance between probes: beyond a cell's diagonal.
const REACH: f32 = 1.8;
/// Share of the way to a neighbour at whose end no surface parts them: depth maps round edges off.
const END: f32 = 0.05;

/// The component of each probe, numbered by falling count of probes, those of as many by their first one.
pub fn components(space: &dyn FreeSpace) -> Vec<u32> {
    let places_m: Vec<Vec3> = space.positions_m().iter().map(|place| place.truncate()).collect();
    let reach_m = REACH * space.spacing_m();
    let cell_of = |place_m: Vec3| (place_m / reach_m).floor().as_ivec3();
    let mut cells: HashMap<IVec3, Vec<u32>> = HashMap::new();
    for (place_m, probe) in places_m.iter().zip(0..) {
        cells.entry(cell_of(*place_m)).or_default().push(probe);
    }
    let mut firsts: Vec<u32> = (0..places_m.len() as u32).collect();
    for (&place_m, probe) in places_m.iter().zip(0..) {
        let ways = (0..27).map(|way| IVec3::new(way % 3, way / 3 % 3, way / 9) - 1);
        let around = ways.filter_map(|way| cells.get(&(cell_of(place_m) + way))).flatten();
        for &other in around.filter(|other| **other < probe) {
            let ends_m = [place_m, places_m[other as usize]];
            if ends_m[0].distance(ends_m[1]) < reach_m && see_each_other(space, [probe, other], ends_m) {
                let [a, b] = [probe, other].map(|probe| first_of(&mut firsts, probe));
                firsts[a.max(b) as usize] = a.min(b);
            }
        }
    }
    let firsts: Vec<u32> = (0..firsts.len() as u32).map(|probe| first_of(&mut firsts, probe)).collect();
    let mut counts: HashMap<u32, usize> = HashMap::new();
    for first in &firsts {
        *counts.entry(*first).or_default() += 1;
    }
    let mut order: Vec<(usize, u32)> = counts.into_iter().map(|(first, count)| (count, first)).collect();
    order.sort_by_key(|(count, first)| (std::cmp::Reverse(*count), *first));
    let number: HashMap<u32, u32> = order.into_iter().map(|(_, first)| first).zip(0..).collect();
    firsts.iter().map(|first| number[first]).collect()
}

/// The first probe of a component, as far as it is known.
fn first_of(firsts: &mut [u32], probe: u32) -> u32 {
    let mut at = probe;
    while firsts[at as usize] != at {
        // Ways get shorter.
        firsts[at as usize] = firsts[firsts[at as usize] as usize];
        at = firsts[at as usize];
    }
    at
}

/// No surface stands between two probes, as both of them see it.
pub fn see_each_other(space: &dyn FreeSpace, probes: [u32; 2], [from_m, to_m]: [Vec3; 2]) -> bool {
    let Some(way) = (to_m - from_m).try_normalize() else { return true };
    let reach_m = (1.0 - END) * from_m.distance(to_m);
    space.distance_m(probes[0], way) >= reach_m && space.distance_m(probes[1], -way) >= reach_m
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::bake::{Lattice, Tetrahedra};
    use crate::fixture;

    /// Probes along x, 1 m apart, and a wall at a place that all of them see.
    #[derive(Debug)]
    struct Walled {
        places_m: Vec<Vec4>,
        wall_m: f32,
    }

    impl FreeSpace for Walled {
        fn spacing_m(&self) -> f32 {
            1.0
        }

        fn lattice(&self) -> Option<Lattice<'_>> {
            None
        }

        fn tetrahedra(&self) -> Option<Tetrahedra<'_>> {
            None
        }

        fn positions_m(&self) -> &[Vec4] {
            &self.places_m
        }

        fn distance_m(&self, probe: u32, direction: Vec3) -> f32 {
            let away = (self.wall_m - self.places_m[probe as usize].x) / direction.x;
            if away > 0.0 { away } else { f32::INFINITY }
        }
    }

    #[test]
    fn a_wall_parts_probes_and_the_larger_part_comes_first() {
        let places_m = (0..7).map(|at| Vec4::new(at as f32, 0.0, 0.0, 0.0)).collect();
        let space = Walled { places_m, wall_m: 2.4 };
        assert_eq!(components(&space), [1, 1, 1, 0, 0, 0, 0]);
        assert_eq!(components(&Walled { wall_m: 90.0, ..space }), [0; 7]);
        for bake in [true, false].map(fixture::field_bake) {
            let found = components(bake.light.free_space().unwrap());
            assert!(found.iter().all(|component| *component == 0), "the box is one room: {found:?}");
        }
    }
}
