//! Places to measure at: a stratified sample of the scene's lit area.

use std::collections::BTreeMap;

use super::evaluated::{Answer, Place};
use crate::geometry::{Geometry, Strata};
use crate::rays::Hit;

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
}

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
    /// Points of equal areas that chose them, in the order of strata; none of those in cavities.
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
            SampledHit { hit, place }
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

    /// The places without their areas.
    pub fn bare(&self) -> Vec<Place> {
        self.places.iter().map(|sampled| sampled.place).collect()
    }
}
