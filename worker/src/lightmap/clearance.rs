//! The room above a receiver's texel in which no surface stands: rays that stay in it find nothing, so none are cast.
//!
//! About the axis of a receiver's raised point, in a slab that a hit on its plane is raised through, the nearest surface
//! is found in each of 16 sectors. The room is star-shaped: the straight way from any of its points to the axis lies in it.

use std::f32::consts::FRAC_1_SQRT_2;

use glam::{Vec2, Vec3};

use crate::rays::Tracer;
use crate::rays::sampling::tangent_frame;

/// Sectors about the axis: four to a quadrant.
const SECTORS: usize = 16;
/// Tangents of the angles between the sectors of a quadrant: of π/8, π/4 and 3π/8.
const TANGENTS: [f32; 3] = [0.414_213_57, 1.0, 2.414_213_6];
/// Cosines of the multiples of π/8 in a quadrant; sines are those of the angles beside π/2.
const COSINES: [f32; 5] = [1.0, 0.923_879_5, FRAC_1_SQRT_2, 0.382_683_43, 0.0];
/// Radius of the largest room, in texels: hits farther off read other receivers, but for a few at rims.
const RADIUS: f32 = 1.5;
/// Parts of the radius that distances are told in, rounded down.
const STEPS: f32 = 255.0;
/// How far the room keeps from all surfaces, and from the plane of its own, in lifts of rays: a lift is far above the error of
/// a hit's place, and so is a quarter of one.
const MARGIN: f32 = 0.25;
/// Most triangles that are looked at for a room: on a statue with thousands in a texel, looking for it takes longer than the rays
/// that it saves.
const TRIANGLES_MAX: usize = 256;

/// Where the room of a receiver is.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// The receiver's raised point, in metres.
    pub raised_m: Vec3,
    /// Unit normal of its face.
    pub normal: Vec3,
    /// Side of its texel in metres.
    pub texel_m: f32,
    /// By how much points of the texel are raised at most, and looked above, in metres.
    pub height_m: f32,
    /// Lift of rays about there, in metres.
    pub offset_m: f32,
}

/// A receiver's room: the distance of the nearest surface in each sector, in parts of the largest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clearance([u8; SECTORS]);

impl Clearance {
    /// The room that the surfaces of a scene leave.
    pub fn of(tracer: &Tracer, axis: &Axis) -> Self {
        let frame = Frame::of(axis);
        let (radius_m, margin_m) = (RADIUS * axis.texel_m, MARGIN * axis.offset_m);
        let half_m = axis.height_m + 2.0 * margin_m;
        // Of the box around the cylinder: its rim and its height along each axis of the world.
        let across = (Vec3::ONE - axis.normal * axis.normal).max(Vec3::ZERO).map(f32::sqrt);
        let reach_m = across * radius_m + axis.normal.abs() * half_m + margin_m;
        let (mut nearest_m, mut seen) = ([radius_m; SECTORS], 0);
        tracer.visit_box(axis.raised_m - reach_m, axis.raised_m + reach_m, |corners| {
            let within = slab(&corners.map(|corner| frame.local(corner)), half_m);
            add(&within, margin_m, &mut nearest_m);
            seen += 1;
            seen <= TRIANGLES_MAX && nearest_m.iter().any(|away_m| *away_m > 2.0 * margin_m)
        });
        if seen > TRIANGLES_MAX {
            return Self::default();
        }
        let steps = |away_m: f32| ((away_m - 2.0 * margin_m).max(0.0) / radius_m * STEPS) as u8;
        Self(nearest_m.map(steps))
    }

    /// Nothing stands above a point of the texel, nor between it, raised, and the receiver's raised point. `foot_m` is the
    /// point, lifted along `normal`, the unit normal of its side.
    pub fn holds(&self, axis: &Axis, foot_m: Vec3, normal: Vec3) -> bool {
        let frame = Frame::of(axis);
        let (foot, margin_m) = (frame.local(foot_m), MARGIN * axis.offset_m);
        let top = foot + frame.turned(normal) * (2.0 * axis.height_m);
        let most_m = axis.height_m + margin_m;
        // Between the two heights the point may stray from the foot by less than the margin.
        let is_upright = foot.truncate().distance_squared(top.truncate()) <= margin_m * margin_m;
        let free_m = f32::from(self.0[sector(foot.truncate())]) / STEPS * RADIUS * axis.texel_m;
        is_upright
            && foot.z >= -most_m
            && top.z <= most_m
            && foot.truncate().length_squared() < free_m * free_m
    }
}

/// Right-handed axes about a receiver's raised point, its normal last.
struct Frame {
    origin_m: Vec3,
    axes: [Vec3; 3],
}

impl Frame {
    fn of(axis: &Axis) -> Self {
        let (tangent, bitangent) = tangent_frame(axis.normal);
        Self { origin_m: axis.raised_m, axes: [tangent, bitangent, axis.normal] }
    }

    fn local(&self, point_m: Vec3) -> Vec3 {
        self.turned(point_m - self.origin_m)
    }

    fn turned(&self, direction: Vec3) -> Vec3 {
        Vec3::from_array(self.axes.map(|axis| axis.dot(direction)))
    }
}

/// The sector of a place about the axis.
fn sector(at: Vec2) -> usize {
    let (u, v) = (at.x.abs(), at.y.abs());
    let quadrant = usize::from(at.x < 0.0) + 2 * usize::from(at.y < 0.0);
    4 * quadrant + TANGENTS.iter().filter(|tangent| v > **tangent * u).count()
}

/// Unit directions of a sector's two sides.
fn sides(sector: usize) -> [Vec2; 2] {
    let (quadrant, part) = (sector / 4, sector % 4);
    let sign = Vec2::new(1.0 - 2.0 * (quadrant % 2) as f32, 1.0 - 2.0 * (quadrant / 2) as f32);
    [part, part + 1].map(|edge| sign * Vec2::new(COSINES[edge], COSINES[4 - edge]))
}

/// The part of a triangle between the heights `-half_m` and `half_m`, as seen along the axis: the corners of a polygon.
fn slab(corners: &[Vec3; 3], half_m: f32) -> Vec<Vec2> {
    let mut polygon = corners.to_vec();
    for sign in [1.0, -1.0] {
        let above = |point: Vec3| half_m - sign * point.z;
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (index, &to) in polygon.iter().enumerate() {
            let from = polygon[(index + polygon.len() - 1) % polygon.len()];
            let (from_above, to_above) = (above(from), above(to));
            if (from_above < 0.0) != (to_above < 0.0) {
                kept.push(from.lerp(to, (from_above / (from_above - to_above)).clamp(0.0, 1.0)));
            }
            if to_above >= 0.0 {
                kept.push(to);
            }
        }
        polygon = kept;
    }
    polygon.into_iter().map(Vec3::truncate).collect()
}

/// Lowers the distances of the sectors that a convex polygon lies in, each widened by the margin on both sides.
fn add(polygon: &[Vec2], margin_m: f32, nearest_m: &mut [f32; SECTORS]) {
    if polygon.is_empty() {
        return;
    }
    let edges = || polygon.iter().zip(polygon.iter().cycle().skip(1)).map(|(from, to)| [*from, *to]);
    if holds_origin(edges()) {
        *nearest_m = [0.0; SECTORS];
        return;
    }
    for (index, nearest_m) in nearest_m.iter_mut().enumerate() {
        let sides = sides(index);
        for edge in edges() {
            if let Some([from, to]) = within(edge, sides, margin_m) {
                *nearest_m = nearest_m.min(away(from, to));
            }
        }
    }
}

/// The origin lies in a convex polygon, on its rim too; one without area holds nothing that its edges do not.
fn holds_origin(mut edges: impl Iterator<Item = [Vec2; 2]> + Clone) -> bool {
    let turns = |[from, to]: [Vec2; 2]| from.perp_dot(to);
    edges.clone().all(|edge| turns(edge) >= 0.0) || edges.all(|edge| turns(edge) <= 0.0)
}

/// The part of an edge in a sector that is widened by the margin on both sides.
fn within([from, to]: [Vec2; 2], [first, last]: [Vec2; 2], margin_m: f32) -> Option<[Vec2; 2]> {
    let inward = first.perp_dot(last).signum();
    let mut share = [0.0_f32, 1.0];
    for (side, sign) in [(first, inward), (last, -inward)] {
        let inside = |point: Vec2| sign * side.perp_dot(point) + margin_m;
        let (from_inside, to_inside) = (inside(from), inside(to));
        match (from_inside >= 0.0, to_inside >= 0.0) {
            (true, true) => {}
            (false, false) => return None,
            (is_from, _) => {
                let at = (from_inside / (from_inside - to_inside)).clamp(0.0, 1.0);
                share = if is_from { [share[0], share[1].min(at)] } else { [share[0].max(at), share[1]] };
            }
        }
    }
    (share[0] <= share[1]).then(|| share.map(|share| from.lerp(to, share)))
}

/// Distance of a segment from the origin.
fn away(from: Vec2, to: Vec2) -> f32 {
    let along = to - from;
    let share = (-from.dot(along) / along.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    (from + along * share).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::sampling::{Sequence, uniform_sphere};

    /// Floor, walls, posts, tilted sheets and low slabs about a texel of side 1, turned and carried off as wished.
    struct Place {
        tracer: Tracer,
        axis: Axis,
        /// Axes along the floor.
        along: [Vec3; 2],
        /// Middle of the texel on the floor.
        middle_m: Vec3,
    }

    impl Place {
        fn random(sequence: &mut Sequence) -> Self {
            let normal = match sequence.next_u64() % 3 {
                0 => Vec3::Y,
                1 => Vec3::NEG_X,
                _ => uniform_sphere(sequence.next_f32(), sequence.next_f32()),
            };
            let (right, up) = tangent_frame(normal);
            let middle_m =
                (Vec3::new(sequence.next_f32(), sequence.next_f32(), sequence.next_f32()) - 0.5) * 40.0;
            let at = |x: f32, y: f32, z: f32| middle_m + right * x + up * y + normal * z;
            let quad = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| [[a, b, c], [a, c, d]];
            let mut triangles: Vec<[Vec3; 3]> =
                quad(at(-9.0, -8.0, 0.0), at(9.0, -8.0, 0.0), at(9.0, 8.0, 0.0), at(-9.0, 8.0, 0.0)).into();
            for _ in 0..sequence.next_u64() % 4 {
                let mut number = |least: f32, most: f32| least + (most - least) * sequence.next_f32();
                let (x, y, turn, half) =
                    (number(-1.5, 1.5), number(-1.5, 1.5), number(0.0, 7.0), number(0.01, 3.0));
                let (low, high) = (number(-0.1, 0.5), number(0.0, 0.6));
                let lean = if number(0.0, 1.0) < 0.5 { 0.0 } else { number(-1.0, 1.0) };
                let (sine, cosine) = libm::sincosf(turn);
                let (dx, dy) = (half * cosine, half * sine);
                let [foot, top] = [low, low + high].map(|z| (lean * z * sine, -lean * z * cosine, z));
                let corner =
                    |side: f32, (ox, oy, z): (f32, f32, f32)| at(x + side * dx + ox, y + side * dy + oy, z);
                triangles.extend(quad(
                    corner(-1.0, foot),
                    corner(1.0, foot),
                    corner(1.0, top),
                    corner(-1.0, top),
                ));
            }
            let tracer = Tracer::new(&triangles, None);
            let own_m = at(sequence.next_f32() - 0.5, sequence.next_f32() - 0.5, 0.0);
            let (offset_m, height_m) = (tracer.ray_offset_m(own_m), 0.25);
            let raised_m = own_m + normal * offset_m + normal * height_m;
            let axis = Axis { raised_m, normal, texel_m: 1.0, height_m, offset_m };
            Self { tracer, axis, along: [right, up], middle_m }
        }

        /// The rays themselves find nothing above a point, nor between it, raised, and the axis.
        fn is_open(&self, foot_m: Vec3) -> bool {
            let Axis { raised_m, normal, height_m, .. } = self.axis;
            self.tracer.closest(foot_m, normal, 2.0 * height_m).is_none()
                && !self.tracer.is_occluded(foot_m + normal * height_m, raised_m)
        }
    }

    #[test]
    fn rays_that_are_left_out_would_have_found_nothing() {
        let mut sequence = Sequence::new(11);
        let (mut held, mut open, mut blocked) = (0, 0, 0);
        for _ in 0..4000 {
            let place = Place::random(&mut sequence);
            let room = Clearance::of(&place.tracer, &place.axis);
            for _ in 0..40 {
                let [x, y] = [0, 1].map(|_| 2.0 * sequence.next_f32() - 1.0);
                let foot_m = place.middle_m
                    + place.along[0] * x
                    + place.along[1] * y
                    + place.axis.normal * place.axis.offset_m;
                let is_held = room.holds(&place.axis, foot_m, place.axis.normal);
                let is_open = place.is_open(foot_m);
                assert!(!is_held || is_open, "claimed at {foot_m} of {:?}", place.axis);
                (held, open, blocked) =
                    (held + u32::from(is_held), open + u32::from(is_open), blocked + u32::from(!is_open));
            }
        }
        assert!(blocked > 10_000, "only {blocked} blocked: the test shows nothing");
        assert!(held * 10 > open * 8, "{held} of {open} are known to be open");
    }

    #[test]
    fn room_ends_before_a_wall_and_before_a_point_that_another_surface_carries() {
        let quad = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| [[a, b, c], [a, c, d]];
        let floor = quad(Vec3::ZERO, Vec3::X * 9.0, Vec3::new(9.0, 9.0, 0.0), Vec3::Y * 9.0);
        let wall =
            quad(Vec3::X, Vec3::new(1.0, 9.0, 0.0), Vec3::new(1.0, 9.0, 3.0), Vec3::new(1.0, 0.0, 3.0));
        let tracer = Tracer::new(&[floor, wall].concat(), None);
        let (normal, offset_m) = (Vec3::Z, tracer.ray_offset_m(Vec3::ZERO));
        let raised_m = Vec3::new(1.5, 4.5, 0.25 + offset_m);
        let axis = Axis { raised_m, normal, texel_m: 1.0, height_m: 0.25, offset_m };
        let room = Clearance::of(&tracer, &axis);
        let holds = |x: f32, z: f32, normal: Vec3| room.holds(&axis, Vec3::new(x, 4.6, z), normal);
        assert!(holds(1.02, offset_m, normal) && holds(2.9, offset_m, normal));
        assert!(!holds(0.98, offset_m, normal), "beyond the wall");
        assert!(!holds(3.1, offset_m, normal), "farther than anything was looked for");
        assert!(!holds(1.5, -0.01, normal) && !holds(1.5, 0.1, normal), "on another plane");
        assert!(!holds(1.5, offset_m, Vec3::new(0.1, 0.0, 1.0).normalize()), "of a face that leans");
    }
}
