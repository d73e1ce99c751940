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

/// A sample of places: numbered ones first, ascending and each once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// The places.
    pub places: Vec<Sampled>,
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
        let mut others = Vec::new();
        let (mut without_m2, mut in_cavities_m2) = (0.0, 0.0);
        for hit in hits {
            match answer_at(&hit) {
                Answer::Place(place) => match place.number {
                    Some(number) => {
                        numbered.entry(number).or_insert(Sampled { place, area_m2: 0.0 }).area_m2 +=
                            stratum_m2;
                    }
                    None => others.push(Sampled { place, area_m2: stratum_m2 }),
                },
                Answer::Cavity => in_cavities_m2 += stratum_m2,
                Answer::TooSmall => without_m2 += stratum_m2,
            }
        }
        let share_of = |part_m2: f64| if area_m2 > 0.0 { part_m2 / area_m2 } else { 0.0 };
        Self {
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
