//! Near hits: points close to receivers whose light is read at the very point.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::receivers::{BlockKey, Texel};

/// Points close to receivers whose light is read at the very point: in narrow places, where a texel has strips of light
/// and shadow. A hit at y on the texel t gives its receiver `weight · ρ_t/π · (E_dir(y) + E_ind(t))`, with E_dir for the
/// normal of t. A hit that walls part from the middles of all texels around has an albedo and a normal
/// of its own, and the E_ind of the receiver that meets it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NearHits {
    /// Longest distance of a hit from its receiver along an axis, in metres.
    pub reach_m: f32,
    /// Hits of each receiver, which follow each other in the arrays below. Empty where no receiver has any.
    pub count: Vec<u8>,
    /// Weight of each hit of a receiver, at most π: the integral of cosθ over the directions that it stands for.
    pub weight: Vec<f32>,
    /// Blocks that hits lie in; `block` indexes it.
    pub blocks: Vec<BlockKey>,
    /// Surface of each hit.
    pub surface: Vec<NearSurface>,
    /// How far its place y is from the receiver's, in shares of the reach of 1/[`NearHits::STEPS`].
    pub offset: Vec<[i16; 3]>,
}

impl NearHits {
    /// Steps of an offset along the reach.
    pub const STEPS: i16 = 2047;
    /// Offsets are stored in multiples of so many steps.
    pub const STEPS_STORED: i16 = 8;

    /// The eight stored offsets around a hit at `to_m` of a receiver at `from_m`, those below and above it along each axis; the
    /// same where one is at the hit. Farther than the reach is at the reach.
    pub fn offsets_around(from_m: [f32; 3], to_m: [f32; 3], reach_m: f32) -> [[i16; 3]; 8] {
        let steps_along = f32::from(Self::STEPS) / f32::from(Self::STEPS_STORED);
        let steps =
            [0, 1, 2].map(|axis| ((to_m[axis] - from_m[axis]) / reach_m).clamp(-1.0, 1.0) * steps_along);
        std::array::from_fn(|corner| {
            [0, 1, 2].map(|axis| {
                let is_above = corner >> axis & 1 == 1;
                let multiple = if is_above { libm::ceilf(steps[axis]) } else { libm::floorf(steps[axis]) };
                Self::stored(multiple as i16 * Self::STEPS_STORED)
            })
        })
    }

    /// The nearest offset that is stored: a multiple of [`NearHits::STEPS_STORED`] within the reach.
    pub fn stored(offset: i16) -> i16 {
        let most = Self::STEPS / Self::STEPS_STORED;
        let multiple = libm::roundf(f32::from(offset) / f32::from(Self::STEPS_STORED)) as i16;
        multiple.clamp(-most, most) * Self::STEPS_STORED
    }

    /// Place of a hit in metres, from its receiver's, on a surface of that normal: raised by a stored step, as rounding may
    /// have put it below.
    pub fn position_m(&self, hit: usize, from_m: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        Self::position_of(self.offset[hit], from_m, normal, self.reach_m)
    }

    /// The same of any offset.
    pub fn position_of(offset: [i16; 3], from_m: [f32; 3], normal: [f32; 3], reach_m: f32) -> [f32; 3] {
        let step_m = reach_m / f32::from(Self::STEPS);
        let steps = |axis: usize| f32::from(offset[axis]) + f32::from(Self::STEPS_STORED) * normal[axis];
        [0, 1, 2].map(|axis| from_m[axis] + steps(axis) * step_m)
    }

    /// How many hits there are.
    pub fn len(&self) -> usize {
        self.surface.len()
    }

    /// There are none.
    pub fn is_empty(&self) -> bool {
        self.surface.is_empty()
    }

    /// Which hits each receiver has, receiver by receiver.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.count.iter().scan(0, |end, &count| {
            let start = *end;
            *end += usize::from(count);
            Some(start..*end)
        })
    }

    /// The receiver of every hit.
    pub fn receivers(&self) -> impl Iterator<Item = usize> + '_ {
        self.ranges().enumerate().flat_map(|(receiver, hits)| hits.map(move |_| receiver))
    }
}

/// Surface of a near hit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum NearSurface {
    /// A texel.
    Texel {
        /// Index into [`NearHits::blocks`].
        block: u16,
        /// Texel in the block. Where no cluster has a receiver of it, no light reaches it: it counts as dark.
        texel: Texel,
    },
    /// A surface that no texel stands for.
    Own {
        /// Diffuse albedo ρ, linear Rec.709, below 1.
        albedo: [f32; 3],
        /// Unit normal towards the lit side.
        normal: [f32; 3],
    },
}
