//! Places to measure at: a stratified sample of the scene's lit area, and of that a smaller one that is denser where more
//! error is expected.

use std::collections::BTreeMap;

use super::evaluated::{Answer, Place};
use crate::geometry::{Geometry, Strata};
use crate::rays::Hit;
use crate::rays::sampling::Sequence;

/// A place and the area that it stands for in the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// The place.
    pub place: Place,
    /// Area in m², or the weight that a kind's own sample gives it; those of a sample of surfaces sum up to the scene's, less
    /// the area without an answer.
    pub area_m2: f64,
}

/// A point of a surface, and the place whose light the bake shows there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledHit {
    /// The point.
    pub hit: Hit,
    /// Index in [`Sample::places`]; `None` where the surface is too small for a place of its own.
    pub place: Option<usize>,
    /// Area that it stands for, in m².
    pub area_m2: f64,
}

/// Share of a focused sample that is drawn by area alone, wherever error is expected.
const BY_AREA: f64 = 0.25;
/// Seed of its draws.
const SEED: u64 = 0x666f_6375;

/// Place that a hit chose, before places have their order.
enum Chosen {
    Numbered(u32),
    Other(usize),
    None,
}

/// A sample of places: numbered ones first, ascending and each once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// The places.
    pub places: Vec<Sampled>,
    /// Points that chose them, in the order of strata; none of those in cavities.
    pub hits: Vec<SampledHit>,
    /// Area of all lit sides of the scene, in m².
    pub area_m2: f64,
    /// Share of it whose surface is too small or too deep in geometry for an answer.
    pub share_without: f64,
    /// Share of the area in cavities that nothing in the open sees, not in `share_without`.
    pub share_in_cavities: f64,
}

impl Sample {
    /// Cuts the lit area into `count` equal strata, takes a point in each, and of that point the place whose light `answer_at`
    /// it the bake shows.
    pub fn of_surfaces(geometry: &Geometry, answer_at: impl Fn(&Hit) -> Answer, count: u32) -> Self {
        let Strata { hits, area_m2 } = Strata::new(geometry, count);
        let stratum_m2 = area_m2 / f64::from(count);
        let mut numbered: BTreeMap<u32, Sampled> = BTreeMap::new();
        let (mut others, mut answered) = (Vec::new(), Vec::new());
        let (mut without_m2, mut in_cavities_m2) = (0.0, 0.0);
        for hit in hits {
            match answer_at(&hit) {
                Answer::Place(place) => match place.number {
                    Some(number) => {
                        numbered.entry(number).or_insert(Sampled { place, area_m2: 0.0 }).area_m2 +=
                            stratum_m2;
                        answered.push((hit, Chosen::Numbered(number)));
                    }
                    None => {
                        answered.push((hit, Chosen::Other(others.len())));
                        others.push(Sampled { place, area_m2: stratum_m2 });
                    }
                },
                Answer::Cavity => in_cavities_m2 += stratum_m2,
                Answer::TooSmall => {
                    answered.push((hit, Chosen::None));
                    without_m2 += stratum_m2;
                }
            }
        }
        let index_of: BTreeMap<u32, usize> = numbered.keys().copied().zip(0..).collect();
        let hits = answered.into_iter().map(|(hit, chosen)| {
            let place = match chosen {
                Chosen::Numbered(number) => index_of.get(&number).copied(),
                Chosen::Other(index) => Some(index_of.len() + index),
                Chosen::None => None,
            };
            SampledHit { hit, place, area_m2: stratum_m2 }
        });
        let share_of = |part_m2: f64| if area_m2 > 0.0 { part_m2 / area_m2 } else { 0.0 };
        Self {
            hits: hits.collect(),
            places: numbered.into_values().chain(others).collect(),
            area_m2,
            share_without: share_of(without_m2),
            share_in_cavities: share_of(in_cavities_m2),
        }
    }

    /// About `count` of the hits and their places, drawn in the order of strata with a density of which a quarter is even and
    /// the rest follows the error that is expected at each place; weighted back, so that means over either sample have the
    /// same expectation. By area alone where no error is expected anywhere.
    pub fn focused(self, expected: &[f64], count: u32) -> Self {
        let error = |hit: &SampledHit| hit.place.map_or(0.0, |place| expected[place]);
        let area_m2: f64 = self.hits.iter().map(|hit| hit.area_m2).sum();
        let mean = self.hits.iter().map(|hit| hit.area_m2 * error(hit)).sum::<f64>() / area_m2;
        let is_known = mean > 0.0 && mean.is_finite();
        let density =
            |hit: &SampledHit| if is_known { BY_AREA + (1.0 - BY_AREA) * error(hit) / mean } else { 1.0 };
        let step_m2 = area_m2 / f64::from(count);
        // One draw in each of `count` equal runs.
        let mut random = Sequence::new(SEED);
        let mut draws =
            (0..count).map(|run| (f64::from(run) + f64::from(random.next_f32())) * step_m2).peekable();
        let mut before_m2 = 0.0;
        let mut places: BTreeMap<usize, Sampled> = BTreeMap::new();
        let mut hits = Vec::new();
        for hit in &self.hits {
            before_m2 += hit.area_m2 * density(hit);
            let mut times = 0_u32;
            while draws.next_if(|drawn_m2| *drawn_m2 < before_m2).is_some() {
                times += 1;
            }
            if times == 0 {
                continue;
            }
            let area_m2 = f64::from(times) * step_m2 / density(hit);
            hits.push(SampledHit { area_m2, ..*hit });
            if let Some(place) = hit.place {
                let own = Sampled { area_m2: 0.0, ..self.places[place] };
                places.entry(place).or_insert(own).area_m2 += area_m2;
            }
        }
        let index_of: BTreeMap<usize, usize> = places.keys().copied().zip(0..).collect();
        hits.iter_mut().for_each(|hit| hit.place = hit.place.map(|place| index_of[&place]));
        Self { hits, places: places.into_values().collect(), ..self }
    }

    /// The places without their areas.
    pub fn bare(&self) -> Vec<Place> {
        self.places.iter().map(|sampled| sampled.place).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::Site;

    /// A sample of hits of 1 m², two to a place.
    fn sample(hits: usize) -> Sample {
        let site = Site { position_m: Vec3::ZERO, normal: Vec3::Y, face_normal: Vec3::Y };
        let hit = Hit { t: 0.0, triangle: 0, barycentric: [0.0; 2], front: true };
        let place = |number: usize| Place { site, number: Some(number as u32) };
        Sample {
            places: (0..hits / 2).map(|index| Sampled { place: place(index), area_m2: 2.0 }).collect(),
            hits: (0..hits).map(|index| SampledHit { hit, place: Some(index / 2), area_m2: 1.0 }).collect(),
            area_m2: hits as f64,
            ..Sample::default()
        }
    }

    #[test]
    fn focused_sample_has_the_same_mean_with_less_noise_where_errors_are_known_about() {
        // One place in fifty holds most of the squares, as light beside a lamp.
        let mut random = Sequence::new(3);
        let errors: Vec<f64> = (0..8000)
            .map(|i| f64::from(0.5 + random.next_f32()) * if i % 50 == 7 { 20.0 } else { 1.0 })
            .collect();
        let expected: Vec<f64> = (0..8000).map(|i| if i % 50 == 7 { 20.0 } else { 1.0 }).collect();
        let mean = |sample: &Sample| {
            let area: f64 = sample.places.iter().map(|sampled| sampled.area_m2).sum();
            let square = |s: &Sampled| s.area_m2 * errors[s.place.number.unwrap() as usize].powi(2);
            sample.places.iter().map(square).sum::<f64>() / area
        };
        let all = sample(16_000);
        let truth = mean(&all);
        let focused = all.clone().focused(&expected, 600);
        assert!((550..=600).contains(&focused.hits.len()), "{}", focused.hits.len());
        // By area alone, a standard error of a third.
        assert!((mean(&focused) / truth - 1.0).abs() < 0.15, "{} {truth}", mean(&focused));
        let area: f64 = focused.hits.iter().map(|hit| hit.area_m2).sum();
        assert!((area / all.area_m2 - 1.0).abs() < 0.08, "{area}");
        let bright = focused.places.iter().filter(|s| s.place.number.unwrap() % 50 == 7).count();
        assert!(bright > 100, "{bright} of 160 bright ones");
        // Where nothing is expected, as many are drawn by area alone.
        let even = all.clone().focused(&[0.0; 8000], 600);
        assert_eq!(even.hits.len(), 600);
        assert!(even.hits.iter().all(|hit| hit.area_m2 == all.area_m2 / 600.0));
    }
}
