//! The world that kinds of bake cast rays in: geometry, and the receiver that stands for each point of it.

use std::sync::{Arc, OnceLock};

use glam::{Vec2, Vec3};
use lightkiln_proto::content::{BlockKey, COVERAGE_POINTS, COVERAGE_SIDE, LINKS};

use super::clearance::{Axis, Clearance};
use super::place::seen;
use super::raised::Raised;
use super::texel_points::TexelTriangles;
use super::texel_table::TexelTable;
use super::{CAVITY, Charts, Lightmap, Receiver, Tiles};
use crate::geometry::{Geometry, Site, weights_of};
use crate::rays::{Hit, linking};
use crate::task::{Context, LocalRun, Progress, TaskError};
use crate::unwrap::UnwrappedTriangle;

/// How far points are raised at most before they are tested for a wall between them, in metres: above the bulge of
/// curved surfaces, below anything that one would call a wall.
pub fn link_height_m(texel_m: f32) -> f32 {
    texel_m * 0.25
}

/// Coverage of a texel that no wall cuts: all of its points are on its receiver's side.
const WHOLE: u16 = u16::MAX;
/// Rings of texels around a hit's own in which one is looked for that no wall separates from it.
pub(super) const LINKED_RINGS: i32 = 2;

/// Hits on a receiver's texel that ask for no wall.
enum OpenAbout {
    /// All of them, see [`World::is_whole_about`].
    All,
    /// Those that lie in the room.
    Room(Clearance),
}

/// Surface that a ray meets, as transport reads it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// A lit surface, read at its receiver.
    Receiver(u32),
    /// The back of a single-sided surface, or a surface too small for a texel: blocks light, returns none.
    Dark,
}

/// A hit, and what stands for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Block of the hit, and its place there in texels; `None` on backs of single-sided surfaces.
    pub place: Option<(u32, Vec2)>,
    /// As [`World::surface_at`] has it.
    pub own: Surface,
    /// Of the receivers around the hit, the nearest that no wall separates from it.
    pub linked: Surface,
    /// As [`World::linked_surface_at`] has it.
    pub read: Surface,
    /// The hit's own texel says which receiver is read, not one beside it.
    pub(super) is_on_texel: bool,
}

/// A scene with its lightmap: rays tell which receiver stands for the surface that they hit. Whole from the start, and
/// never changed.
pub struct World {
    /// Triangles ready for rays.
    pub geometry: Arc<Geometry>,
    /// Blocks and receivers.
    pub lightmap: Lightmap,
    texels: TexelTable,
    /// Of each receiver what every hit on it reads.
    pub(super) raised: Vec<Raised>,
    /// Receivers whose light others take, each with one that takes it and has points of its own; ascending.
    sharers: Vec<[u32; 2]>,
    /// Of each receiver which hits on its texel ask for no wall. Found one by one when first asked for, and without other
    /// threads: whoever asks may be one of many that this one would take work from.
    open_about: Vec<OnceLock<OpenAbout>>,
    /// Tiles of all blocks.
    pub tiles: Tiles,
    /// Triangles of each receiver's texel, found when they are first asked for.
    texel_triangles: OnceLock<TexelTriangles>,
}

impl World {
    /// Inputs that a world is made of.
    const PARTS: [&'static str; 3] = [crate::scene::ARTEFACT, super::charts::ARTEFACT, super::ARTEFACT];

    /// Indices of all receivers.
    pub fn all_receivers(&self) -> Vec<u32> {
        (0..self.lightmap.receivers.len() as u32).collect()
    }

    /// Builds the table of texels and raises the receivers' points.
    pub fn new(geometry: Arc<Geometry>, charts: &Charts, lightmap: Lightmap, progress: &Progress) -> Self {
        let texels = TexelTable::new(&geometry.scene, charts);
        let receivers = &lightmap.receivers;
        let raised = Raised::of_all(&geometry, &lightmap, progress);
        let with_points = |&[lender, own]: &[u32; 2]| lender != own && receivers[own as usize].coverage != 0;
        let mut sharers: Vec<[u32; 2]> =
            receivers.iter().zip(0..).map(|(own, index)| [own.light_of, index]).filter(with_points).collect();
        sharers.sort_unstable();
        let open_about = receivers.iter().map(|_| OnceLock::new()).collect();
        let texel_triangles = OnceLock::new();
        let tiles = Tiles::of(&lightmap);
        Self { geometry, lightmap, texels, raised, sharers, open_about, tiles, texel_triangles }
    }

    /// A receiver's texel is whole, as are its eight neighbours, and all are linked to it: a wall that reaches between the
    /// points that tell so is met in a neighbour, unless it stands free and is narrower than they are apart.
    fn is_whole_about(&self, receiver: u32) -> bool {
        let Receiver { block, texel, coverage, links, .. } = self.lightmap.receivers[receiver as usize];
        let [x, y] = texel.map(i32::from);
        coverage == WHOLE
            && LINKS.into_iter().enumerate().all(|(bit, [dx, dy])| {
                let is_linked = |links: u8| links >> bit & 1 == 1;
                let [after, before] = [1, -1].map(|step| {
                    let other = self.receiver_on(block, x + step * dx, y + step * dy)?;
                    let other = &self.lightmap.receivers[other as usize];
                    (other.coverage == WHOLE).then_some(other.links)
                });
                is_linked(links) && after.is_some() && before.is_some_and(is_linked)
            })
    }

    /// The lightmap alone.
    pub fn into_lightmap(self) -> Lightmap {
        self.lightmap
    }

    /// World of the last scene, charts and lightmap that tasks of a local run gave.
    pub fn of_run(run: &LocalRun) -> Result<Arc<Self>, TaskError> {
        Self::of(&run.context(&run.scene_inputs(&Self::PARTS)))
    }

    /// World of the scene, charts and lightmap among a task's inputs, built once per worker.
    pub fn of(context: &Context) -> Result<Arc<Self>, TaskError> {
        let geometry = Geometry::of(context)?;
        // Other scenes may have an equal lightmap: an alpha cutoff, or a sliver too small for receivers, is not in it.
        let key = context.digest_of_all(&Self::PARTS)?;
        context.memory.get_or_insert(key, || {
            let charts = Charts::of(context)?;
            let (lightmap, bytes): (Lightmap, _) = context.decoded(super::ARTEFACT_MAGIC, super::ARTEFACT)?;
            let receivers = lightmap.receivers.len();
            Ok((Self::new(geometry, &charts, lightmap, context.progress), 2 * bytes + 140 * receivers))
        })
    }

    /// Receiver that stands for a hit (METHOD.md §1 "Materials and sides").
    pub fn surface_at(&self, hit: &Hit) -> Surface {
        let Some((block, texel)) = self.block_at(hit) else { return Surface::Dark };
        self.receiver_near(block, texel).map_or(Surface::Dark, |(receiver, _)| Surface::Receiver(receiver))
    }

    /// The texel of a hit has no receiver, as it lies in a cavity that nothing in the open sees.
    pub fn is_in_cavity(&self, hit: &Hit) -> bool {
        self.block_at(hit).is_some_and(|(block, texel)| {
            let block = &self.lightmap.blocks[block as usize];
            let [x, y] = texel.max(Vec2::ZERO).as_uvec2().to_array();
            let index = y.min(block.size[1] - 1) * block.size[0] + x.min(block.size[0] - 1);
            block.receiver_of_texel[index as usize] == CAVITY
        })
    }

    /// Albedo, without its texture, of a hit in a cavity, whose reflected light is lost; 0 of any other hit.
    pub fn lost_in_cavity(&self, hit: &Hit) -> f32 {
        let [r, g, b, _] = self.geometry.material(hit.triangle).base_colour;
        if self.is_in_cavity(hit) { (r + g + b) / 3.0 } else { 0.0 }
    }

    /// Key of the block of a hit, and the place in it in texels; `None` on backs of single-sided surfaces.
    pub fn lightmap_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)> {
        let (block, texel) = self.block_at(hit)?;
        Some((self.lightmap.blocks[block as usize].key, texel))
    }

    /// Where a triangle of the scene, or each piece of it, lies in its instance's unwrap.
    pub fn pieces_of(&self, triangle: u32) -> impl Iterator<Item = (u32, &UnwrappedTriangle)> {
        self.texels.pieces_of(triangle).iter().map(|entry| (entry.part, &entry.triangle))
    }

    fn block_at(&self, hit: &Hit) -> Option<(u32, Vec2)> {
        let double_sided = self.geometry.material(hit.triangle).double_sided;
        if !hit.front && !double_sided {
            return None;
        }
        let (part, texel) = self.texels.locate(hit.triangle, weights_of(hit.barycentric))?;
        let instance = self.geometry.triangles[hit.triangle as usize].instance;
        let sides = if double_sided { 2 } else { 1 };
        Some((self.lightmap.first_block[instance as usize] + part * sides + u32::from(!hit.front), texel))
    }

    /// As [`World::surface_at`], but of the receivers around the hit, the nearest that no wall separates from it: a
    /// texel that a wall cuts in two stands for its centre's side only. Where no wall can be, none is looked for. Where glass
    /// alone parts the hit from all of them, it is read by the share of rays that pass the glass: so much of the light on
    /// one side of a pane is on the other.
    pub fn linked_surface_at(&self, hit: &Hit, point_m: Vec3) -> Surface {
        self.found_at(hit, point_m).read
    }

    /// All about a hit.
    pub fn found_at(&self, hit: &Hit, point_m: Vec3) -> Found {
        let place = self.block_at(hit);
        let own = place.and_then(|(block, texel)| self.receiver_near(block, texel));
        let Some((own, is_on_texel)) = own else {
            let [own, linked, read] = [Surface::Dark; 3];
            return Found { place, own, linked, read, is_on_texel: false };
        };
        let [linked, read] = if self.is_open_to(own, hit, point_m) {
            [Surface::Receiver(own); 2]
        } else {
            linking(|| self.linked_around(hit, point_m, own))
        };
        Found { place, own: Surface::Receiver(own), linked, read, is_on_texel }
    }

    /// It is known beforehand that no wall separates a hit from the receiver of its texel.
    fn is_open_to(&self, own: u32, hit: &Hit, point_m: Vec3) -> bool {
        match self.open_about[own as usize].get_or_init(|| self.find_open_about(own)) {
            OpenAbout::All => true,
            OpenAbout::Room(room) => {
                let normal = self.geometry.side_normal(hit);
                room.holds(&self.axis_of(own), self.geometry.lifted(point_m, normal), normal)
            }
        }
    }

    fn find_open_about(&self, receiver: u32) -> OpenAbout {
        if self.is_whole_about(receiver) {
            return OpenAbout::All;
        }
        OpenAbout::Room(Clearance::of(&self.geometry.tracer, &self.axis_of(receiver)))
    }

    /// Where the room above a receiver's texel is.
    fn axis_of(&self, receiver: u32) -> Axis {
        let Receiver { position_m, face_normal, .. } = self.lightmap.receivers[receiver as usize];
        let Raised { at_m: raised_m, texel_m, .. } = self.raised[receiver as usize];
        Axis {
            raised_m,
            normal: face_normal,
            texel_m,
            height_m: link_height_m(texel_m),
            offset_m: self.geometry.tracer.ray_offset_m(position_m),
        }
    }

    /// The nearest receiver, from `own` outwards, that no wall separates from a hit, and the one that it is read at: where there
    /// is none, the nearest that glass alone separates from it, if a ray of light passes.
    fn linked_around(&self, hit: &Hit, point_m: Vec3, own: u32) -> [Surface; 2] {
        let height_m = link_height_m(self.lightmap.texel_m_of(own));
        let from_m = self.geometry.raised(point_m, self.geometry.side_normal(hit), height_m);
        let raised_m = |receiver: u32| self.raised_receiver(receiver);
        let linked = |receiver: u32| self.is_linked(from_m, raised_m(receiver));
        if let Some(found) = self.nearest_around(point_m, own, linked) {
            return [Surface::Receiver(found); 2];
        }
        let tracer = &self.geometry.tracer;
        if !tracer.has_glass() {
            return [Surface::Dark; 2];
        }
        let behind_glass = |receiver: u32| tracer.passed(from_m, raised_m(receiver)) > 0.0;
        let is_passed = |&receiver: &u32| tracer.met(from_m, raised_m(receiver) - from_m, 1.0).is_none();
        let read = self.nearest_around(point_m, own, behind_glass).filter(is_passed);
        [Surface::Dark, read.map_or(Surface::Dark, Surface::Receiver)]
    }

    /// The nearest receiver, from `own` outwards, for which `fits` holds.
    fn nearest_around(&self, point_m: Vec3, own: u32, fits: impl Fn(u32) -> bool) -> Option<u32> {
        if fits(own) {
            return Some(own);
        }
        let receiver = &self.lightmap.receivers[own as usize];
        let [x, y] = receiver.texel.map(i32::from);
        let ring = |radius: i32| {
            let side = 2 * radius + 1;
            (0..side * side)
                .map(move |i| [i % side - radius, i / side - radius])
                .filter(move |offset| offset[0].abs().max(offset[1].abs()) == radius)
        };
        let distance =
            |index: u32| self.lightmap.receivers[index as usize].position_m.distance_squared(point_m);
        let nearest = |radius: i32| {
            ring(radius)
                .filter_map(|[dx, dy]| self.receiver_on(receiver.block, x + dx, y + dy))
                .filter(|&index| fits(index))
                .min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)))
        };
        (1..=LINKED_RINGS).find_map(nearest)
    }

    /// The surface at a place in a receiver's texel, 0..1 in x and y.
    pub fn point_of(&self, receiver: u32, at: Vec2) -> Option<Site> {
        let sides = |instance: u32| super::place::sides(&self.geometry.scene, instance as usize);
        let find = || TexelTriangles::new(&self.lightmap, &self.texels, sides);
        let triangles = self.texel_triangles.get_or_init(find);
        let own = &self.lightmap.receivers[receiver as usize];
        let instance = self.lightmap.blocks[own.block as usize].instance;
        let side = (own.block - self.lightmap.first_block[instance as usize]) % sides(instance);
        triangles.point(&self.geometry, &self.texels, (receiver, own, side == 1), at)
    }

    /// The points of a receiver's texel that lie on surface, with their bits of `Receivers::coverage`.
    pub fn points_of(&self, receiver: u32) -> impl Iterator<Item = (u32, Site)> + '_ {
        (0..COVERAGE_POINTS).filter_map(move |bit| {
            let at = Vec2::new((bit % COVERAGE_SIDE) as f32, (bit / COVERAGE_SIDE) as f32) + 0.5;
            Some((bit, self.point_of(receiver, at / COVERAGE_SIDE as f32)?))
        })
    }

    /// The points whose mean direct light a receiver's texel has: those of its coverage, or its own where there are none.
    pub fn lit_points_of(&self, receiver: u32) -> Vec<Site> {
        let points = self.own_points_of(receiver, false);
        if points.is_empty() { vec![self.lightmap.receivers[receiver as usize].site()] } else { points }
    }

    /// The points whose mean indirect light a receiver has: those of the coverage of all that share its square, or of the finer grid
    /// if all of them have few, or its own where there are none.
    pub fn gathering_points_of(&self, receiver: u32) -> Vec<Site> {
        let lender = self.lightmap.receivers[receiver as usize].light_of;
        let first = self.sharers.partition_point(|[other, _]| *other < lender);
        let sharers = self.sharers[first..].iter().take_while(|[other, _]| *other == lender);
        let all = std::iter::once(lender).chain(sharers.map(|[_, sharer]| *sharer));
        let all: Vec<u32> = all.collect();
        let has_few = |&sharer: &u32| {
            let Receiver { coverage, fine, .. } = self.lightmap.receivers[sharer as usize];
            fine != 0 || coverage == 0
        };
        let is_fine = all.iter().all(has_few);
        let points: Vec<Site> = all.iter().flat_map(|&sharer| self.own_points_of(sharer, is_fine)).collect();
        if points.is_empty() { vec![self.lightmap.receivers[lender as usize].site()] } else { points }
    }

    /// The points of a receiver's own coverage, or of its finer grid.
    fn own_points_of(&self, receiver: u32, is_fine: bool) -> Vec<Site> {
        let Receiver { coverage, fine, .. } = self.lightmap.receivers[receiver as usize];
        if is_fine {
            let bits = (0..u64::BITS).filter(|bit| fine >> bit & 1 == 1);
            return bits.filter_map(|bit| self.point_of(receiver, seen::fine_place(bit))).collect();
        }
        let points = self.points_of(receiver).filter(|(bit, _)| coverage >> bit & 1 == 1);
        points.map(|(_, site)| site).collect()
    }

    /// Point of a receiver, raised as [`Geometry::raised`] does by [`link_height_m`] of its texel.
    pub fn raised_receiver(&self, receiver: u32) -> Vec3 {
        self.raised[receiver as usize].at_m
    }

    /// A point on a block, raised as its receivers are.
    pub fn raised_on(&self, block: u32, site: &Site) -> Vec3 {
        let height_m = link_height_m(self.lightmap.blocks[block as usize].texel_m);
        self.geometry.raised(site.position_m, site.face_normal, height_m)
    }

    /// No wall stands between two raised points.
    pub fn is_linked(&self, from_m: Vec3, to_m: Vec3) -> bool {
        !self.geometry.tracer.is_occluded(from_m, to_m)
    }

    /// The receiver whose own texel this is, if any; no guest.
    pub fn receiver_on(&self, block: u32, x: i32, y: i32) -> Option<u32> {
        let index = self.standing_on(block, x, y)?;
        (self.lightmap.receivers[index as usize].texel.map(i32::from) == [x, y]).then_some(index)
    }

    /// The receiver that stands for a texel, its own or a neighbour's, if any; no guest.
    pub fn standing_on(&self, block: u32, x: i32, y: i32) -> Option<u32> {
        let size = self.lightmap.blocks[block as usize].size.map(|side| side as i32);
        if x < 0 || y < 0 || x >= size[0] || y >= size[1] {
            return None;
        }
        let index = self.lightmap.blocks[block as usize].receiver_of_texel[(y * size[0] + x) as usize];
        (index < CAVITY).then_some(index)
    }

    /// Receiver of a texel, and true; or that of the nearest of its eight neighbours, as rounding may step over a chart's rim.
    fn receiver_near(&self, block: u32, texel: Vec2) -> Option<(u32, bool)> {
        let block = &self.lightmap.blocks[block as usize];
        let [x, y] = texel.to_array().map(whole_below);
        let at = |x: i64, y: i64| {
            let inside = x >= 0 && y >= 0 && x < i64::from(block.size[0]) && y < i64::from(block.size[1]);
            let found = inside.then(|| block.receiver_of_texel[(y * i64::from(block.size[0]) + x) as usize]);
            found.filter(|&found| found < CAVITY)
        };
        if let Some(own) = at(x, y) {
            return Some((own, true));
        }
        const RING: [(i64, i64); 8] = [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)];
        RING.iter().find_map(|step| at(x + step.0, y + step.1)).map(|near| (near, false))
    }
}

/// The largest whole number that is not above a value; without the call that `floor` is on older processors.
fn whole_below(value: f32) -> i64 {
    let cut = value as i64;
    cut - i64::from(cut as f32 > value)
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::kinds::SceneTasks;
    use lightkiln_proto::kinds::prt::Settings;
    use lightkiln_proto::settings::{PlaceSettings, Preset, SettingsGroup};
    use serde_json::json;

    use super::*;
    use crate::kinds::{BakeKinds, Runner};
    use crate::scene::{
        self,
        model::{Glass, Material, MeshInstance, Scene},
    };
    use crate::task::{Progress, artefact};
    use crate::unwrap::{UnwrapSettings, unwrap_generated};

    /// A wall that is 4 m long and a texel of a quarter of a metre high, and a pane across it a third of the way up, which stops the
    /// share `alpha`.
    fn strip_with_pane(alpha: f32) -> World {
        let quad = |path: &str, material_index: u32, corner: Vec3, right: Vec3, up: Vec3| MeshInstance {
            path: path.into(),
            material_index,
            positions_m: vec![corner, corner + right, corner + right + up, corner + up],
            normals: vec![right.cross(up).normalize(); 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..MeshInstance::default()
        };
        let glass = Glass { blends: true, transmission: 0.0, transmission_texture: None };
        let mut pane =
            Material { double_sided: true, glass: Some(glass), ..Material::opaque("pane", [0.5; 3]) };
        pane.base_colour[3] = alpha;
        let (right, height_m) = (Vec3::X * 4.0, 0.08);
        let scene = Scene {
            instances: vec![
                quad("wall", 0, Vec3::ZERO, right, Vec3::Y * 0.25),
                quad("pane", 1, Vec3::new(-1.0, height_m, 2.0), Vec3::X * 6.0, -Vec3::Z * 2.0),
            ],
            materials: vec![Material::opaque("wall", [0.5; 3]), pane],
            ..Scene::default()
        };
        let (geometry, progress) = (Arc::new(Geometry::new(scene).unwrap()), Progress::new());
        let unwrap = |instance: &MeshInstance| {
            let MeshInstance { positions_m, normals, triangles, .. } = instance;
            let settings = UnwrapSettings::with_texel_m(0.25);
            unwrap_generated(positions_m, normals, triangles, &settings, &progress).unwrap()
        };
        let charts = Charts { texel_m: 0.25, unwraps: geometry.scene.instances.iter().map(unwrap).collect() };
        let place = PlaceSettings::read(&Default::default(), Preset::Draft).unwrap();
        let (lightmap, _) = crate::lightmap::place::place(&geometry, &charts, &place, &progress).unwrap();
        World::new(geometry, &charts, lightmap, &progress)
    }

    /// Of rays onto the wall at a height, the shares that read a receiver, and that are linked to one.
    fn read_at(world: &World, height_m: f32) -> [f32; 2] {
        let count = 400;
        let mut found = [0.0; 2];
        for ray in 0..count {
            let at_m = Vec3::new(0.5 + 3.0 * (ray as f32 + 0.5) / count as f32, height_m, 0.0);
            let from_m = at_m + Vec3::new(0.001 * ray as f32, 0.0, 0.5);
            let direction = (at_m - from_m).normalize();
            let hit = world.geometry.tracer.met(from_m, direction, f32::INFINITY).unwrap();
            let all = world.found_at(&hit, from_m + direction * hit.t);
            for (sum, surface) in found.iter_mut().zip([all.read, all.linked]) {
                *sum += f32::from(matches!(surface, Surface::Receiver(_))) / count as f32;
            }
        }
        found
    }

    #[test]
    fn strip_that_glass_parts_from_its_texel_is_read_by_what_passes() {
        for alpha in [0.6, 0.75, 0.9, 1.0] {
            let world = strip_with_pane(alpha);
            let [above, below] = [0.18, 0.04].map(|height_m| read_at(&world, height_m));
            println!("{alpha}: above {above:?}, below {below:?}");
            assert!(above.iter().all(|share| *share > 0.99), "the larger part has the receivers: {above:?}");
            let [read, linked] = below;
            assert_eq!(linked, 0.0);
            assert!((read - (1.0 - alpha)).abs() < 0.06, "{alpha}: {read} of the rays are read");
        }
    }

    #[test]
    fn scenes_with_equal_lightmaps_have_worlds_of_their_own() {
        let settings = Settings::from_json(&json!({ "preset": "draft", "receivers_target": 2000 })).unwrap();
        let progress = Progress::new();
        let mut run = LocalRun::new(1 << 30, &progress);
        let bundle = run.shelf.put(include_bytes!("../../../tests/scenes/furnace.glb").to_vec());
        let tasks = SceneTasks::of(bundle).unwrapped(&settings.texels).placed(&settings.place);
        run.run(&Runner::new(&BakeKinds::new()), tasks.into_specs().collect(), |_| true, |_| {}).unwrap();
        let mut inputs = run.scene_inputs(&World::PARTS);
        let first = World::of(&run.context(&inputs)).unwrap();
        assert!(Arc::ptr_eq(&first, &World::of(&run.context(&inputs)).unwrap()), "built once");

        let (mut other, _): (Scene, _) =
            run.context(&inputs).decoded(scene::ARTEFACT_MAGIC, scene::ARTEFACT).unwrap();
        other.materials[0].base_colour[0] *= 0.5;
        inputs[0].digest = run.shelf.put(artefact::encode(scene::ARTEFACT_MAGIC, &other).unwrap());
        let second = World::of(&run.context(&inputs)).unwrap();
        assert_eq!(second.geometry.scene.materials[0].base_colour, other.materials[0].base_colour);
    }
}
