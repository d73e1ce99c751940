//! A tiny bake made by hand: a box open to the sky, with a masked, textured, double-sided sheet hanging in it.
//!
//! Transport is computed for the empty box, in which every probe sees everything; U = A and ΣVᵀ = 1. It is there in both
//! bases.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::{
    Block, Emitter, FORMAT, Manifest, Material, TextureUse, Totals, VERSION, Wrap,
};
use lightkiln_proto::prt::{
    AreaCode, BasisKind, ClusterTransport, Draw, EmitterIrradiance, Geometry, NearSurface, Patch, PatchKey,
    PatchSet, Probe, ProbeBatch, Receivers, RelightHit, Settings,
};
use lightkiln_proto::scene::{LightKind, SceneCamera, SceneLight};
use lightkiln_proto::sh::{ShBasis, relight_direction};

use crate::bake::{Contents, LoadedBake, Texture};

/// Size of the box in metres.
pub const ROOM: Vec3 = Vec3::new(4.0, 3.0, 4.0);
const SIDE: u32 = 8;
const RAYS: u32 = 64;
const BANDS: u32 = 2;
const SAMPLES: u32 = 64;
/// Texels along the side of a leaf patch; a wall is a patch of all its leaves.
const LEAF: u32 = 4;
const SKY_PARTS: u32 = 16;

/// A rectangle with a block of `SIDE`² texels: corner and two edges, their cross product towards the front.
struct Quad {
    corner: Vec3,
    u: Vec3,
    v: Vec3,
    material: u32,
    back: bool,
}

impl Quad {
    fn normal(&self) -> Vec3 {
        self.u.cross(self.v).normalize()
    }

    fn texel_centre(&self, texel: [u16; 2]) -> Vec3 {
        let at = (Vec2::new(f32::from(texel[0]), f32::from(texel[1])) + 0.5) / SIDE as f32;
        self.corner + self.u * at.x + self.v * at.y
    }

    fn texel_of(&self, point: Vec3) -> [u16; 2] {
        let d = point - self.corner;
        let share =
            Vec2::new(d.dot(self.u) / self.u.length_squared(), d.dot(self.v) / self.v.length_squared());
        let texel = (share * SIDE as f32).clamp(Vec2::ZERO, Vec2::splat(SIDE as f32 - 1.0));
        [texel.x as u16, texel.y as u16]
    }
}

/// Floor, four walls, the hanging sheet.
fn quads() -> Vec<Quad> {
    let Vec3 { x, y, z } = ROOM;
    let quad = |corner, u, v, material| Quad { corner, u, v, material, back: false };
    vec![
        quad(Vec3::ZERO, Vec3::new(0.0, 0.0, z), Vec3::new(x, 0.0, 0.0), 0),
        quad(Vec3::ZERO, Vec3::new(0.0, y, 0.0), Vec3::new(0.0, 0.0, z), 1),
        quad(Vec3::new(x, 0.0, 0.0), Vec3::new(0.0, 0.0, z), Vec3::new(0.0, y, 0.0), 2),
        quad(Vec3::ZERO, Vec3::new(x, 0.0, 0.0), Vec3::new(0.0, y, 0.0), 0),
        quad(Vec3::new(0.0, 0.0, z), Vec3::new(0.0, y, 0.0), Vec3::new(x, 0.0, 0.0), 0),
        Quad {
            corner: Vec3::new(1.4, 0.6, 1.2),
            u: Vec3::new(1.1, 0.0, 0.5),
            v: Vec3::new(0.0, 1.2, 0.3),
            material: 3,
            back: true,
        },
    ]
}

/// What a ray in the empty box meets: a wall and the point, or `None` through the open top.
fn hit(walls: &[Quad], from: Vec3, direction: Vec3) -> Option<(usize, Vec3)> {
    let distance = |quad: &Quad| (quad.corner - from).dot(quad.normal()) / direction.dot(quad.normal());
    let ahead = |quad: &Quad| direction.dot(quad.normal()) < 0.0;
    let walls = walls.iter().enumerate().take(5).filter(|(_, quad)| ahead(quad));
    let (index, t) = walls.map(|(index, quad)| (index, distance(quad))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    let point = from + direction * t;
    (point.y <= ROOM.y).then_some((index, point))
}

fn block_key(quad: usize, back: bool) -> u64 {
    100 + 2 * quad as u64 + u64::from(back)
}

fn probe_positions() -> Vec<Vec3> {
    [[1.0, 0.8, 1.0], [3.0, 0.8, 3.0], [1.0, 2.2, 3.0], [3.0, 2.2, 1.0]].map(Vec3::from).to_vec()
}

/// A light, a sky and a camera that see all of it.
pub fn lights() -> Vec<SceneLight> {
    let named = |kind, strength| SceneLight { name: "test".to_owned(), kind, strength };
    let position_m = [2.6, 2.4, 2.3];
    vec![
        named(LightKind::Point { position_m, range_m: None }, [6.0, 5.0, 4.0]),
        named(LightKind::Sun { direction: [-0.48, -0.8, 0.36] }, [3.0, 2.5, 2.0]),
        named(
            LightKind::Spot {
                position_m: [0.5, 2.8, 0.5],
                direction: [0.577_350_3, -0.577_350_3, 0.577_350_3],
                inner_rad: 0.2,
                outer_rad: 0.5,
                range_m: Some(9.0),
            },
            [8.0; 3],
        ),
        named(LightKind::Sky { zenith: [0.2, 0.4, 0.9], horizon: [0.6, 0.6, 0.6] }, [0.5; 3]),
    ]
}

/// A camera that looks into the box from its open top.
pub fn camera() -> SceneCamera {
    SceneCamera {
        name: "test".to_owned(),
        eye_m: [2.2, 2.6, 5.6],
        target_m: [2.0, 1.0, 1.5],
        up: [0.0, 1.0, 0.0],
        fov_y_rad: 0.9,
        orthographic_half_height_m: None,
    }
}

/// The manifest, without chunks.
pub fn manifest(basis: BasisKind) -> Manifest {
    let settings = serde_json::json!({ "basis": basis, "relight_rays": RAYS, "bands": BANDS,
        "sky_parts": SKY_PARTS, "texel_m": 0.5, "probe_spacing_m": 2.0 });
    let mut blocks = Vec::new();
    for (index, quad) in quads().iter().enumerate() {
        for back in [false, true].into_iter().take(1 + usize::from(quad.back)) {
            let place = blocks.len() as u32;
            blocks.push(Block {
                key: block_key(index, back),
                name: format!("quad {index}"),
                size: [SIDE; 2],
                page: place / 4,
                origin: [SIDE * (place % 4) + 1, 3],
            });
        }
    }
    Manifest {
        format: FORMAT.to_owned(),
        version: VERSION,
        kind: "prt".to_owned(),
        scene: Digest::of(b"fixture"),
        settings: Settings::from_json(&settings).unwrap(),
        texel_m: 0.5,
        probe_spacing_m: 2.0,
        bounds_m: [[0.0; 3], ROOM.into()],
        totals: Totals::default(),
        pages: vec![[40, 16], [36, 12]],
        blocks,
        materials: materials(),
        emitters: vec![Emitter { name: "sheet".to_owned(), area_m2: 1.0 }],
        lights: lights(),
        cameras: vec![camera()],
        textures: Vec::new(),
        geometry: Vec::new(),
        probes: Vec::new(),
        patches: Vec::new(),
        clusters: Vec::new(),
    }
}

fn materials() -> Vec<Material> {
    let plain = |name: &str, colour: [f32; 3]| Material {
        name: name.to_owned(),
        base_colour: [colour[0], colour[1], colour[2], 1.0],
        base_colour_texture: None,
        emissive: [0.0; 3],
        emissive_texture: None,
        emitter: None,
        alpha_cutoff: None,
        double_sided: false,
    };
    let sheet = Material {
        base_colour_texture: Some(TextureUse {
            texture: 0,
            wrap: [Wrap::Repeat, Wrap::Mirror],
            transform: Some([[2.0, 0.0, 0.1], [0.0, 2.0, 0.0]]),
        }),
        emissive: [0.3, 0.2, 0.05],
        emitter: Some(0),
        alpha_cutoff: Some(0.5),
        double_sided: true,
        ..plain("sheet", [0.9, 0.8, 0.7])
    };
    vec![plain("grey", [0.7; 3]), plain("red", [0.63, 0.06, 0.05]), plain("green", [0.14, 0.45, 0.09]), sheet]
}

/// A soft checker whose alpha has holes.
pub fn texture() -> Texture {
    let texel = |index: u32| {
        let (x, y) = (index % 16, index / 16);
        let tint = if (x / 4 + y / 4) % 2 == 0 { 230 } else { 120 };
        let alpha = if (x / 8 + y / 8) % 2 == 0 && x % 8 > 1 && x % 8 < 6 && y % 8 > 1 && y % 8 < 6 {
            0
        } else {
            255
        };
        [tint, 200, 255 - tint, alpha]
    };
    Texture::new(16, 16, (0..256).map(texel).collect())
}

/// Decoded chunks.
pub fn contents(basis: BasisKind) -> Contents {
    let walls = quads();
    let clusters = walls.iter().enumerate().flat_map(|(index, quad)| {
        let sides = [false, true].into_iter().take(1 + usize::from(quad.back));
        sides.map(|back| cluster(basis, &quads(), index, back)).collect::<Vec<_>>()
    });
    Contents {
        clusters: clusters.collect(),
        probes: vec![probe_batch(&walls)],
        patches: if basis == BasisKind::Patches { vec![patch_set(&walls)] } else { Vec::new() },
        geometry: vec![Geometry { draws: walls.iter().enumerate().map(|(i, quad)| draw(i, quad)).collect() }],
        textures: vec![texture()],
    }
}

/// The whole bake.
pub fn bake(basis: BasisKind) -> LoadedBake {
    LoadedBake::assemble(manifest(basis), contents(basis)).unwrap()
}

/// The bake in patches as if the floor were narrow: some of its receivers meet points of the first wall, and one texel that
/// no cluster has.
pub fn narrow_contents() -> Contents {
    let mut contents = contents(BasisKind::Patches);
    let wall = contents.clusters[1].receivers.clone();
    let count = contents.clusters[0].receivers.len();
    let near = &mut contents.clusters[0].near;
    (near.reach_m, near.blocks) = (1.5, wall.blocks);
    for receiver in 0..count {
        let hits = if receiver % 3 == 0 { 1 + receiver % 5 } else { 0 };
        near.count.push(hits as u8);
        near.weight.push(0.4);
        for hit in 0..hits {
            let texel = if hit == 3 { [0, 0] } else { wall.texel[(7 * receiver + hit) % wall.texel.len()] };
            near.surface.push(match hit {
                1 => NearSurface::Own { albedo: [0.1, 0.2, 0.3], normal: [0.0, 1.0, 0.0] },
                _ => NearSurface::Texel { block: 0, texel },
            });
            near.offset.push([-1000 + 97 * hit as i16, 700, 31 * receiver as i16]);
        }
    }
    contents
}

/// The whole bake of [`narrow_contents`].
pub fn narrow_bake() -> LoadedBake {
    LoadedBake::assemble(manifest(BasisKind::Patches), narrow_contents()).unwrap()
}

fn cluster(basis: BasisKind, walls: &[Quad], index: usize, back: bool) -> ClusterTransport {
    let quad = &walls[index];
    let normal = if back { -quad.normal() } else { quad.normal() };
    let colour = materials()[quad.material as usize].base_colour;
    let mut receivers = Receivers { blocks: vec![block_key(index, back)], ..Receivers::default() };
    for texel in (0..SIDE as u16).flat_map(|y| (0..SIDE as u16).map(move |x| [x, y])) {
        // Two texels without receivers, so that edges are extended.
        if texel == [0, 0] || texel == [4, 4] && index == 0 {
            continue;
        }
        receivers.block.push(0);
        receivers.texel.push(texel);
        receivers.position_m.push(quad.texel_centre(texel).into());
        receivers.normal.push(normal.into());
        receivers.albedo.push([colour[0], colour[1], colour[2]]);
        receivers.emission.push([0.0; 3]);
        receivers.links.push(links(index, texel));
    }
    let count = receivers.len();
    let mut content =
        ClusterTransport { bounds_m: [[0.0; 3], ROOM.into()], receivers, ..ClusterTransport::default() };
    match basis {
        BasisKind::Sh => {
            content.probes = (0..probe_positions().len() as u64).map(|probe| 10 + probe).collect();
            (content.bands, content.sky) = (BANDS, true);
        }
        BasisKind::Patches => content.probes = column_keys(),
    }
    let columns = content.columns();
    content.rank = columns as u32;
    content.vt =
        (0..columns * columns).map(|at| if at / columns == at % columns { 1.0 } else { 0.0 }).collect();
    for receiver in 0..count {
        let position = Vec3::from(content.receivers.position_m[receiver]);
        content.u.extend(match basis {
            BasisKind::Sh => transport_row(walls, position, normal),
            BasisKind::Patches => patch_row(walls, position, normal),
        });
    }
    if index == 0 {
        let irradiance = (0..count).map(|receiver| [0.02 * (receiver % 7) as f32, 0.05, 0.01]).collect();
        content.emitters.push(EmitterIrradiance { emitter: 0, irradiance });
    }
    content
}

/// α of one receiver: `π/N Σ_n Σ_p 1/P·Y_j(Ψ_p(y_n))`, sky columns last; cosine-distributed ω_n.
fn transport_row(walls: &[Quad], position: Vec3, normal: Vec3) -> Vec<f32> {
    let probes = probe_positions();
    let basis = ShBasis::new(BANDS as usize);
    let coefficients = basis.coefficients();
    let mut row = vec![0.0; (probes.len() + 1) * coefficients];
    let mut y = vec![0.0; coefficients];
    let weight = PI / SAMPLES as f32;
    let mut add = |column: usize, direction: Vec3, weight: f32| {
        basis.evaluate(direction, &mut y);
        for (sum, y) in row[column * coefficients..].iter_mut().zip(&y) {
            *sum += weight * y;
        }
    };
    for direction in cosine_directions(normal) {
        match hit(walls, position + normal * 1e-4, direction) {
            None => add(probes.len(), direction, weight),
            Some((_, point)) => {
                for (column, probe) in probes.iter().enumerate() {
                    add(column, (point - *probe).normalize(), weight / probes.len() as f32);
                }
            }
        }
    }
    row
}

/// A uniform direction added to the normal is cosine-distributed.
fn cosine_directions(normal: Vec3) -> impl Iterator<Item = Vec3> {
    (0..SAMPLES).map(move |sample| (normal * 1.001 + relight_direction(sample, SAMPLES)).normalize())
}

/// π/N for each of N rays that meet a patch or a part of the sky, by column. The first wall is taken whole, others by
/// leaves.
fn patch_row(walls: &[Quad], position: Vec3, normal: Vec3) -> Vec<f32> {
    let keys = column_keys();
    let mut row = vec![0.0; keys.len()];
    for direction in cosine_directions(normal) {
        let key = match hit(walls, position + normal * 1e-4, direction) {
            None => {
                let cosine = |part: &u32| direction.dot(relight_direction(*part, SKY_PARTS));
                PatchKey::of_sky((0..SKY_PARTS).max_by(|a, b| cosine(a).total_cmp(&cosine(b))).unwrap())
            }
            Some((0, _)) => wall_key(0),
            Some((wall, point)) => {
                let [x, y] = walls[wall].texel_of(point).map(|texel| u32::from(texel) / LEAF);
                leaf_key(wall, y * (SIDE / LEAF) + x)
            }
        };
        row[keys.binary_search(&key.0).unwrap()] += PI / SAMPLES as f32;
    }
    row
}

fn wall_key(wall: usize) -> PatchKey {
    PatchKey(1000 + 100 * wall as u64)
}

fn leaf_key(wall: usize, leaf: u32) -> PatchKey {
    PatchKey(wall_key(wall).0 + 1 + u64::from(leaf))
}

/// The first wall, the leaves of the others, the parts of the sky; ascending.
fn column_keys() -> Vec<u64> {
    let leaves = (SIDE / LEAF).pow(2);
    let of_walls = (1..5).flat_map(|wall| (0..leaves).map(move |leaf| leaf_key(wall, leaf)));
    let of_sky = (0..SKY_PARTS).map(PatchKey::of_sky);
    let mut keys: Vec<u64> =
        std::iter::once(wall_key(0)).chain(of_walls).chain(of_sky).map(|key| key.0).collect();
    keys.sort_unstable();
    keys
}

/// Five walls of four leaves each, of all their texels.
fn patch_set(walls: &[Quad]) -> PatchSet {
    let per_wall = (SIDE / LEAF).pow(2);
    let mut set = PatchSet { sky_parts: SKY_PARTS, leaf_starts: vec![0], ..PatchSet::default() };
    for wall in 0..walls.len().min(5) {
        set.blocks.push(block_key(wall, false));
        let first_leaf = wall as u32 * per_wall;
        set.patches.push(Patch { key: wall_key(wall), first_leaf, leaf_count: per_wall });
        for leaf in 0..per_wall {
            let key = leaf_key(wall, leaf);
            set.patches.push(Patch { key, first_leaf: first_leaf + leaf, leaf_count: 1 });
            let corner = [leaf % (SIDE / LEAF), leaf / (SIDE / LEAF)].map(|place| place * LEAF);
            for texel in 0..LEAF * LEAF {
                set.block.push(wall as u16);
                set.area.push(AreaCode(120 + (texel % 16) as u8));
                set.texel.push([corner[0] + texel % LEAF, corner[1] + texel / LEAF].map(|at| at as u16));
            }
            set.leaf_starts.push(set.texel.len() as u32);
        }
    }
    set
}

/// All neighbours are linked, but for an unseen wall between columns 3 and 4 of the floor.
fn links(quad: usize, texel: [u16; 2]) -> u8 {
    match (quad, texel[0]) {
        // Neither to the right nor down to the right.
        (0, 3) => 0b1010,
        // Not down to the left.
        (0, 4) => 0b0111,
        _ => 0b1111,
    }
}

fn probe_batch(walls: &[Quad]) -> ProbeBatch {
    let probes = probe_positions();
    let blocks = (0..walls.len()).map(|index| block_key(index, false)).collect();
    let mut hits = Vec::new();
    for probe in &probes {
        for ray in 0..RAYS {
            hits.push(match hit(walls, *probe, relight_direction(ray, RAYS)) {
                None => RelightHit::Sky,
                Some((wall, point)) => match walls[wall].texel_of(point) {
                    [0, 0] => RelightHit::Dark,
                    [4, 4] if wall == 0 => RelightHit::Dark,
                    texel => RelightHit::Receiver { block: wall as u16, texel },
                },
            });
        }
    }
    let probe = |(index, position): (usize, &Vec3)| Probe {
        key: 10 + index as u64,
        position_m: (*position).into(),
        radius_m: 4.0,
    };
    ProbeBatch { probes: probes.iter().enumerate().map(probe).collect(), relight_rays: RAYS, blocks, hits }
}

fn draw(index: usize, quad: &Quad) -> Draw {
    let share = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    Draw {
        material: quad.material,
        front: block_key(index, false),
        back: quad.back.then(|| block_key(index, true)),
        position_m: share.iter().map(|[u, v]| (quad.corner + quad.u * *u + quad.v * *v).into()).collect(),
        normal: vec![quad.normal().into(); 4],
        uv: share.to_vec(),
        colour: Vec::new(),
        lightmap_texel: share.iter().map(|at| at.map(|share| share * SIDE as f32)).collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}
