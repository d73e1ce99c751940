//! Order in which clusters are fetched.

use glam::Vec3;

use super::Viewpoint;

/// Needs of clusters behind the eye count by this: their light reaches the picture by bounces alone.
const BEHIND: f32 = 0.125;

/// A cluster that has not come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Bounds of its receivers, in metres.
    pub bounds_m: [Vec3; 2],
    /// Its receivers.
    pub receivers: u32,
    /// Bytes of its chunk.
    pub bytes: u64,
}

/// A place whose light is known so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lit {
    /// Place in metres.
    pub position_m: Vec3,
    /// Indirect irradiance there, W·m⁻².
    pub irradiance: Vec3,
}

/// Candidates by falling need: the square of the light that the overview has in a cluster, as its error goes with the light,
/// over the cluster's bytes; less far from the eye and behind it. Without a viewpoint all places count alike.
///
/// In Sponza this order comes near to that by the true squares of the error (`tests/studies/first-light.md`).
pub fn by_need(
    candidates: &[Candidate],
    lit: &[Lit],
    viewpoint: Option<Viewpoint>,
    size_m: f32,
) -> Vec<usize> {
    let mut along: Vec<Lit> = lit.to_vec();
    along.sort_by(|a, b| a.position_m.x.total_cmp(&b.position_m.x));
    let needs: Vec<f32> = candidates
        .iter()
        .map(|candidate| {
            let square = square_in(&along, candidate.bounds_m);
            let weight = viewpoint.map_or(1.0, |viewpoint| seen(candidate.bounds_m, viewpoint, size_m));
            weight * square * candidate.receivers as f32 / candidate.bytes.max(1) as f32
        })
        .collect();
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|&a, &b| needs[b].total_cmp(&needs[a]).then(a.cmp(&b)));
    order
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
        Candidate { bounds_m: [Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 1.0, 1.0)], receivers: 10, bytes }
    }

    fn lit(x: f32, light: f32) -> Lit {
        Lit { position_m: Vec3::new(x, 0.5, 0.5), irradiance: Vec3::splat(light) }
    }

    #[test]
    fn bright_places_come_first_and_of_alike_the_small() {
        let candidates =
            [candidate(0.0, 100), candidate(10.0, 100), candidate(20.0, 100), candidate(30.0, 50)];
        let places = [lit(30.5, 1.0), lit(0.5, 1.0), lit(20.5, 5.0)];
        assert_eq!(by_need(&candidates, &places, None, 40.0), [2, 3, 0, 1]);
        // A box without a known place takes those around it.
        let beside = [lit(11.9, 9.0), lit(0.5, 1.0)];
        assert_eq!(by_need(&candidates, &beside, None, 40.0)[0], 1);
    }

    #[test]
    fn near_places_before_the_eye_come_before_far_ones_and_those_behind() {
        let candidates = [candidate(-10.0, 100), candidate(2.0, 100), candidate(20.0, 100)];
        let places = [lit(-9.5, 1.0), lit(2.5, 1.0), lit(20.5, 1.0)];
        let viewpoint = Viewpoint { eye_m: Vec3::ZERO, forward: Vec3::X };
        assert_eq!(by_need(&candidates, &places, Some(viewpoint), 40.0), [1, 2, 0]);
    }
}
