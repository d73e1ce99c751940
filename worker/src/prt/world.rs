//! The world that rays are cast in: the scene's triangles, and what stands for each point of them.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use lightkiln_proto::prt::BlockKey;
use rayon::prelude::*;

use crate::prt::stage::{CAVITY, Stage};
use crate::prt::transport::EmitterSet;
use crate::rays::{AlphaTest, Hit, Tracer};
use crate::scene::model::Scene;
use crate::scene::texture::DecodedImages;
use crate::unwrap::{UnwrappedTriangle, weights_in_part};

/// A triangle of the scene by instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriangleRef {
    /// Index into [`Scene::instances`].
    pub instance: u32,
    /// Index into the instance's triangles.
    pub triangle: u32,
}

/// The scene's triangles, numbered through all instances, ready for rays.
pub struct Geometry {
    /// Rays against them.
    pub tracer: Tracer,
    /// Where each triangle comes from.
    pub triangles: Vec<TriangleRef>,
}

/// How far points are raised at most before they are tested for a wall between them, in metres: above the bulge of
/// curved surfaces, below anything that one would call a wall.
pub fn link_height_m(texel_m: f32) -> f32 {
    texel_m * 0.25
}

impl Geometry {
    /// Gathers triangles and builds the tree.
    pub fn new(scene: &Scene, images: &Arc<DecodedImages>) -> Self {
        let mut triangles = Vec::new();
        let mut corners = Vec::new();
        for (instance_index, instance) in scene.instances.iter().enumerate() {
            for (triangle_index, triangle) in instance.triangles.iter().enumerate() {
                triangles
                    .push(TriangleRef { instance: instance_index as u32, triangle: triangle_index as u32 });
                corners.push(triangle.map(|vertex| instance.positions_m[vertex as usize]));
            }
        }
        let alpha = Masks::alpha_test(scene, images, &triangles);
        Self { tracer: Tracer::new(&corners, alpha), triangles }
    }

    /// A point of a surface raised along its normal by at most `height_m`, to be tested for walls between it and others:
    /// half way to what stands above it at most, as a gap may be narrower.
    pub fn raised(&self, point_m: Vec3, normal: Vec3, height_m: f32) -> Vec3 {
        let foot_m = point_m + normal * self.tracer.ray_offset_m();
        let free_m = self.tracer.closest(foot_m, normal, 2.0 * height_m).map_or(height_m, |hit| 0.5 * hit.t);
        foot_m + normal * free_m
    }

    /// Unit normal of a triangle's front.
    pub fn face_normal(&self, scene: &Scene, triangle: TriangleRef) -> Vec3 {
        let [a, b, c] = corners_of(scene, triangle);
        (b - a).cross(c - a).normalize_or(Vec3::Y)
    }
}

/// Corners of a triangle in metres.
pub fn corners_of(scene: &Scene, triangle: TriangleRef) -> [Vec3; 3] {
    let instance = &scene.instances[triangle.instance as usize];
    instance.triangles[triangle.triangle as usize].map(|vertex| instance.positions_m[vertex as usize])
}

/// Alpha-masked triangles with what their test reads.
struct Masks {
    /// Per triangle: index into `masked`, or none.
    index: Vec<u32>,
    masked: Vec<MaskedTriangle>,
    images: Arc<DecodedImages>,
    uses: Vec<crate::scene::model::TextureUse>,
}

struct MaskedTriangle {
    texture: u32,
    uv: [Vec2; 3],
    factor: [f32; 3],
    cutoff: f32,
}

impl Masks {
    /// The test of a scene's masked triangles; `None` when it has none.
    fn alpha_test(
        scene: &Scene,
        images: &Arc<DecodedImages>,
        triangles: &[TriangleRef],
    ) -> Option<Box<dyn AlphaTest>> {
        let mut masks =
            Self { index: Vec::new(), masked: Vec::new(), images: Arc::clone(images), uses: Vec::new() };
        let mut texture_of_material = vec![u32::MAX; scene.materials.len()];
        for (index, material) in scene.materials.iter().enumerate() {
            if let (Some(_), Some(texture)) = (material.alpha_cutoff, &material.base_colour_texture) {
                texture_of_material[index] = masks.uses.len() as u32;
                masks.uses.push(texture.clone());
            }
        }
        masks.index =
            triangles.iter().map(|&triangle| masks.push(scene, &texture_of_material, triangle)).collect();
        if masks.masked.is_empty() { None } else { Some(Box::new(masks)) }
    }

    /// Adds a triangle if its material is masked; gives its index or `u32::MAX`.
    fn push(&mut self, scene: &Scene, texture_of_material: &[u32], triangle: TriangleRef) -> u32 {
        let instance = &scene.instances[triangle.instance as usize];
        let material = &scene.materials[instance.material_index as usize];
        let Some(cutoff) = material.alpha_cutoff else { return u32::MAX };
        let texture = texture_of_material[instance.material_index as usize];
        let vertices = instance.triangles[triangle.triangle as usize];
        let uv_set = material.base_colour_texture.as_ref().map_or(0, |texture| texture.uv_set);
        let uvs = if uv_set == 0 { &instance.uv0 } else { &instance.uv1 };
        let uv = vertices.map(|vertex| uvs.get(vertex as usize).copied().unwrap_or_default());
        let colour = |vertex: u32| instance.colours.get(vertex as usize).map_or(1.0, |colour| colour[3]);
        let factor = vertices.map(|vertex| material.base_colour[3] * colour(vertex));
        self.masked.push(MaskedTriangle { texture, uv, factor, cutoff });
        self.masked.len() as u32 - 1
    }
}

impl AlphaTest for Masks {
    fn is_masked(&self, triangle: u32) -> bool {
        self.index[triangle as usize] != u32::MAX
    }

    fn is_solid(&self, triangle: u32, barycentric: [f32; 2]) -> bool {
        let Some(masked) = self.masked.get(self.index[triangle as usize] as usize) else { return true };
        let weights = weights_of(barycentric);
        let factor =
            masked.factor[0] * weights.x + masked.factor[1] * weights.y + masked.factor[2] * weights.z;
        let uv = masked.uv[0] * weights.x + masked.uv[1] * weights.y + masked.uv[2] * weights.z;
        let texture = self.uses.get(masked.texture as usize);
        let alpha = texture.map_or(1.0, |texture| self.images.sample_bilinear(texture, uv.to_array())[3]);
        alpha * factor >= masked.cutoff
    }
}

/// Weights of all three corners from those of corners 1 and 2.
pub fn weights_of([b1, b2]: [f32; 2]) -> Vec3 {
    Vec3::new(1.0 - b1 - b2, b1, b2)
}

/// Rings of texels around a hit's own in which one is looked for that no wall separates from it.
const LINKED_RINGS: i32 = 2;

/// What a ray meets, as transport sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// A lit surface, read at its receiver.
    Receiver(u32),
    /// The back of a single-sided surface, or a surface too small for a texel: blocks light, returns none.
    Dark,
}

/// Scene, stage and geometry together: what relight and transport tasks work in.
pub struct World {
    /// Imported scene.
    pub scene: Scene,
    /// Receivers, probes, clusters.
    pub stage: Stage,
    /// Decoded images.
    pub images: Arc<DecodedImages>,
    /// Triangles ready for rays.
    pub geometry: Geometry,
    /// Emissive triangles.
    pub emitters: EmitterSet,
    texels: TexelTable,
    /// Points of receivers, raised, see [`World::raised_receiver`].
    raised_m: Vec<Vec3>,
}

impl World {
    /// Builds the tree and the texel table.
    pub fn new(scene: Scene, stage: Stage, images: Arc<DecodedImages>) -> Self {
        let geometry = Geometry::new(&scene, &images);
        Self::with_geometry(scene, stage, images, geometry)
    }

    /// As [`World::new`] with a tree that is there already.
    pub fn with_geometry(scene: Scene, stage: Stage, images: Arc<DecodedImages>, geometry: Geometry) -> Self {
        let texels = TexelTable::new(&scene, &stage);
        let emitters = EmitterSet::new(&scene, &images, &geometry);
        let mut world = Self { scene, stage, images, geometry, emitters, texels, raised_m: Vec::new() };
        let (receivers, height_m) = (&world.stage.receivers, world.link_height_m());
        world.raised_m =
            receivers.par_iter().map(|r| world.raised(r.position_m, r.face_normal, height_m)).collect();
        world
    }

    /// Material of the instance that a triangle belongs to.
    pub fn material(&self, triangle: u32) -> &crate::scene::model::Material {
        let instance = self.geometry.triangles[triangle as usize].instance;
        &self.scene.materials[self.scene.instances[instance as usize].material_index as usize]
    }

    /// The back of a single-sided surface was met.
    pub fn is_back(&self, hit: &Hit) -> bool {
        !hit.front && !self.material(hit.triangle).double_sided
    }

    /// What stands for a hit (METHOD.md §1 "Materials and sides").
    pub fn surface_at(&self, hit: &Hit) -> Surface {
        let Some((block, texel)) = self.block_at(hit) else { return Surface::Dark };
        self.receiver_near(block, texel).map_or(Surface::Dark, Surface::Receiver)
    }

    /// The texel of a hit has no receiver, as it lies in a cavity that nothing in the open sees.
    pub fn is_in_cavity(&self, hit: &Hit) -> bool {
        self.block_at(hit).is_some_and(|(block, texel)| {
            let block = &self.stage.blocks[block as usize];
            let [x, y] = texel.max(Vec2::ZERO).as_uvec2().to_array();
            let index = y.min(block.size[1] - 1) * block.size[0] + x.min(block.size[0] - 1);
            block.receiver_of_texel[index as usize] == CAVITY
        })
    }

    /// Albedo, without its texture, of what was met in a cavity: what it reflects is lost.
    pub fn lost_in_cavity(&self, hit: &Hit) -> f32 {
        let [r, g, b, _] = self.material(hit.triangle).base_colour;
        if self.is_in_cavity(hit) { (r + g + b) / 3.0 } else { 0.0 }
    }

    /// Lets another point of its surface stand for a receiver.
    pub fn move_receiver(&mut self, receiver: u32, position_m: Vec3) {
        let moved = &mut self.stage.receivers[receiver as usize];
        moved.position_m = position_m;
        let normal = moved.face_normal;
        self.raised_m[receiver as usize] = self.raised(position_m, normal, self.link_height_m());
    }

    /// Leaves out receivers: those that are not to be kept were found to be in cavities.
    pub fn retain_receivers(&mut self, kept: &[bool]) {
        let mut next = 0;
        let renumbered: Vec<u32> = kept
            .iter()
            .map(|&kept| {
                next += u32::from(kept);
                if kept { next - 1 } else { CAVITY }
            })
            .collect();
        for slot in self.stage.blocks.iter_mut().flat_map(|block| &mut block.receiver_of_texel) {
            *slot = renumbered.get(*slot as usize).copied().unwrap_or(*slot);
        }
        let is_kept = |index: &mut usize| {
            *index += 1;
            kept[*index - 1]
        };
        let (mut receiver, mut raised) = (0, 0);
        self.stage.receivers.retain(|_| is_kept(&mut receiver));
        self.raised_m.retain(|_| is_kept(&mut raised));
    }

    /// Key of the block of a hit, and the place in it in texels; `None` on backs of single-sided surfaces.
    pub fn lightmap_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)> {
        let (block, texel) = self.block_at(hit)?;
        Some((self.stage.blocks[block as usize].key, texel))
    }

    fn block_at(&self, hit: &Hit) -> Option<(u32, Vec2)> {
        let double_sided = self.material(hit.triangle).double_sided;
        if !hit.front && !double_sided {
            return None;
        }
        let (part, texel) = self.texels.locate(hit.triangle, weights_of(hit.barycentric))?;
        let instance = self.geometry.triangles[hit.triangle as usize].instance;
        let sides = if double_sided { 2 } else { 1 };
        Some((self.stage.first_block[instance as usize] + part * sides + u32::from(!hit.front), texel))
    }

    /// Unit normal of the side that a ray of `direction` met.
    pub fn side_normal(&self, hit: &Hit) -> Vec3 {
        let normal = self.geometry.face_normal(&self.scene, self.geometry.triangles[hit.triangle as usize]);
        if hit.front { normal } else { -normal }
    }

    /// As [`World::surface_at`], but of the receivers around the hit, the nearest that no wall separates from it: a
    /// texel that a wall cuts in two stands for its centre's side only.
    pub fn linked_surface_at(&self, hit: &Hit, point_m: Vec3) -> Surface {
        let Surface::Receiver(own) = self.surface_at(hit) else { return Surface::Dark };
        let from_m = self.raised(point_m, self.side_normal(hit), self.link_height_m());
        let linked = |receiver: u32| self.is_linked(from_m, self.raised_m[receiver as usize]);
        if linked(own) {
            return Surface::Receiver(own);
        }
        let receiver = &self.stage.receivers[own as usize];
        let [x, y] = receiver.texel.map(i32::from);
        let ring = |radius: i32| {
            let side = 2 * radius + 1;
            (0..side * side)
                .map(move |i| [i % side - radius, i / side - radius])
                .filter(move |offset| offset[0].abs().max(offset[1].abs()) == radius)
        };
        let distance = |index: u32| self.stage.receivers[index as usize].position_m.distance_squared(point_m);
        let nearest = |radius: i32| {
            ring(radius)
                .filter_map(|[dx, dy]| self.receiver_on(receiver.block, x + dx, y + dy))
                .filter(|&index| linked(index))
                .min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)))
        };
        (1..=LINKED_RINGS).find_map(nearest).map_or(Surface::Dark, Surface::Receiver)
    }

    /// As [`Geometry::raised`].
    pub fn raised(&self, point_m: Vec3, normal: Vec3, height_m: f32) -> Vec3 {
        self.geometry.raised(point_m, normal, height_m)
    }

    /// As [`World::raised`] by [`World::link_height_m`], of a receiver.
    pub fn raised_receiver(&self, receiver: u32) -> Vec3 {
        self.raised_m[receiver as usize]
    }

    /// As [`link_height_m`], for the texels of this world.
    pub fn link_height_m(&self) -> f32 {
        link_height_m(self.stage.texel_m)
    }

    /// No wall stands between two raised points.
    pub fn is_linked(&self, from_m: Vec3, to_m: Vec3) -> bool {
        !self.geometry.tracer.is_occluded(from_m, to_m)
    }

    /// The receiver whose own texel this is, if any.
    pub fn receiver_on(&self, block: u32, x: i32, y: i32) -> Option<u32> {
        let size = self.stage.blocks[block as usize].size.map(|side| side as i32);
        if x < 0 || y < 0 || x >= size[0] || y >= size[1] {
            return None;
        }
        let index = self.stage.blocks[block as usize].receiver_of_texel[(y * size[0] + x) as usize];
        let receiver = self.stage.receivers.get(index as usize)?;
        (receiver.texel.map(i32::from) == [x, y]).then_some(index)
    }

    /// Receiver of a texel, or of the nearest of its eight neighbours: rounding may step over a chart's rim.
    fn receiver_near(&self, block: u32, texel: Vec2) -> Option<u32> {
        let block = &self.stage.blocks[block as usize];
        let (x, y) = (texel.x.floor() as i64, texel.y.floor() as i64);
        let at = |x: i64, y: i64| {
            let inside = x >= 0 && y >= 0 && x < i64::from(block.size[0]) && y < i64::from(block.size[1]);
            inside.then(|| block.receiver_of_texel[(y * i64::from(block.size[0]) + x) as usize])
        };
        const RING: [(i64, i64); 9] =
            [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];
        RING.iter().filter_map(|(dx, dy)| at(x + dx, y + dy)).find(|&found| found < CAVITY)
    }
}

/// Where each triangle lies in its instance's unwrap.
struct TexelTable {
    /// First entry of each triangle, and the end.
    starts: Vec<u32>,
    entries: Vec<TexelPart>,
}

struct TexelPart {
    part: u32,
    triangle: UnwrappedTriangle,
}

impl TexelTable {
    fn new(scene: &Scene, stage: &Stage) -> Self {
        let mut by_triangle = Vec::new();
        let mut first_triangle = 0_u32;
        for (instance, unwrap) in scene.instances.iter().zip(&stage.unwraps) {
            for (part, block) in unwrap.blocks.iter().enumerate() {
                for triangle in &block.triangles {
                    let entry = TexelPart { part: part as u32, triangle: triangle.clone() };
                    by_triangle.push((first_triangle + triangle.source_triangle, entry));
                }
            }
            first_triangle += instance.triangles.len() as u32;
        }
        by_triangle.sort_by_key(|(triangle, _)| *triangle);
        let mut starts = vec![0_u32; first_triangle as usize + 1];
        for (triangle, _) in &by_triangle {
            starts[*triangle as usize + 1] += 1;
        }
        for index in 1..starts.len() {
            starts[index] += starts[index - 1];
        }
        Self { starts, entries: by_triangle.into_iter().map(|(_, entry)| entry).collect() }
    }

    /// Part and place in texels of a point of a triangle; of a triangle cut in pieces, the piece that holds it.
    fn locate(&self, triangle: u32, weights: Vec3) -> Option<(u32, Vec2)> {
        let range = self.starts[triangle as usize] as usize..self.starts[triangle as usize + 1] as usize;
        let pieces = self.entries[range].iter().map(|entry| {
            let inner = weights_in_part(&entry.triangle, weights);
            (inner.min_element(), entry, inner)
        });
        let (_, entry, inner) = pieces.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let [a, b, c] = entry.triangle.uv_texels;
        Some((entry.part, a * inner.x + b * inner.y + c * inner.z))
    }
}
