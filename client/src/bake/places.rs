//! Places where the error of a bake was measured, and the nearest of them that faces the same way.

use std::ops::Range;

use glam::Vec3;

/// Cosine of the largest angle between the normals of a receiver and of the place whose error it shows.
const FACING_MIN: f32 = 0.5;
/// Most places of a part that is not divided.
const PART_MAX: usize = 8;
/// Most parts that one search looks into; then the nearest place so far counts. It bounds the work for files whose places face all ways
/// at one spot: those of surfaces take some dozens.
const LOOKS_MAX: usize = 4096;

/// A place and its error: that of the luminance of E_ind, over the mean of the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub position_m: Vec3,
    pub normal: Vec3,
    pub relative: f32,
}

/// Places in trees of boxes, one for each of the six ways that they mainly face. Each box is halved along its longest side, as walls are
/// flat along any one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Places {
    places: Vec<Place>,
    parts: Vec<Part>,
    roots: Vec<usize>,
}

/// A run of places.
#[derive(Clone, Debug, PartialEq)]
struct Part {
    /// Least and greatest coordinates.
    positions_m: [Vec3; 2],
    normals: [Vec3; 2],
    places: Range<usize>,
    /// Numbers of its halves, where it is divided.
    halves: Option<[usize; 2]>,
}

impl Places {
    /// Sorts places into trees.
    pub fn new(mut places: Vec<Place>) -> Self {
        places.sort_by_key(|place| way(place.normal));
        let same_way = |a: &Place, b: &Place| way(a.normal) == way(b.normal);
        let counts: Vec<usize> = places.chunk_by(same_way).map(<[Place]>::len).collect();
        let mut sorted = Self { places, parts: Vec::new(), roots: Vec::new() };
        let mut start = 0;
        for count in counts {
            let root = sorted.add(start..start + count);
            sorted.roots.push(root);
            start += count;
        }
        sorted
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &Place> {
        self.places.iter()
    }

    /// Error of the nearest place that faces the same way.
    pub fn nearest(&self, position_m: Vec3, normal: Vec3) -> Option<f32> {
        self.search(position_m, normal).found
    }

    fn search(&self, position_m: Vec3, normal: Vec3) -> Search {
        let mut search = Search { position_m, normal, least: f32::INFINITY, found: None, looks: 0 };
        for &root in &self.roots {
            search.look(self, root);
        }
        search
    }

    /// Adds the part of a run of places, and its halves; gives its number.
    fn add(&mut self, run: Range<usize>) -> usize {
        let places = &mut self.places[run.clone()];
        let positions_m = bounds(places.iter().map(|place| place.position_m));
        let normals = bounds(places.iter().map(|place| place.normal));
        let half = places.len() / 2;
        let is_divided = places.len() > PART_MAX;
        if is_divided {
            let axis = (positions_m[1] - positions_m[0]).max_position();
            places.select_nth_unstable_by(half, |a, b| a.position_m[axis].total_cmp(&b.position_m[axis]));
        }
        let number = self.parts.len();
        self.parts.push(Part { positions_m, normals, places: run.clone(), halves: None });
        if is_divided {
            let middle = run.start + half;
            let first = self.add(run.start..middle);
            let second = self.add(middle..run.end);
            self.parts[number].halves = Some([first, second]);
        }
        number
    }
}

impl Part {
    /// Squared distance of a point to the box of the places.
    fn square(&self, point_m: Vec3) -> f32 {
        let [low, high] = self.positions_m;
        point_m.max(low).min(high).distance_squared(point_m)
    }

    /// No place's normal has a greater product with this one.
    fn facing(&self, normal: Vec3) -> f32 {
        let [low, high] = self.normals;
        (low * normal).max(high * normal).element_sum()
    }
}

/// A search for the nearest place.
struct Search {
    position_m: Vec3,
    normal: Vec3,
    /// Squared distance of the nearest so far, and its error.
    least: f32,
    found: Option<f32>,
    /// Parts that were looked into.
    looks: usize,
}

impl Search {
    /// Looks into a part, unless all of it is farther than what was found, or faces another way.
    fn look(&mut self, all: &Places, number: usize) {
        let part = &all.parts[number];
        let is_out = part.square(self.position_m) >= self.least || part.facing(self.normal) < FACING_MIN;
        if is_out || self.looks == LOOKS_MAX {
            return;
        }
        self.looks += 1;
        let Some([first, second]) = part.halves else {
            all.places[part.places.clone()].iter().for_each(|place| self.take(place));
            return;
        };
        let [to_first, to_second] = [first, second].map(|half| all.parts[half].square(self.position_m));
        let [near, far] = if to_second < to_first { [second, first] } else { [first, second] };
        self.look(all, near);
        self.look(all, far);
    }

    /// Takes a place that is nearer and faces the same way.
    fn take(&mut self, place: &Place) {
        let square = place.position_m.distance_squared(self.position_m);
        if square < self.least && place.normal.dot(self.normal) >= FACING_MIN {
            (self.least, self.found) = (square, Some(place.relative));
        }
    }
}

/// The way that a normal mainly faces: one of six.
fn way(normal: Vec3) -> usize {
    let axis = normal.abs().max_position();
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// Least and greatest coordinates.
fn bounds(vectors: impl Iterator<Item = Vec3>) -> [Vec3; 2] {
    let none = [Vec3::INFINITY, Vec3::NEG_INFINITY];
    vectors.fold(none, |[low, high], vector| [low.min(vector), high.max(vector)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same numbers in 0..1 for the same seeds.
    fn point(seed: u32) -> Vec3 {
        let number = |seed: u32| (seed.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32;
        Vec3::new(number(seed), number(seed + 1), number(seed + 2))
    }

    #[test]
    fn nearest_place_is_that_of_a_search_through_all() {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let normal = |index: u32| match index % 4 {
            3 => (2.0 * point(900_000 + 3 * index) - 1.0).normalize(),
            axis => axes[axis as usize],
        };
        let of = |index: u32| Place {
            position_m: point(7 * index),
            normal: normal(index),
            relative: index as f32,
        };
        let all: Vec<Place> = (0..500).map(of).collect();
        let places = Places::new(all.clone());
        assert_eq!(places.iter().count(), all.len());
        for index in 0..400 {
            let (position, normal) = (point(100_000 + 5 * index), normal(index));
            let facing = all.iter().filter(|place| place.normal.dot(normal) >= FACING_MIN);
            let squares = facing.map(|place| (place.position_m.distance_squared(position), place.relative));
            let (least, _) = squares.clone().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            let nearest: Vec<f32> =
                squares.filter(|(square, _)| *square == least).map(|(_, of)| of).collect();
            let found = places.nearest(position, normal).unwrap();
            assert!(nearest.contains(&found), "{index}: {found}, wanted {nearest:?}");
        }
    }

    #[test]
    fn places_of_a_wall_across_any_axis_are_found_in_few_looks() {
        const SIDE: u32 = 128;
        for axis in 0..3_usize {
            let on_wall = |along: [f32; 2]| {
                let mut at = [0.0; 3];
                at[(axis + 1) % 3] = along[0];
                at[(axis + 2) % 3] = along[1];
                Vec3::from(at)
            };
            let normal = Vec3::AXES[axis];
            let of = |index: u32| Place {
                position_m: on_wall([(index % SIDE) as f32, (index / SIDE) as f32]),
                normal,
                relative: index as f32,
            };
            let places = Places::new((0..SIDE * SIDE).map(of).collect());
            for index in (0..SIDE * SIDE).step_by(37) {
                let beside = of(index).position_m + 0.3 * Vec3::ONE;
                let search = places.search(beside, normal);
                assert_eq!(search.found, Some(index as f32));
                assert!(search.looks < 100, "{} looks for {index}", search.looks);
            }
            let away = places.search(Vec3::ZERO, -normal);
            assert_eq!((away.found, away.looks), (None, 0));
        }
    }

    #[test]
    fn searches_among_places_that_face_all_ways_at_one_spot_end() {
        // None faces as the receiver does, but between every two neighbours' normals there is room for one that would.
        let of = |index: u32| {
            let [y, z] = if index.is_multiple_of(2) { [0.6, -0.28] } else { [-0.28, 0.6] };
            Place { position_m: Vec3::ZERO, normal: Vec3::new(0.75, y, z), relative: 0.0 }
        };
        let places = Places::new((0..200_000).map(of).collect());
        let search = places.search(Vec3::ONE, Vec3::new(0.0, 1.0, 1.0).normalize());
        assert_eq!((search.found, search.looks), (None, LOOKS_MAX));
    }
}
