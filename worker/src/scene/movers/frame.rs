//! The frame of an object: place and turn of its node, without scale.

use glam::{DMat3, DVec3, EulerRot};
use lightkiln_proto::scene::Stance;

use super::tree::Placed;

/// Steps of the largest number of an object's own matrix, whose numbers are whole ones. Turns leave rounding errors of some 2⁻²³ where a file
/// has matrices: with fewer steps objects that are turned otherwise are still the same, with more they are nearer to the file's.
const STEPS: f64 = (1 << 20) as f64;
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

/// Numbers as whole steps, of which the largest has 2²⁰ to 2²¹.
fn stepped(matrix: DMat3) -> DMat3 {
    let numbers = matrix.to_cols_array();
    let largest = numbers.iter().fold(0.0_f64, |largest, number| largest.max(number.abs()));
    // The power of two at or below it: its exponent's bits alone.
    let step = f64::from_bits(largest.to_bits() & (0x7FF << 52)) / STEPS;
    if step > 0.0 && step.is_finite() {
        // Not below 0 where it is 0.
        DMat3::from_cols_array(&numbers.map(|number| (number / step).round() * step + 0.0))
    } else {
        matrix
    }
}

/// A place without the rounding that turns of its parents leave.
fn cleared(place: DVec3) -> DVec3 {
    let least = NOTHING * place.abs().max_element();
    DVec3::from_array(place.to_array().map(|number| if number.abs() > least { number } else { 0.0 }))
}
