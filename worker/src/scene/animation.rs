//! Animations: places of nodes and weights of morph targets at a time (glTF 2.0 §3.11 and Appendix C).
//!
//! A channel holds its first key before it and its last key after it.

use glam::{DQuat, DVec4};
use gltf::json::accessor::Type;
use gltf::json::animation::{Animation, Channel, Interpolation, Property};
use gltf::json::scene::UnitQuaternion;
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};

use super::accessor::{Reader, Wanted};
use super::context::Context;
use super::document::{self, node_place};
use super::error::{ImportError, Result, place_of};
use super::limits::{self, within};

/// Most values of a key: weights of morph targets.
const KEY_VALUES_MAX: usize = 1 << 12;

/// Length of each animation of a file in seconds: the time of its last key. Channels that cannot be read count nothing: they are an
/// error of the animation that is played.
pub(super) fn lengths_s(context: &mut Context<'_>) -> Vec<f32> {
    let root = context.root;
    let mut lengths_s = vec![0.0_f32; root.animations.len()];
    for (clip, length_s) in lengths_s.iter_mut().enumerate() {
        let animation = &root.animations[clip];
        for channel in animation.channels.iter().filter(|channel| is_known(channel)) {
            if let Ok(keys) = Keys::open(context, clip, animation, channel) {
                *length_s = length_s.max(keys.time_s(keys.count - 1));
            }
        }
    }
    lengths_s
}

/// Channels of other targets than nodes' are passed over, as the format asks.
fn is_known(channel: &Channel) -> bool {
    matches!(channel.target.path, Checked::Valid(_))
}

/// The document with its nodes as an animation has them at a time, in seconds.
///
/// Errors on channels whose samplers, nodes or keys are not there.
pub(super) fn posed(context: &mut Context<'_>, clip: usize, time_s: f32) -> Result<Root> {
    let root = context.root;
    let mut posed = root.clone();
    let animation = &root.animations[clip];
    for channel in animation.channels.iter().filter(|channel| is_known(channel)) {
        let keys = Keys::open(context, clip, animation, channel)?;
        document::get(root, channel.target.node, "node", || animation_place(root, clip))?;
        let node = &mut posed.nodes[channel.target.node.value()];
        let value = keys.at(time_s);
        if !value.iter().all(|number| number.is_finite()) {
            let place = format!("{} at {time_s} s", node_place(root, channel.target.node.value()));
            return Err(ImportError::NonFiniteTransform { place });
        }
        let three = || [value[0], value[1], value[2]];
        if keys.path != Property::MorphTargetWeights && node.matrix.is_some() {
            let place = node_place(root, channel.target.node.value());
            let problem = "it is animated, and has a matrix where a translation, rotation and scale are due";
            return Err(ImportError::Accessor { place, problem: problem.to_owned() });
        }
        match keys.path {
            Property::Translation => node.translation = Some(three()),
            Property::Scale => node.scale = Some(three()),
            Property::Rotation => {
                node.rotation = Some(UnitQuaternion([value[0], value[1], value[2], value[3]]));
            }
            Property::MorphTargetWeights => node.weights = Some(value),
        }
    }
    Ok(posed)
}

fn animation_place(root: &Root, clip: usize) -> String {
    place_of("animation", clip, root.animations[clip].name.as_deref())
}

/// Keys of a channel.
struct Keys<'a> {
    path: Property,
    interpolation: Interpolation,
    times: Reader<'a>,
    values: Reader<'a>,
    count: usize,
    /// Accessor's elements of a key, without tangents.
    elements: usize,
}

impl<'a> Keys<'a> {
    fn open(
        context: &mut Context<'a>,
        clip: usize,
        animation: &'a Animation,
        channel: &'a Channel,
    ) -> Result<Self> {
        let root = context.root;
        let place = || format!("a channel of {}", animation_place(root, clip));
        let fail = |problem: &str| ImportError::Accessor { place: place(), problem: problem.to_owned() };
        let sampler = animation.samplers.get(channel.sampler.value());
        let sampler = sampler.ok_or_else(|| fail("it names a sampler that is not there"))?;
        let (Checked::Valid(path), Checked::Valid(interpolation)) =
            (channel.target.path, sampler.interpolation)
        else {
            return Err(fail("its path or interpolation is none of glTF's"));
        };
        let (kind, elements) = match path {
            Property::Translation | Property::Scale => (Type::Vec3, 1),
            Property::Rotation => (Type::Vec4, 1),
            Property::MorphTargetWeights => (Type::Scalar, targets(root, channel).unwrap_or(0)),
        };
        if elements == 0 || elements > KEY_VALUES_MAX {
            return Err(fail("its node has no mesh with morph targets, or too many"));
        }
        let mut open = |index, kind, min_count| {
            let wanted = Wanted {
                place: &place,
                types: &[kind],
                min_count,
                is_always_normalized: path == Property::Rotation,
            };
            Reader::open(root, context.buffers, &mut context.budgets.sparse_elements, index, &wanted)
        };
        let times = open(sampler.input, Type::Scalar, 1)?;
        let count = times.count();
        within(limits::VERTICES, count as u64, context.limits.vertices)?;
        let per_key = if interpolation == Interpolation::CubicSpline { 3 } else { 1 };
        let values = open(sampler.output, kind, count * elements * per_key)?;
        Ok(Self { path, interpolation, times, values, count, elements })
    }

    fn time_s(&self, key: usize) -> f32 {
        self.times.floats::<1>(key, 0.0)[0]
    }

    /// The value at a time.
    fn at(&self, time_s: f32) -> Vec<f32> {
        // Keys ascend by the format; of a file whose keys do not, some key is found.
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = (low + high) / 2;
            if self.time_s(middle) <= time_s { low = middle + 1 } else { high = middle }
        }
        let Some(before) = low.checked_sub(1) else { return self.flat(0, 1) };
        if low == self.count || self.interpolation == Interpolation::Step {
            return self.flat(before, 1);
        }
        let length_s = self.time_s(low) - self.time_s(before);
        let share = if length_s > 0.0 { (time_s - self.time_s(before)) / length_s } else { 0.0 };
        match self.interpolation {
            Interpolation::CubicSpline => self.spline(before, share, length_s),
            _ => self.linear(before, share),
        }
    }

    /// Numbers of a key; of a spline, `part` 0 is the tangent before it, 1 the value, 2 the tangent after it.
    fn flat(&self, key: usize, part: usize) -> Vec<f32> {
        let width = match self.path {
            Property::Translation | Property::Scale => 3,
            Property::Rotation => 4,
            Property::MorphTargetWeights => 1,
        };
        let is_spline = self.interpolation == Interpolation::CubicSpline;
        let first = if is_spline { (3 * key + part) * self.elements } else { key * self.elements };
        (first..first + self.elements)
            .flat_map(|element| self.values.floats::<4>(element, 0.0).into_iter().take(width))
            .collect()
    }

    fn linear(&self, before: usize, share: f32) -> Vec<f32> {
        let (a, b) = (self.flat(before, 1), self.flat(before + 1, 1));
        if self.path == Property::Rotation {
            let quaternion = |of: &[f32]| {
                DQuat::from_vec4(DVec4::new(of[0].into(), of[1].into(), of[2].into(), of[3].into()))
            };
            let unit = |of: &[f32]| {
                let found = quaternion(of);
                if found.length_squared() > 0.0 { found.normalize() } else { DQuat::IDENTITY }
            };
            return unit(&a).slerp(unit(&b), f64::from(share)).as_quat().to_array().to_vec();
        }
        a.iter().zip(&b).map(|(a, b)| a + (b - a) * share).collect()
    }

    /// Appendix C.4: a Hermite spline, whose tangents are per second.
    fn spline(&self, before: usize, share: f32, length_s: f32) -> Vec<f32> {
        let (t, t2, t3) = (share, share * share, share * share * share);
        let weights = [
            2.0 * t3 - 3.0 * t2 + 1.0,
            (t3 - 2.0 * t2 + t) * length_s,
            3.0 * t2 - 2.0 * t3,
            (t3 - t2) * length_s,
        ];
        let parts =
            [self.flat(before, 1), self.flat(before, 2), self.flat(before + 1, 1), self.flat(before + 1, 0)];
        // Rotations are made unit by whoever places the node.
        (0..parts[0].len())
            .map(|index| parts.iter().zip(weights).map(|(part, weight)| part[index] * weight).sum())
            .collect()
    }
}

/// Morph targets of a channel's node.
fn targets(root: &Root, channel: &Channel) -> Option<usize> {
    let node = root.nodes.get(channel.target.node.value())?;
    let mesh = root.meshes.get(node.mesh.as_ref().map(Index::value)?)?;
    mesh.primitives.iter().filter_map(|primitive| primitive.targets.as_ref()).map(Vec::len).max()
}
