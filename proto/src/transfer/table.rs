//! A volume at run time: what of an object is seen from a point, and what that changes.

use std::f32::consts::TAU;
use std::sync::Arc;

use glam::{Affine3A, Mat3, Vec3, Vec4};

use super::content::{LEVELS, TransferLevel, TransferPart};
use super::hidden::Hidden;
use super::lattice::{BLEND_FROM, FADE_H, Lattice, REACH_H, half_side_m};
use super::viewpoints::Viewpoints;
use crate::relight::{Inconsistent, PatchTable};

/// Patches of a part by number, with their shares.
type Shares = Vec<(u32, f32)>;
/// Mean radiance of each part, by level, W·m⁻²·sr⁻¹.
pub type PartRadiance = Vec<Vec<Vec3>>;

/// The volume of an object.
#[derive(Clone, Debug, Default)]
pub struct TransferTable {
    levels: Vec<(TransferLevel, Lattice)>,
    /// Numbers of each part's patches, with their shares, by level.
    patches: Vec<Vec<Shares>>,
    middle_m: Vec3,
    h_m: f32,
}

/// One part of an object as a point sees it, in the object's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covered {
    /// Level of the part.
    pub level: usize,
    /// Its number there.
    pub part: usize,
    /// F_p.
    pub vector: Vec3,
    /// Ω_p in steradians.
    pub solid_angle: f32,
}

/// An object where it stands, in its light.
#[derive(Clone, Debug)]
pub struct Standing<'a> {
    table: &'a TransferTable,
    object_from_world: Affine3A,
    /// Of directions.
    turn_back: Mat3,
    /// Mean radiance of each part, by level, W·m⁻²·sr⁻¹.
    radiance: Arc<PartRadiance>,
    /// Radiance that each part hides, by level.
    hidden: Arc<Vec<Vec<Hidden>>>,
}

impl TransferTable {
    /// Of all levels, in any order, over the patches that they name.
    pub fn new(mut levels: Vec<TransferLevel>, patches: &PatchTable) -> Result<Self, Inconsistent> {
        levels.sort_by_key(|level| level.level);
        if !levels.iter().map(|level| level.level).eq(0..LEVELS) {
            let found: Vec<u32> = levels.iter().map(|level| level.level).collect();
            return Err(Inconsistent::new(
                "transfer",
                format!("has levels {found:?}, wanted 0 to {}", LEVELS - 1),
            ));
        }
        let box_m = levels[0].box_m;
        let mut table = Self { h_m: half_side_m(box_m), ..Self::default() };
        table.middle_m = 0.5 * (Vec3::from(box_m[0]) + Vec3::from(box_m[1]));
        for level in levels {
            let named =
                |problem: String| Inconsistent::new(format!("transfer level {}", level.level), problem);
            if level.box_m != box_m {
                return Err(named("is of an object of other bounds".to_owned()));
            }
            let numbers = |part: &TransferPart| {
                let number = |patch: &super::PartPatch| {
                    let number = patches.number(patch.key);
                    number
                        .map(|number| (number, patch.share))
                        .ok_or_else(|| named(format!("names no patch {:x}", patch.key.0)))
                };
                part.patches.iter().map(number).collect::<Result<Vec<_>, _>>()
            };
            table.patches.push(level.parts.iter().map(numbers).collect::<Result<_, _>>()?);
            let lattice = Lattice::new(level.box_m, level.level, level.nodes);
            table.levels.push((level, lattice));
        }
        Ok(table)
    }

    /// Levels with their nodes, the finest first.
    pub fn levels(&self) -> impl Iterator<Item = &(TransferLevel, Lattice)> {
        self.levels.iter()
    }

    /// Numbers of the patches of each part with their shares, by level.
    pub fn patches(&self) -> &[Vec<Vec<(u32, f32)>>] {
        &self.patches
    }

    /// Middle of the object in its own space, in metres.
    pub fn middle_m(&self) -> Vec3 {
        self.middle_m
    }

    /// H: half of the object's largest side, in metres.
    pub fn half_side_m(&self) -> f32 {
        self.h_m
    }

    /// Lower and upper corner of the object in its own space, in metres.
    pub fn box_m(&self) -> [[f32; 3]; 2] {
        self.levels.first().map_or([[0.0; 3]; 2], |(level, _)| level.box_m)
    }

    /// Mean radiance of each part by level, of λ as the object's patches have it, and of the radiance of its emitters, W·m⁻²·sr⁻¹.
    pub fn radiance(&self, lambda: &[Vec4], emitters: &[Vec3]) -> PartRadiance {
        let of_level = |((level, _), patches): (&(TransferLevel, Lattice), &Vec<Shares>)| {
            let of_part = |(part, patches): (&TransferPart, &Shares)| {
                let reflected = patches.iter().map(|(patch, share)| {
                    lambda.get(*patch as usize).map_or(Vec3::ZERO, |light| light.truncate()) * *share
                });
                let emitted = part.glows.iter().map(|glow| {
                    let emitter = emitters.get(usize::from(glow.emitter)).copied().unwrap_or_default();
                    emitter * Vec3::from(glow.share)
                });
                reflected.sum::<Vec3>() + emitted.sum::<Vec3>()
            };
            level.parts.iter().zip(patches).map(of_part).collect()
        };
        self.levels.iter().zip(&self.patches).map(of_level).collect()
    }

    /// Radiance that each part may hide, by level: of the surroundings as its mean place sees them.
    pub fn hidden(&self, viewpoints: &Viewpoints) -> Vec<Vec<Hidden>> {
        let seen: Vec<Option<Hidden>> =
            viewpoints.seen().iter().map(|seen| seen.as_ref().map(Hidden::of)).collect();
        let of_part = |part: &TransferPart| {
            let weighted = seen.iter().zip(viewpoints.weights(part.middle_m.into()));
            Hidden::mixed(
                weighted.filter_map(|(seen, weight)| seen.as_ref().zip((weight > 0.0).then_some(weight))),
            )
        };
        self.levels.iter().map(|(level, _)| level.parts.iter().map(of_part).collect()).collect()
    }

    /// Weight of the object's effect on a point in its frame: 1 near it, 0 from [`REACH_H`] on.
    pub fn fade(&self, at_m: Vec3) -> f32 {
        let distance = (at_m - self.middle_m).abs().max_element() / self.h_m.max(f32::MIN_POSITIVE);
        let t = ((distance - FADE_H) / (REACH_H - FADE_H)).clamp(0.0, 1.0);
        (2.0 * t - 3.0) * t * t + 1.0
    }

    /// Calls `found` with each part that a point in the object's frame sees, and its weight: those of two levels where they blend. Parts of which
    /// the point lies behind the plane are none.
    pub fn covered(&self, at_m: Vec3, mut found: impl FnMut(Covered, f32)) {
        let distance_m = (at_m - self.middle_m).abs().max_element();
        let Some(finest) = self.levels.iter().position(|(_, lattice)| distance_m < lattice.half_m) else {
            return;
        };
        let share = distance_m / self.levels[finest].1.half_m;
        let blend = ((share - BLEND_FROM) / (1.0 - BLEND_FROM)).clamp(0.0, 1.0);
        let coarser = if finest + 1 < self.levels.len() { blend } else { 0.0 };
        for (level, weight) in [(finest, 1.0 - coarser), (finest + 1, coarser)] {
            if weight > 0.0 {
                self.covered_in(level, at_m, |part| found(part, weight));
            }
        }
    }

    /// Calls `found` with each part of a level that a point sees.
    fn covered_in(&self, index: usize, at_m: Vec3, mut found: impl FnMut(Covered)) {
        let (level, lattice) = &self.levels[index];
        let (first, share) = lattice.around(at_m);
        for (number, part) in level.parts.iter().enumerate() {
            let [x, y, z, offset] = part.plane;
            if Vec3::new(x, y, z).dot(at_m) < offset {
                continue;
            }
            let codes = level.codes_of(number);
            let mut sum = Vec4::ZERO;
            for corner in 0..8_u32 {
                let bit = |axis: u32| corner >> axis & 1;
                let weight: f32 = (0..3)
                    .map(
                        |axis| if bit(axis) == 1 { share[axis as usize] } else { 1.0 - share[axis as usize] },
                    )
                    .product();
                let [x, y, z] = [0, 1, 2].map(|axis| first[axis as usize] + bit(axis));
                let node = (z * level.nodes + y) * level.nodes + x;
                sum += weight * Vec4::from_array(codes[node as usize].map(f32::from));
            }
            let [of_vector, of_angle] = part.steps;
            let (vector, solid_angle) = (sum.truncate() * of_vector, sum.w * of_angle);
            if solid_angle > 0.0 {
                found(Covered { level: index, part: number, vector, solid_angle });
            }
        }
    }
}

impl<'a> Standing<'a> {
    /// An object at a place, of uniform scale, whose parts have such radiance and hide such.
    pub fn new(
        table: &'a TransferTable,
        world_from_object: Affine3A,
        radiance: Arc<PartRadiance>,
        hidden: Arc<Vec<Vec<Hidden>>>,
    ) -> Self {
        let object_from_world = world_from_object.inverse();
        let turn = Mat3::from(object_from_world.matrix3);
        let scale = turn.x_axis.length().max(f32::MIN_POSITIVE);
        Self { table, object_from_world, turn_back: turn * scale.recip(), radiance, hidden }
    }

    /// Whether its effect reaches a point.
    pub fn reaches(&self, at_m: Vec3) -> bool {
        self.fade(at_m) > 0.0
    }

    /// Weight of its effect on a point.
    pub fn fade(&self, at_m: Vec3) -> f32 {
        self.table.fade(self.object_from_world.transform_point3(at_m))
    }

    /// The object as a point sees it.
    pub fn cap(&self, at_m: Vec3) -> Cap {
        let local_m = self.object_from_world.transform_point3(at_m);
        let offset_m = self.table.middle_m - local_m;
        let (mut solid_angle, mut vector) = (0.0, Vec3::ZERO);
        self.table.covered(local_m, |covered, weight| {
            solid_angle += weight * covered.solid_angle;
            vector += weight * covered.vector;
        });
        let world_m = self.object_from_world.matrix3.x_axis.length().max(f32::MIN_POSITIVE);
        Cap {
            towards: self.turn_back.transpose()
                * vector.try_normalize().unwrap_or(offset_m.normalize_or(Vec3::Y)),
            distance_m: offset_m.length() / world_m,
            half_angle_rad: libm::acosf((1.0 - solid_angle / TAU).clamp(-1.0, 1.0)),
        }
    }

    /// ΔE at a point about a normal in W·m⁻², without walls and other objects between.
    pub fn change(&self, at_m: Vec3, normal: Vec3) -> Vec3 {
        let (at_m, normal) = (self.object_from_world.transform_point3(at_m), self.turn_back * normal);
        let fade = self.table.fade(at_m);
        if fade <= 0.0 {
            return Vec3::ZERO;
        }
        let mut sum = Vec3::ZERO;
        self.table.covered(at_m, |Covered { level, part, vector, solid_angle }, weight| {
            let received = normal.dot(vector);
            if received > 0.0 {
                let hidden = self.hidden[level][part].mean(vector.normalize_or_zero(), solid_angle);
                sum += weight * received * (self.radiance[level][part] - hidden);
            }
        });
        fade * sum
    }
}

/// An object as a point sees it: a cap of as many steradians about its mean direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cap {
    /// Unit vector towards it.
    pub towards: Vec3,
    /// Distance of its middle in metres.
    pub distance_m: f32,
    /// Half angle in radians.
    pub half_angle_rad: f32,
}

impl Cap {
    /// Share of this one that a nearer one hides (\[Oat2007\] §4).
    pub fn hidden_by(&self, nearer: &Self) -> f32 {
        if nearer.distance_m >= self.distance_m || self.half_angle_rad.min(nearer.half_angle_rad) <= 0.0 {
            return 0.0;
        }
        let apart = libm::acosf(self.towards.dot(nearer.towards).clamp(-1.0, 1.0));
        let [own, other] = [self.half_angle_rad, nearer.half_angle_rad];
        let (touching, within) = (own + other, (own - other).abs());
        let area = |angle: f32| 1.0 - libm::cosf(angle);
        let share = (area(own.min(other)) / area(own)).min(1.0);
        let t = ((touching - apart) / (touching - within).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        share * t * t * (3.0 - 2.0 * t)
    }
}
