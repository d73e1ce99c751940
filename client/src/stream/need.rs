//! Order in which layers of clusters are fetched.

use glam::Vec3;
use lightkiln_proto::manifest::Layer;

use super::Viewpoint;

/// Needs of clusters behind the eye count by this: their light reaches the picture by bounces alone.
const BEHIND: f32 = 0.125;

/// Share of the squared error of an overview that is left when a cluster has its receivers down to a level, finest first: those of
/// finer levels have the light of the nearest that came. Receivers of every fourth texel alone are worse than those of the overview,
/// which are chosen: all of it is left (`tests/studies/first-light.md`).
const LEFT_BY_LEVEL: [f32; 4] = [0.0, 0.25, 1.0, 1.0];
/// Share that is left without the highest ranks: the mean of Sponza's lights without those above 16.
const LEFT_BY_RANK: f32 = 0.12;
/// Needs of layers that are there count by this where memory is short, so that views that hardly differ do not take turns.
const THERE: f32 = 1.25;

/// A cluster, by its layers.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Bounds of its receivers, in metres.
    pub bounds_m: [Vec3; 2],
    /// Its receivers.
    pub receivers: u32,
    /// The state after each of its layers, coarsest first.
    pub rungs: Vec<Rung>,
    /// Layers that are there.
    pub held: usize,
    /// Layers of them that stay, as they came for this very view: its light is measured anew when they come, and would let them go
    /// for others whose light is not, for ever.
    pub kept: usize,
}

/// A cluster with some of its layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rung {
    /// Bytes of its chunk so far.
    pub bytes: u64,
    /// Memory that it takes when it is lit, in bytes.
    pub memory: u64,
    /// Share of the squared error that is left; 0 with all layers.
    pub left: f32,
}

impl Rung {
    /// The state after a layer of a chunk whose last one has rank `rank`.
    pub fn left_after(layer: &Layer, rank: u32) -> f32 {
        let of_level = LEFT_BY_LEVEL[(layer.level as usize).min(LEFT_BY_LEVEL.len() - 1)];
        of_level + if layer.rank < rank { LEFT_BY_RANK } else { 0.0 }
    }
}

impl Candidate {
    /// Bytes of its first so many layers.
    pub fn bytes_of(&self, layers: usize) -> u64 {
        self.rung(layers).bytes
    }

    /// The state with so many layers.
    pub fn rung(&self, layers: usize) -> Rung {
        let nothing = Rung { bytes: 0, memory: 0, left: 1.0 };
        layers.checked_sub(1).and_then(|last| self.rungs.get(last).copied()).unwrap_or(nothing)
    }

    /// Numbers of layers that are worth having, each with the fall of the error from the one before for a byte: the concave
    /// hull of error over bytes.
    fn hull(&self) -> Vec<(usize, f32)> {
        let mut hull = Vec::new();
        let mut from = 0;
        while from < self.rungs.len() {
            let here = self.rung(from);
            let fall = |layers: &usize| {
                let there = self.rung(*layers);
                (here.left - there.left) / there.bytes.saturating_sub(here.bytes).max(1) as f32
            };
            // Of equal falls the farthest: a layer that brings nothing is no step.
            let best =
                (from + 1..=self.rungs.len()).max_by(|a, b| fall(a).total_cmp(&fall(b)).then(a.cmp(b)));
            let Some(best) = best else { break };
            hull.push((best, fall(&best)));
            from = best;
        }
        hull
    }
}

/// Layers of a cluster to have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Index of the candidate.
    pub candidate: usize,
    /// Layers to have in all.
    pub layers: usize,
    /// Fall of the error for a byte, weighed by the view.
    need: f32,
}

/// A place whose light is known so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lit {
    /// Place in metres.
    pub position_m: Vec3,
    /// Indirect irradiance there, W·m⁻².
    pub irradiance: Vec3,
}

/// Layers of candidates by falling need: the square of the light that is known in a cluster, as its error goes with the light, times
/// the share of it that the layers take away, over their bytes; less far from the eye and behind it. Without a viewpoint all places
/// count alike. Coarser layers of a cluster come before its finer ones.
///
/// In Sponza this order comes near to that by the true squares of the error (`tests/studies/first-light.md`).
pub fn by_need(
    candidates: &[Candidate],
    lit: &[Lit],
    viewpoint: Option<Viewpoint>,
    size_m: f32,
) -> Vec<Step> {
    let mut along: Vec<Lit> = lit.to_vec();
    along.sort_by(|a, b| a.position_m.x.total_cmp(&b.position_m.x));
    let mut steps = Vec::new();
    for (index, candidate) in candidates.iter().enumerate() {
        let square = square_in(&along, candidate.bounds_m);
        let weight = viewpoint.map_or(1.0, |viewpoint| seen(candidate.bounds_m, viewpoint, size_m));
        for (layers, fall) in candidate.hull() {
            let there = if layers <= candidate.held { THERE } else { 1.0 };
            let need = there * weight * square * candidate.receivers as f32 * fall;
            steps.push(Step { candidate: index, layers, need });
        }
    }
    steps.sort_by(|a, b| {
        let by_place = (a.candidate, a.layers).cmp(&(b.candidate, b.layers));
        b.need.total_cmp(&a.need).then(by_place)
    });
    steps
}

/// Mean square of the light in a box; where none of it is known, in one three times as wide. `along` ascends by x.
fn square_in(along: &[Lit], [low, high]: [Vec3; 2]) -> f32 {
    let size = high - low;
    for margin in [Vec3::splat(0.125 * size.max_element()), Vec3::splat(size.max_element())] {
        let [low, high] = [low - margin, high + margin];
        let first = along.partition_point(|lit| lit.position_m.x < low.x);
        let inside = along[first..]
            .iter()
            .take_while(|lit| lit.position_m.x <= high.x)
            .filter(|lit| lit.position_m.cmpge(low).all() && lit.position_m.cmple(high).all());
        let (sum, count) =
            inside.fold((0.0, 0_u32), |(sum, count), lit| (sum + lit.irradiance.length_squared(), count + 1));
        if count > 0 {
            return sum / count as f32;
        }
    }
    0.0
}

/// Share of a box in the view, about: 1 beside the eye, a half at an eighth of the scene's size, less behind.
fn seen([low, high]: [Vec3; 2], Viewpoint { eye_m, forward }: Viewpoint, size_m: f32) -> f32 {
    let distance_m = eye_m.distance(eye_m.clamp(low, high));
    let far = 8.0 * distance_m / size_m.max(f32::MIN_POSITIVE);
    let farthest = Vec3::select(forward.cmpge(Vec3::ZERO), high, low);
    let is_behind = (farthest - eye_m).dot(forward) < 0.0;
    (if is_behind { BEHIND } else { 1.0 }) / (1.0 + far * far)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(x: f32, bytes: u64) -> Candidate {
        let bounds_m = [Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 1.0, 1.0)];
        let rungs = vec![Rung { bytes, memory: 0, left: 0.0 }];
        Candidate { bounds_m, receivers: 10, rungs, held: 0, kept: 0 }
    }

    /// Candidates of the steps.
    fn order(candidates: &[Candidate], places: &[Lit], viewpoint: Option<Viewpoint>) -> Vec<usize> {
        by_need(candidates, places, viewpoint, 40.0).iter().map(|step| step.candidate).collect()
    }

    fn lit(x: f32, light: f32) -> Lit {
        Lit { position_m: Vec3::new(x, 0.5, 0.5), irradiance: Vec3::splat(light) }
    }

    #[test]
    fn bright_places_come_first_and_of_alike_the_small() {
        let candidates =
            [candidate(0.0, 100), candidate(10.0, 100), candidate(20.0, 100), candidate(30.0, 50)];
        let places = [lit(30.5, 1.0), lit(0.5, 1.0), lit(20.5, 5.0)];
        assert_eq!(order(&candidates, &places, None), [2, 3, 0, 1]);
        // A box without a known place takes those around it.
        let beside = [lit(11.9, 9.0), lit(0.5, 1.0)];
        assert_eq!(order(&candidates, &beside, None)[0], 1);
    }

    #[test]
    fn near_places_before_the_eye_come_before_far_ones_and_those_behind() {
        let candidates = [candidate(-10.0, 100), candidate(2.0, 100), candidate(20.0, 100)];
        let places = [lit(-9.5, 1.0), lit(2.5, 1.0), lit(20.5, 1.0)];
        let viewpoint = Viewpoint { eye_m: Vec3::ZERO, forward: Vec3::X };
        assert_eq!(order(&candidates, &places, Some(viewpoint)), [1, 2, 0]);
    }

    #[test]
    fn layers_that_bring_less_than_a_finer_one_for_a_byte_are_no_steps() {
        let rung = |bytes, left| Rung { bytes, memory: 0, left };
        let rungs = vec![rung(40, 0.9), rung(50, 0.2), rung(90, 0.0)];
        let candidates = [Candidate { rungs, ..candidate(0.0, 1) }, candidate(10.0, 100)];
        let places = [lit(0.5, 1.0), lit(10.5, 1.0)];
        let steps = by_need(&candidates, &places, None, 40.0);
        let found: Vec<(usize, usize)> = steps.iter().map(|step| (step.candidate, step.layers)).collect();
        assert_eq!(found, [(0, 2), (1, 1), (0, 3)]);
        assert_eq!([0, 1, 3].map(|layers| candidates[0].bytes_of(layers)), [0, 40, 90]);
    }
}
