//! The frame of an object: place and turn of its node, without scale.

use glam::{DMat3, DVec3, EulerRot};
use lightkiln_proto::scene::Stance;

use super::tree::Placed;

/// Steps of the largest number of a column of an object's own matrix, whose numbers are whole ones. Turns leave rounding errors of some 2⁻²³ where
/// a file has matrices: with fewer steps objects that are turned otherwise are still the same, with more they are nearer to the file's.
const STEPS: f64 = (1 << 20) as f64;
/// More than such errors: a power of two counts as one where they leave a little less.
const ABOVE: f64 = 1.0 + 2.0 / STEPS;
/// Share of a place's largest number below which another one is rounding.
const NOTHING: f64 = 1e-12;
/// Steps of a degree of a turn.
const DEGREE_STEPS: f64 = 1e6;

/// An object's frame in the scene, and what its node has besides.
pub(super) struct Frame {
    /// The frame.
    pub(super) stance: Stance,
    /// Scale and shear of the node in it.
    pub(super) object_from_node: DMat3,
}

impl Frame {
    /// The frame of a node; `None` where its place is beyond f32's range.
    pub(super) fn of(placed: &Placed) -> Option<Self> {
        let object_from_world = DMat3::from_quat(placed.turn.conjugate());
        let object_from_node = stepped(object_from_world * placed.world_from_node.matrix3);
        let (yaw, pitch, roll) = placed.turn.to_euler(EulerRot::YXZ);
        let degrees = |radians: f64| (radians.to_degrees() * DEGREE_STEPS).round() / DEGREE_STEPS;
        let turn_deg = [yaw, pitch, roll].map(|radians| (degrees(radians) + 0.0) as f32);
        let position_m = cleared(placed.world_from_node.translation).as_vec3();
        let stance = Stance { position_m: position_m.into(), turn_deg, ..Stance::default() };
        (position_m.is_finite() && object_from_node.is_finite()).then_some(Self { stance, object_from_node })
    }
}

/// Numbers as whole steps, of which the largest of each column has 2²⁰ to 2²¹.
fn stepped(matrix: DMat3) -> DMat3 {
    DMat3::from_cols_array_2d(&matrix.to_cols_array_2d().map(|column| {
        // The file's numbers, without what turns leave of f64's rounding.
        let numbers = column.map(|number| f64::from(number as f32));
        let largest = numbers.iter().fold(0.0_f64, |largest, number| largest.max(number.abs()));
        // The power of two at or below it: its exponent's bits alone.
        let step = f64::from_bits((largest * ABOVE).to_bits() & (0x7FF << 52)) / STEPS;
        if step > 0.0 && step.is_finite() {
            // Not below 0 where it is 0.
            numbers.map(|number| (number / step).round() * step + 0.0)
        } else {
            column
        }
    }))
}

/// A place without the rounding that turns of its parents leave.
fn cleared(place: DVec3) -> DVec3 {
    let least = NOTHING * place.abs().max_element();
    DVec3::from_array(place.to_array().map(|number| if number.abs() > least { number } else { 0.0 }))
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DQuat, Quat, Vec3};

    use super::*;

    #[test]
    fn turns_leave_no_trace_in_scales() {
        for scale in [[2.0, 0.3, 0.7], [2.54, 2.54, 2.54], [1.0, 1.0, 1.0], [100.0, 0.01, -3.0]] {
            let scale = Vec3::from(scale).as_dvec3();
            let of = |turn: DQuat| {
                let world_from_node = DAffine3::from_scale_rotation_translation(scale, turn, DVec3::ONE);
                Frame::of(&Placed { world_from_node, turn, node: 0, parent: None }).unwrap().object_from_node
            };
            let at_rest = of(DQuat::IDENTITY);
            for step in 0..400_u16 {
                let [a, b, c] = [0.37, 1.13, 0.71].map(|rate| rate * f32::from(step));
                let turn = Quat::from_euler(EulerRot::YXZ, a, b, c).as_dquat().normalize();
                assert_eq!(of(turn), at_rest, "{scale} {turn}");
            }
            let off = (at_rest.x_axis.x / scale.x - 1.0).abs().max((at_rest.y_axis.y / scale.y - 1.0).abs());
            assert!(off < 1e-6, "{scale}: {off}");
        }
    }
}
