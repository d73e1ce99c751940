//! Blocks and receivers: a texel's point, normals, albedo and emission, on each lit side.

use std::collections::BTreeSet;

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::prt::{AreaCode, Settings};
use rayon::prelude::*;

use super::shift::{Shifter, Standing};
use super::texels::{Coverage, CoveredTexel, alternatives, areas, cover};
use crate::prt::stage::{NO_RECEIVER, Receiver, StageBlock};
use crate::prt::world::{Geometry, TriangleRef, corners_of};
use crate::scene::model::Scene;
use crate::scene::surface::{Footprint, normal_at, surface_at};
use crate::scene::texture::DecodedImages;
use crate::task::{Progress, TaskError};
use crate::unwrap::{Unwrap, UnwrapBlock, UnwrappedTriangle};

/// Mean free path in texels below which another point of the texel is looked for. The foot of a wall that a texel's
/// middle just misses has about this.
const OPENNESS_MIN: f32 = 0.5;
/// How much more open another point must be to stand for the texel.
const OPENNESS_GAIN_MIN: f32 = 1.5;
/// Cosine between faces from which on a texel bends: where a narrow edge has parts that look into a gap and parts that
/// look out of it, those that look out are what is seen of the texel.
const BENT_COSINE_MAX: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// What the openness of a point off the surface counts for: a point on it is looked for and taken if it is open too.
const LIFTED_WORTH: f32 = 0.3;

/// Share of rays to back faces from which on a point is beyond the walls of what is seen: the foot of a wall that reaches
/// through the floor.
const BEYOND_SHARE_MIN: f32 = 0.125;

/// Sides of an instance that have receivers.
fn sides(scene: &Scene, instance: usize) -> u32 {
    if scene.materials[scene.instances[instance].material_index as usize].double_sided { 2 } else { 1 }
}

/// Index of each instance's first block.
pub fn first_blocks(scene: &Scene, unwraps: &[Unwrap]) -> Vec<u32> {
    let mut next = 0;
    let mut first = Vec::with_capacity(unwraps.len());
    for (instance, unwrap) in unwraps.iter().enumerate() {
        first.push(next);
        next += unwrap.blocks.len() as u32 * sides(scene, instance);
    }
    first
}

/// Empty blocks of all instances: part by part, front before back.
pub fn blocks(scene: &Scene, unwraps: &[Unwrap]) -> Result<Vec<StageBlock>, TaskError> {
    let mut blocks = Vec::new();
    let mut keys = BTreeSet::new();
    for (instance, unwrap) in unwraps.iter().enumerate() {
        for (part, block) in unwrap.blocks.iter().enumerate() {
            for side in ["front", "back"].into_iter().take(sides(scene, instance) as usize) {
                let name = format!("{} · part {part} · {side}", scene.instances[instance].path);
                let key = Digest::of(name.as_bytes()).short();
                if !keys.insert(key) {
                    return Err(TaskError::bad_input(format!(
                        "two blocks have the same identity ('{name}'): rename a node of the scene"
                    )));
                }
                let size = [block.width, block.height];
                blocks.push(StageBlock {
                    key,
                    name,
                    size,
                    instance: instance as u32,
                    receiver_of_texel: Vec::new(),
                });
            }
        }
    }
    Ok(blocks)
}

/// Receivers of all blocks in order; fills in each block's table.
#[allow(
    clippy::too_many_arguments,
    reason = "one call, from prepare, with the parts of a world not yet whole"
)]
pub fn place(
    scene: &Scene,
    images: &DecodedImages,
    geometry: &Geometry,
    unwraps: &[Unwrap],
    blocks: &mut [StageBlock],
    settings: &Settings,
    texel_m: f32,
    progress: &Progress,
) -> Result<Vec<Receiver>, TaskError> {
    let shifter = Shifter::new(scene, geometry, settings, texel_m);
    let parts: Vec<(usize, usize)> = unwraps
        .iter()
        .enumerate()
        .flat_map(|(instance, unwrap)| (0..unwrap.blocks.len()).map(move |part| (instance, part)))
        .collect();
    progress.begin(0.3, 0.6, parts.len() as u64);
    let mut placed = Vec::new();
    let mut block_index = 0;
    for (instance, part) in parts {
        progress.check()?;
        let block = &unwraps[instance].blocks[part];
        let maker = Maker { scene, images, instance, texel_m };
        let found = cover(block, |triangle| maker.face_normal(triangle));
        for side in 0..sides(scene, instance) {
            let key = blocks[block_index as usize].key;
            let stand = |texel: &CoveredTexel| {
                let front = Receiver { block: block_index, ..maker.receiver(texel) };
                shifter.shifted(if side == 0 { front } else { turned(&front) }, key)
            };
            let mut coverage = found.clone();
            let mut standing: Vec<Option<Standing>> = coverage.covered.par_iter().map(stand).collect();
            open_up(
                block,
                &coverage.covered,
                &mut standing,
                |texel| maker.face_normal(texel.triangle),
                stand,
            );
            set_apart(block, &mut coverage, &mut standing, |a, b| shifter.is_parted(a, b), stand);
            let areas = areas(block, &coverage, |triangle| maker.area_texels(triangle));
            progress.add_rays_closest(shifter.take_rays());
            blocks[block_index as usize].receiver_of_texel =
                number(&coverage, &standing, &areas, &mut placed);
            block_index += 1;
        }
        progress.advance(1);
    }
    Ok(placed)
}

/// Lets another point stand for each texel whose own is in a crevice, or in a solid, or was lifted onto one: texels on a
/// rim often have their middle under what lies on the surface, while only the rim is seen. Where a texel bends, a point
/// that is less closed than that gives way too, to one that looks elsewhere.
fn open_up(
    block: &UnwrapBlock,
    covered: &[CoveredTexel],
    standing: &mut [Option<Standing>],
    face_normal: impl Fn(&CoveredTexel) -> Vec3 + Sync,
    stand: impl Fn(&CoveredTexel) -> Option<Standing> + Sync,
) {
    let may_gain = |index: &usize| openness(&standing[*index]) * OPENNESS_GAIN_MIN < 1.0;
    let closed: Vec<usize> = (0..covered.len()).filter(may_gain).collect();
    let wanted: Vec<CoveredTexel> = closed.iter().map(|&index| covered[index]).collect();
    let better: Vec<Option<Standing>> = alternatives(block, &wanted)
        .par_iter()
        .zip(&closed)
        .map(|(points, &index)| {
            let is_crevice = openness(&standing[index]) < OPENNESS_MIN;
            let own = face_normal(&covered[index]);
            let bends = |point: &&CoveredTexel| is_crevice || face_normal(point).dot(own) < BENT_COSINE_MAX;
            let all = points.iter().filter(bends).filter_map(&stand);
            // Of equally open points the first: the result does not hang on the order of threads.
            all.reduce(|best, other| if worth(&other) > worth(&best) { other } else { best })
        })
        .collect();
    for (&index, better) in closed.iter().zip(&better) {
        if openness(better) > OPENNESS_MIN.max(OPENNESS_GAIN_MIN * openness(&standing[index])) {
            standing[index] = *better;
        }
    }
}

/// Gives a texel that its chart only touches a receiver of its own where an open part of it is beyond a wall from what
/// stands for it: the bevel of a rail, when all of the rail's texels beside it lie in a hollow pier.
fn set_apart(
    block: &UnwrapBlock,
    coverage: &mut Coverage,
    standing: &mut Vec<Option<Standing>>,
    is_parted: impl Fn(&Receiver, &Receiver) -> bool + Sync,
    stand: impl Fn(&CoveredTexel) -> Option<Standing> + Sync,
) {
    let apart = |parts: &[CoveredTexel]| {
        let place = Coverage::place(parts[0].texel, block.width);
        let other = standing[coverage.stands_for[place] as usize].as_ref();
        let is_apart = |own: &Standing| {
            // What was moved is beyond a wall in any case.
            let is_seen = own.openness > OPENNESS_MIN && own.back_share < BEYOND_SHARE_MIN && !own.is_moved;
            is_seen && other.is_none_or(|other| is_parted(&own.receiver, &other.receiver))
        };
        let all = parts.iter().filter_map(|part| Some((*part, stand(part).filter(is_apart)?)));
        // Of equally open parts the first.
        let best = all.reduce(|best, next| if next.1.openness > best.1.openness { next } else { best })?;
        Some((best.0, Some(best.1)))
    };
    let texels: Vec<&[CoveredTexel]> = coverage.touched.chunk_by(|a, b| a.texel == b.texel).collect();
    let (texels, own): (Vec<CoveredTexel>, Vec<Option<Standing>>) =
        texels.par_iter().filter_map(|parts| apart(parts)).unzip();
    if !texels.is_empty() {
        coverage.set_apart(&texels, &own, standing, block.width);
    }
}

fn worth(standing: &Standing) -> f32 {
    standing.openness * if standing.is_lifted { LIFTED_WORTH } else { 1.0 }
}

fn openness(standing: &Option<Standing>) -> f32 {
    standing.as_ref().map_or(0.0, worth)
}

/// Appends the valid receivers and gives the block's table of them.
fn number(
    coverage: &Coverage,
    standing: &[Option<Standing>],
    areas: &[f32],
    placed: &mut Vec<Receiver>,
) -> Vec<u32> {
    let mut index_of = vec![NO_RECEIVER; standing.len()];
    for ((slot, standing), area) in index_of.iter_mut().zip(standing).zip(areas) {
        if let Some(standing) = standing {
            *slot = placed.len() as u32;
            placed.push(Receiver { area: AreaCode::of(*area), ..standing.receiver });
        }
    }
    let stand_in = |&covered: &u32| index_of.get(covered as usize).copied().unwrap_or(NO_RECEIVER);
    coverage.stands_for.iter().map(stand_in).collect()
}

/// The same texel seen from the back.
fn turned(front: &Receiver) -> Receiver {
    Receiver { normal: -front.normal, face_normal: -front.face_normal, ..*front }
}

struct Maker<'a> {
    scene: &'a Scene,
    images: &'a DecodedImages,
    instance: usize,
    texel_m: f32,
}

impl Maker<'_> {
    /// World area of a triangle, or of the piece of it that lies in the block, in texels.
    fn area_texels(&self, triangle: &UnwrappedTriangle) -> f32 {
        let reference = TriangleRef { instance: self.instance as u32, triangle: triangle.source_triangle };
        let source = corners_of(self.scene, reference);
        let corner = |weights: &Vec3| source[0] * weights.x + source[1] * weights.y + source[2] * weights.z;
        let [a, b, c] =
            triangle.piece_corners.as_deref().map_or(source, |piece| piece.each_ref().map(corner));
        0.5 * (b - a).cross(c - a).length() / (self.texel_m * self.texel_m)
    }

    /// Normal of a triangle's front.
    fn face_normal(&self, triangle: u32) -> Vec3 {
        let reference = TriangleRef { instance: self.instance as u32, triangle };
        let [a, b, c] = corners_of(self.scene, reference);
        (b - a).cross(c - a).normalize_or(Vec3::Y)
    }

    /// The front's receiver of a texel; its block is filled in later.
    fn receiver(&self, covered: &CoveredTexel) -> Receiver {
        let instance = &self.scene.instances[self.instance];
        let triangle = covered.triangle as usize;
        let reference = TriangleRef { instance: self.instance as u32, triangle: covered.triangle };
        let [a, b, c] = corners_of(self.scene, reference);
        let [wa, wb, wc] = covered.weights;
        let face_normal = self.face_normal(covered.triangle);
        let shading = normal_at(instance, triangle, covered.weights);
        let footprint = Footprint::square(instance, triangle, self.texel_m);
        let surface =
            surface_at(self.scene, self.images, self.instance, triangle, covered.weights, &footprint);
        Receiver {
            block: 0,
            texel: covered.texel,
            position_m: a * wa + b * wb + c * wc,
            // A shading normal that points through the surface is a fault of the file.
            normal: if shading.dot(face_normal) > 0.05 { shading } else { face_normal },
            face_normal,
            albedo: surface.albedo,
            emission: surface.emission,
            links: 0,
            area: AreaCode::ONE,
        }
    }
}
