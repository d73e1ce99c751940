//! The core of a scene whose surfaces are of very different scales: where its detail is, and so people.
//!
//! A room on a plane of 100 km is a room: texels that suit the plane would miss it. So space about the core is parted in
//! *shells*, each the part of a cube outside the one of half its size. Far shells get coarse texels, see
//! [`Core::coarseness`]. A scene of one scale has no core, and nothing here touches it.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::model::Scene;

/// Least half side of the innermost cube, in metres: the room that people need around them. A screw on a floor is no core.
const HALF_MIN_M: f32 = 4.0;
/// Reach of a scene over the size of its detail up to which it is of one scale.
const RATIO_MIN: f32 = 64.0;
/// Ratio from which on the innermost cube is as small as it can be; between the two it shrinks, so that scenes on either side
/// of [`RATIO_MIN`] are treated much alike.
const RATIO_FULL: f32 = 4096.0;
/// Most shells: the limit of vertices is far within.
const SHELLS_MAX: u32 = 64;

/// Cubes about the place where a scene's detail is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Core {
    /// Their middle, in metres.
    pub middle_m: Vec3,
    /// Half a side of the innermost, a power of two.
    pub half_m: f32,
    /// How many shells there are about it: the outermost cube holds the scene.
    pub shells: u32,
}

impl Core {
    /// The core of a scene whose far things are at least 64 times as far as its detail is wide; none of a scene of one scale.
    ///
    /// Detail is where the middle half of its triangles is, along each axis. An instance of n triangles has the weight √n:
    /// neither a terrain of a million triangles nor a screw of as many is all of a scene.
    pub fn of(scene: &Scene) -> Option<Self> {
        let [low, high] = scene.bounds_m();
        if (high - low).max_element() <= RATIO_MIN * HALF_MIN_M {
            return None;
        }
        let middles = weighted_middles(scene);
        let quartiles = [0, 1, 2].map(|axis| quartiles(&middles, axis));
        let size_m = quartiles.iter().map(|[first, third]| third - first).fold(HALF_MIN_M, f32::max);
        let detail_m = power_of_two_from(size_m);
        // On a lattice, so that an edit of something small moves nothing.
        let step_m = 0.5 * detail_m;
        let middle_m = Vec3::from(quartiles.map(|[first, third]| first.midpoint(third)));
        let middle_m = (middle_m / step_m).round() * step_m;
        let reach_m = (low - middle_m).abs().max((high - middle_m).abs()).max_element();
        let ratio = reach_m / detail_m;
        if !ratio.is_finite() || ratio <= RATIO_MIN {
            return None;
        }
        let half_m = detail_m * power_of_two_from(0.5 * RATIO_FULL / ratio).clamp(1.0, RATIO_MIN);
        let shells = (0..SHELLS_MAX).find(|&shell| half_of(half_m, shell) >= reach_m)?;
        (shells > 0).then_some(Self { middle_m, half_m, shells })
    }

    /// Shell that a point lies in; 0 is the innermost cube.
    pub fn shell_of(&self, point_m: Vec3) -> u32 {
        let away_m = (point_m - self.middle_m).abs().max_element();
        (0..self.shells).find(|&shell| away_m <= self.half_of(shell)).unwrap_or(self.shells)
    }

    /// Shell of a triangle's middle.
    pub fn shell_of_triangle(&self, [a, b, c]: [Vec3; 3]) -> u32 {
        self.shell_of((a + b + c) / 3.0)
    }

    /// Half a side of the cube that bounds a shell on the outside.
    pub fn half_of(&self, shell: u32) -> f32 {
        half_of(self.half_m, shell)
    }

    /// Doublings of the texels' length in a shell that the square of the distance asks for.
    pub fn falls_off(&self, shell: u32) -> u32 {
        (2 * shell).saturating_sub(1)
    }

    /// Texels of a shell are 2ⁿ times as long as those of the core, of `texel_m`: as the square of the distance, as ground seen
    /// from where people stand is foreshortened too, and at most a quarter of the distance.
    pub fn coarseness(&self, shell: u32, texel_m: f32) -> u32 {
        if shell == 0 {
            return 0;
        }
        let quarters = 0.25 * self.half_of(shell - 1) / texel_m;
        let most = (0..2 * SHELLS_MAX).take_while(|&n| 2.0_f32.powi(n as i32 + 1) <= quarters).count();
        self.falls_off(shell).min(most as u32)
    }

    /// Lower and upper corner of the cube that bounds a shell.
    pub fn bounds_of(&self, shell: u32) -> [Vec3; 2] {
        let half_m = Vec3::splat(self.half_of(shell));
        [self.middle_m - half_m, self.middle_m + half_m]
    }
}

fn half_of(half_m: f32, shell: u32) -> f32 {
    half_m * 2.0_f32.powi(shell as i32)
}

/// The least power of two that is not below a length.
fn power_of_two_from(length: f32) -> f32 {
    let mut power = 1.0_f32;
    while power < length {
        power *= 2.0;
    }
    while power * 0.5 >= length && power > f32::MIN_POSITIVE {
        power *= 0.5;
    }
    power
}

/// Middle of each triangle, and its weight.
fn weighted_middles(scene: &Scene) -> Vec<(Vec3, f32)> {
    let of_instance = scene.instances.iter().flat_map(|instance| {
        let weight = 1.0 / (instance.triangles.len().max(1) as f32).sqrt();
        instance.triangles.iter().map(move |triangle| {
            let [a, b, c] = triangle.map(|vertex| instance.positions_m[vertex as usize]);
            ((a + b + c) / 3.0, weight)
        })
    });
    of_instance.collect()
}

/// First and third quartile along an axis.
fn quartiles(middles: &[(Vec3, f32)], axis: usize) -> [f32; 2] {
    let mut places: Vec<(f32, f32)> =
        middles.iter().map(|(middle, weight)| (middle[axis], *weight)).collect();
    places.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = places.iter().map(|(_, weight)| f64::from(*weight)).sum();
    [0.25, 0.75].map(|share| {
        let mut sum = 0.0;
        let mut is_before = |(_, weight): &&(f32, f32)| {
            sum += f64::from(*weight);
            sum < share * total
        };
        places.iter().find(|place| !is_before(place)).map_or(0.0, |(place, _)| *place)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::model::MeshInstance;

    /// A grid of triangles over a square of `side_m`, `steps` along each side, about a point.
    fn square(middle_m: Vec3, side_m: f32, steps: u32) -> MeshInstance {
        let step_m = side_m / steps as f32;
        let corner = |x: u32, z: u32| {
            middle_m + Vec3::new(x as f32 * step_m - 0.5 * side_m, 0.0, z as f32 * step_m - 0.5 * side_m)
        };
        let cells = (0..steps * steps).map(|cell| (cell % steps, cell / steps));
        let positions_m: Vec<Vec3> = cells
            .flat_map(|(x, z)| [corner(x, z), corner(x, z + 1), corner(x + 1, z + 1), corner(x + 1, z)])
            .collect();
        let triangles = (0..steps * steps).flat_map(|cell| {
            let first = 4 * cell;
            [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        });
        MeshInstance { positions_m, triangles: triangles.collect(), ..MeshInstance::default() }
    }

    fn core_of(instances: Vec<MeshInstance>) -> Option<Core> {
        Core::of(&Scene { instances, ..Scene::default() })
    }

    #[test]
    fn scenes_of_one_scale_have_no_core() {
        for side_m in [1e-6, 1.0, 1609.0, 1e5] {
            assert_eq!(core_of(vec![square(Vec3::ZERO, side_m, 3), square(Vec3::Y, side_m, 5)]), None);
        }
        // A screw of a million triangles on a floor, and a house in a town.
        let screw = square(Vec3::new(3.0, 0.0, 2.0), 0.01, 300);
        assert_eq!(core_of(vec![square(Vec3::ZERO, 10.0, 1), screw]), None);
        assert_eq!(core_of(vec![square(Vec3::ZERO, 1000.0, 100), square(Vec3::ZERO, 8.0, 20)]), None);
    }

    #[test]
    fn room_on_a_plain_is_the_core_wherever_it_stands() {
        for at_m in [Vec3::ZERO, Vec3::new(30_000.0, 0.0, -20_000.0)] {
            let room = || vec![square(at_m, 4.0, 2), square(at_m + 2.0 * Vec3::Y, 4.0, 2)];
            let far = Vec3::new(-9e4, 0.0, 9e4);
            for other in [square(Vec3::ZERO, 1e5, 1), square(far, 1.0, 1)] {
                let core = core_of([room(), vec![other]].concat()).unwrap();
                assert_eq!(core.half_m, 4.0);
                assert_eq!([at_m - 2.0, at_m + 2.0].map(|corner| core.shell_of(corner)), [0, 0]);
                assert!(core.shell_of(far) > 12 && core.shell_of(far) <= core.shells);
            }
        }
    }

    #[test]
    fn texels_grow_from_shell_to_shell_and_never_past_a_quarter_of_the_distance() {
        let core = Core { middle_m: Vec3::ZERO, half_m: 4.0, shells: 14 };
        let coarse: Vec<u32> = (0..=14).map(|shell| core.coarseness(shell, 0.125)).collect();
        assert_eq!(coarse[..6], [0, 1, 3, 5, 6, 7]);
        for (shell, coarse) in (1..=14).zip(&coarse[1..]) {
            assert!(0.125 * 2.0_f32.powi(*coarse as i32) <= 0.25 * core.half_of(shell - 1));
        }
        assert_eq!(core.coarseness(3, 100.0), 0);
    }
}
