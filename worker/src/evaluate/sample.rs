//! Places to measure at: a stratified sample of the scene's lit area.

use std::collections::BTreeMap;

use super::evaluated::{Answer, Evaluated, PlaceId};
use crate::geometry::Strata;

/// A place and the area that it stands for in the sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampled {
    /// The place.
    pub place: PlaceId,
    /// Area in m²; those of a sample sum up to the scene's, less the area without an answer.
    pub area_m2: f64,
}

/// A sample of places, ascending.
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
    /// Cuts the lit area into `count` equal strata, takes a point in each, and of that point the place whose light the bake
    /// shows there.
    pub fn new(bake: &dyn Evaluated, count: u32) -> Self {
        let Strata { hits, area_m2 } = Strata::new(bake.geometry(), count);
        let stratum_m2 = area_m2 / f64::from(count);
        let mut area_of: BTreeMap<PlaceId, f64> = BTreeMap::new();
        let (mut without_m2, mut in_cavities_m2) = (0.0, 0.0);
        for hit in hits {
            match bake.answer_at(&hit) {
                Answer::Place(place) => *area_of.entry(place).or_default() += stratum_m2,
                Answer::Cavity => in_cavities_m2 += stratum_m2,
                Answer::TooSmall => without_m2 += stratum_m2,
            }
        }
        let places = area_of.into_iter().map(|(place, area_m2)| Sampled { place, area_m2 }).collect();
        let share_of = |part_m2: f64| if area_m2 > 0.0 { part_m2 / area_m2 } else { 0.0 };
        let (share_without, share_in_cavities) = (share_of(without_m2), share_of(in_cavities_m2));
        Self { places, area_m2, share_without, share_in_cavities }
    }

    /// The places alone.
    pub fn ids(&self) -> Vec<PlaceId> {
        self.places.iter().map(|sampled| sampled.place).collect()
    }
}
