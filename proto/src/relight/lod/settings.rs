//! Settings of the level of detail.

use serde::Serialize;
use thiserror::Error;

/// Levels, the finest first, as in Sedlacek 2019, §5.2.2.
pub const LOD_LEVELS: usize = 4;
/// Most bounces from one update of a cluster to the next.
pub const MAX_INTERVAL: u32 = 16;
/// Highest level of columns: that of the coarsest patches.
const COLUMNS_MAX: u32 = 15;
/// Stands for a distance that nothing has; shaders know no infinite numbers.
const NOWHERE_M: f32 = 1e30;

/// A distance from the eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LodDistance {
    /// In longest ways through the scene's bounds.
    Diagonals(f32),
    /// In metres.
    Metres(f32),
}

impl LodDistance {
    /// No cluster is as far.
    pub const NOWHERE: Self = Self::Metres(f32::INFINITY);

    /// In metres, of a scene of that diagonal.
    pub fn metres(self, diagonal_m: f32) -> f32 {
        let metres = match self {
            Self::Diagonals(diagonals) => diagonals * diagonal_m,
            Self::Metres(metres) => metres,
        };
        metres.min(NOWHERE_M)
    }

    fn number(self) -> f32 {
        let (Self::Diagonals(number) | Self::Metres(number)) = self;
        number
    }
}

/// The light of clusters from a distance on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LodLevel {
    /// Where it begins. Farther → more clusters of the level before, more time.
    pub distance: LodDistance,
    /// Differences of patches below this tree level are left out: the mean of the patch around them stands for them, so that energy
    /// stays. 0 → all columns; higher → less time, blurred light.
    pub columns: u32,
    /// Most ranks, rounded up to a whole eight. Lower → less time, smoother light within a cluster.
    pub rank: u32,
    /// Receivers are computed whose texel coordinates have so many trailing zero bits both: all, a quarter, a sixteenth, a
    /// sixty-fourth. Higher → less time, blurred light.
    pub receivers: u32,
    /// Bounces from one update to the next, a power of two. Higher → less time, light that comes later.
    pub interval: u32,
}

impl LodLevel {
    /// Everything, from a distance on.
    pub const fn full(distance: LodDistance) -> Self {
        Self { distance, columns: 0, rank: super::super::MAX_RANK, receivers: 0, interval: 1 }
    }
}

/// Levels of detail by distance and view.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lod {
    /// The levels, the finest first; the first holds from the eye on, whatever its distance.
    pub levels: [LodLevel; LOD_LEVELS],
    /// Factor on distances at a right angle to the view. Larger → less detail outside of the picture.
    pub beside: f32,
    /// Factor on distances straight behind the eye, no less than `beside`.
    pub behind: f32,
    /// Width of the zone in which receivers go over to the next level's, as a share of its distance; columns, rank and interval
    /// change with the cluster. Wider → softer, and coarser light before the distance.
    pub blend: f32,
    /// A cluster goes to a coarser level only past the distance by this share of it, so that an eye that trembles changes nothing.
    pub margin: f32,
}

/// Settings that make no levels of detail.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct LodError(pub String);

impl Lod {
    /// Presets by name, from the most to the least detail.
    pub const PRESETS: [(&'static str, Self); 3] =
        [("fine", Self::FINE), ("balanced", Self::BALANCED), ("coarse", Self::COARSE)];

    const FINE: Self = Self::of(0, [0.1, 0.25, 0.5], [[3, 0, 1], [4, 0, 2], [4, 1, 2]]);
    const BALANCED: Self = Self::of(2, [0.1, 0.25, 0.5], [[4, 0, 2], [4, 1, 4], [5, 2, 4]]);
    const COARSE: Self = Self::of(3, [0.05, 0.15, 0.3], [[4, 0, 2], [5, 1, 4], [5, 2, 8]]);

    /// Columns of the first level; levels behind it from distances in diagonals on, each with columns, receivers and interval. All have
    /// all ranks: fewer leave dark spots in corners, at more error than any other setting for the time that they save.
    const fn of(columns: u32, distances: [f32; 3], levels: [[u32; 3]; 3]) -> Self {
        let mut all = [LodLevel::full(LodDistance::Diagonals(0.0)); LOD_LEVELS];
        all[0].columns = columns;
        let mut index = 0;
        while index < 3 {
            let [columns, receivers, interval] = levels[index];
            let full = LodLevel::full(LodDistance::Diagonals(distances[index]));
            all[index + 1] = LodLevel { columns, receivers, interval, ..full };
            index += 1;
        }
        Self { levels: all, beside: 2.0, behind: 4.0, blend: 0.3, margin: 0.1 }
    }

    /// The preset of a name.
    pub fn preset(name: &str) -> Option<Self> {
        Self::PRESETS.iter().find(|(known, _)| *known == name).map(|(_, lod)| *lod)
    }

    /// Refuses settings out of range, or that contradict each other.
    pub fn check(&self) -> Result<(), LodError> {
        let wrong = |problem: String| Err(LodError(problem));
        for (index, level) in self.levels.iter().enumerate() {
            let name = format!("level {index} of detail");
            let number = level.distance.number();
            if number.is_nan() || number < 0.0 {
                return wrong(format!("{name} begins at {number}: give a distance of 0 or more"));
            }
            if level.columns > COLUMNS_MAX || !(1..=super::super::MAX_RANK).contains(&level.rank) {
                return wrong(format!(
                    "{name} has columns from level {} on and rank {}: give at most {COLUMNS_MAX}, and 1 to {}",
                    level.columns,
                    level.rank,
                    super::super::MAX_RANK
                ));
            }
            if level.receivers as usize >= LOD_LEVELS {
                return wrong(format!("{name} has receivers of level {}: give 0 to 3", level.receivers));
            }
            if !level.interval.is_power_of_two() || level.interval > MAX_INTERVAL {
                return wrong(format!("{name} has interval {}: give 1, 2, 4, 8 or 16", level.interval));
            }
        }
        for (index, pair) in self.levels.windows(2).enumerate() {
            if pair[0].receivers > pair[1].receivers {
                return wrong(format!(
                    "level {} of detail has more receivers than the one before: farther ones have as many or fewer",
                    index + 1
                ));
            }
        }
        if !(1.0..=1e6).contains(&self.beside) || !(self.beside..=1e6).contains(&self.behind) {
            return wrong(format!(
                "beside={} behind={}: give factors of 1 or more, the second no less than the first",
                self.beside, self.behind
            ));
        }
        if ![self.blend, self.margin].iter().all(|share| (0.0..=1.0).contains(share)) {
            return wrong(format!("blend={} margin={}: give shares from 0 to 1", self.blend, self.margin));
        }
        Ok(())
    }

    /// Notes on levels that would begin before the one before them in a scene of that diagonal, and so begin where that does.
    pub fn notes(&self, diagonal_m: f32) -> Vec<String> {
        let begins_m = self.distances_m(diagonal_m);
        let place = |distance_m: f32| match distance_m < NOWHERE_M {
            true => format!("at {distance_m:.1} m"),
            false => "nowhere".to_owned(),
        };
        let note = |level: usize| {
            let wanted_m = self.levels[level].distance.metres(diagonal_m);
            (wanted_m < begins_m[level]).then(|| {
                format!(
                    "level {level} of detail begins {} instead of {}, as one before it does in this scene, whose diagonal \
                     is {diagonal_m:.1} m; no place has level {}: give distances that grow",
                    place(begins_m[level]),
                    place(wanted_m),
                    level - 1
                )
            })
        };
        (1..LOD_LEVELS).filter_map(note).collect()
    }

    /// Where each level begins, in metres: none before the one before it.
    pub(super) fn distances_m(&self, diagonal_m: f32) -> [f32; LOD_LEVELS] {
        let mut least_m = 0.0_f32;
        let mut index = 0;
        self.levels.map(|level| {
            if index > 0 {
                least_m = least_m.max(level.distance.metres(diagonal_m));
            }
            index += 1;
            least_m
        })
    }

    /// Factor on the distance of a place at a cosine from the view, whose corners are at `view_cos`.
    pub(super) fn zone(&self, cos: f32, view_cos: f32) -> f32 {
        if cos >= view_cos {
            1.0
        } else if cos >= 0.0 {
            self.beside + (1.0 - self.beside) * (cos / view_cos)
        } else {
            self.beside + (self.behind - self.beside) * -cos
        }
    }
}
