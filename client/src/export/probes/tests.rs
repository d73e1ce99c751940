//! Files of light in free space as engines read them, held against the field's own light.

use std::f32::consts::PI;

use glam::{IVec3, Vec2};
use half::f16;
use lightkiln_proto::harmonics::relight_direction;
use serde::Deserialize;

use super::ddgi::{DISTANCE_SIDE, IRRADIANCE_SIDE, direction_of, inside_of};
use super::*;
use crate::bake::{LoadedBake, ReceiverLight, Tetrahedra};
use crate::fixture;
use crate::preview::{Backend, light_receivers};

/// Half floats keep 11 bits.
const HALF: f32 = 1e-3;

fn settled(bake: &LoadedBake) -> ReceiverLight {
    light_receivers(bake, fixture::lights(), None, vec![1.0], Backend::Cpu).unwrap().settled.light
}

/// Texels of a file, rgb and alpha.
struct Texels {
    size: [usize; 2],
    slices: usize,
    texels: Vec<Vec4>,
}

impl Texels {
    fn of(files: &ProbeFiles, name: &str) -> Self {
        let (_, bytes) = files.files.iter().find(|(own, _)| own == name).unwrap();
        let reader = ::ktx2::Reader::new(bytes).unwrap();
        let header = reader.header();
        let slices = header.pixel_depth.max(header.layer_count) as usize;
        let level = reader.levels().next().unwrap();
        let bytes = zstd::bulk::decompress(level.data, level.uncompressed_byte_length as usize).unwrap();
        let numbers: Vec<f32> =
            bytes.chunks_exact(2).map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32()).collect();
        let texels = numbers.chunks_exact(4).map(Vec4::from_slice).collect();
        Self { size: [header.pixel_width as usize, header.pixel_height as usize], slices, texels }
    }

    fn at(&self, [x, y, slice]: [usize; 3]) -> Vec4 {
        self.texels[(slice * self.size[1] + y) * self.size[0] + x]
    }
}

struct Case {
    bake: LoadedBake,
    light: Vec<Vec4>,
    files: ProbeFiles,
}

impl Case {
    fn new() -> Self {
        let bake = fixture::field_bake(true);
        let light = settled(&bake).probes;
        let files = files(bake.light.free_space().unwrap(), &light, &ProbeFormat::ALL).unwrap();
        Self { bake, light, files }
    }

    fn volume(&self) -> Volume<'_> {
        Volume::new(self.bake.light.free_space().unwrap(), &self.light)
    }

    fn intensity(&self, place: &str) -> f32 {
        self.files.extras.pointer(place).unwrap().as_f64().unwrap() as f32
    }
}

fn normals() -> impl Iterator<Item = Vec3> {
    (0..256).map(|index| relight_direction(index, 256))
}

/// Root mean squares of a difference and of the light, over points and normals.
fn rms(volume: &Volume<'_>, read: impl Fn([usize; 3], Vec3) -> Vec3) -> f32 {
    let [width, height, depth] = volume.size();
    let (mut error, mut all) = (0.0, 0.0);
    for at in (0..width * height * depth).map(|at| [at % width, at / width % height, at / (width * height)]) {
        let probe = volume.probe_of[volume.index(at)];
        for normal in normals() {
            let wanted = volume.irradiance(probe, &harmonics([normal])[0]);
            error += (read(at, normal) - wanted).length_squared();
            all += wanted.length_squared();
        }
    }
    (error / all).sqrt()
}

#[test]
fn cubes_are_read_as_bevy_reads_them() {
    let case = Case::new();
    let volume = case.volume();
    let texels = Texels::of(&case.files, cube::FILE);
    let [x, y, z] = volume.size();
    assert_eq!((texels.size, texels.slices), ([x, 2 * y], 3 * z));
    let intensity = case.intensity("/cube/intensity");
    let read = |[x, row, slice]: [usize; 3], normal: Vec3| {
        let side = |axis: usize| {
            let below = if normal[axis] < 0.0 { y } else { 0 };
            texels.at([x, row + below, slice + axis * z]).truncate() * normal[axis] * normal[axis]
        };
        (side(0) + side(1) + side(2)) * intensity
    };
    let error = rms(&volume, read);
    // Sides turned round, and axes taken for one another, are far worse.
    let turned = rms(&volume, |at, normal| read(at, -normal));
    let mixed = rms(&volume, |at, normal| read(at, Vec3::new(normal.z, normal.x, normal.y)));
    println!("ambient cubes: {error}; sides turned round: {turned}, axes mixed: {mixed}");
    assert!(error < 0.15 && turned > 2.0 * error && mixed > 2.0 * error, "{error} {turned} {mixed}");
}

#[test]
fn harmonics_are_read_as_unity_reads_them() {
    #[derive(Deserialize)]
    struct File {
        unit: String,
        probes: Vec<Probe>,
    }
    #[derive(Deserialize)]
    struct Probe {
        position: [f32; 3],
        coefficients: Vec<f32>,
    }
    let case = Case::new();
    let volume = case.volume();
    let (_, bytes) = case.files.files.iter().find(|(name, _)| name == unity::FILE).unwrap();
    let File { unit, probes } = serde_json::from_slice(bytes).unwrap();
    assert_eq!((unit.as_str(), probes.len()), ("W/m2/sr", volume.space.positions_m().len()));
    for (probe, own) in volume.probes().zip(&probes) {
        let Probe { position: [x, y, z], coefficients } = own;
        assert_eq!(Vec3::new(-x, *y, *z), volume.space.positions_m()[probe as usize].truncate());
        for normal in normals() {
            // Unity's ShadeSH9, in its own world.
            let n = Vec3::new(-normal.x, normal.y, normal.z);
            let radiance = |c: usize| {
                let sh = |j: usize| coefficients[9 * c + j];
                let linear = sh(3) * n.x + sh(1) * n.y + sh(2) * n.z + sh(0) - sh(6);
                let products =
                    sh(4) * n.x * n.y + sh(5) * n.y * n.z + 3.0 * sh(6) * n.z * n.z + sh(7) * n.z * n.x;
                linear + products + sh(8) * (n.x * n.x - n.y * n.y)
            };
            let found = PI * Vec3::new(radiance(0), radiance(1), radiance(2));
            let wanted = volume.irradiance(probe, &harmonics([normal])[0]);
            assert!((found - wanted).length() < 1e-4 * wanted.length().max(0.1), "{found} for {wanted}");
        }
    }
}

/// A bilinear read of a tile at a place of the square −1..1.
fn bilinear(texels: &Texels, side: usize, [x, y, layer]: [usize; 3], at: Vec2) -> Vec4 {
    let inside = (side - 2) as f32;
    let at = (at + 1.0) * 0.5 * inside + 0.5;
    let (low, share) = (at.floor(), at - at.floor());
    let texel = |dx: usize, dy: usize| {
        texels.at([x * side + low.x as usize + dx, y * side + low.y as usize + dy, layer])
    };
    let upper = texel(0, 0).lerp(texel(1, 0), share.x);
    upper.lerp(texel(0, 1).lerp(texel(1, 1), share.x), share.y)
}

/// Place of a direction on the square.
fn place_of(direction: Vec3) -> Vec2 {
    let on = direction / direction.abs().element_sum();
    if on.z >= 0.0 {
        return Vec2::new(on.x, on.y);
    }
    Vec2::new((1.0 - on.y.abs()).copysign(on.x), (1.0 - on.x.abs()).copysign(on.y))
}

#[test]
fn maps_of_irradiance_are_the_fields_and_have_no_seams() {
    let case = Case::new();
    let volume = case.volume();
    let texels = Texels::of(&case.files, ddgi::IRRADIANCE_FILE);
    let [x, y, z] = volume.size();
    assert_eq!((texels.size, texels.slices), ([x, z].map(|along| along * IRRADIANCE_SIDE), y));
    let intensity = case.intensity("/ddgi/irradiance/intensity");
    let read = |[x, y, z]: [usize; 3], normal: Vec3| {
        bilinear(&texels, IRRADIANCE_SIDE, [x, z, y], place_of(normal)).truncate() * intensity
    };
    let error = rms(&volume, read);
    let turned = rms(&volume, |at, normal| read(at, -normal));
    println!("octahedral irradiance: {error}; turned round: {turned}");
    assert!(error < 0.06 && turned > 4.0 * error, "{error} {turned}");
    // Either side of the octahedron's edges, which the tile's rim is: the border holds what lies beyond.
    let distances = Texels::of(&case.files, ddgi::DISTANCE_FILE);
    for (texels, side) in [(&texels, IRRADIANCE_SIDE), (&distances, DISTANCE_SIDE)] {
        for along in (0..1000).map(|step| step as f32 / 500.0 - 0.999) {
            for rim in [-1.0, 1.0] {
                for [one, other] in [
                    [Vec2::new(rim, along), Vec2::new(rim, -along)],
                    [Vec2::new(along, rim), Vec2::new(-along, rim)],
                ] {
                    let [one, other] = [one, other].map(|at| bilinear(texels, side, [1, 1, 1], at));
                    assert!((one - other).abs().max_element() < HALF * one.max_element(), "{one} {other}");
                }
            }
        }
    }
}

/// The same read of the tile's inside alone: of texels beyond the square, those that lie there on the octahedron.
fn seamless(texels: &Texels, side: usize, [x, y, layer]: [usize; 3], at: Vec2) -> Vec4 {
    let inside = side - 2;
    let on = (at + 1.0) * 0.5 * inside as f32 + 0.5;
    let (low, share) = (on.floor(), on - on.floor());
    let texel = |dx: f32, dy: f32| {
        let mut place = (2.0 * (low + Vec2::new(dx, dy)) - 1.0) / inside as f32 - 1.0;
        if place.x.abs() > 1.0 {
            place = Vec2::new(2.0 * place.x.signum() - place.x, -place.y);
        }
        if place.y.abs() > 1.0 {
            place = Vec2::new(-place.x, 2.0 * place.y.signum() - place.y);
        }
        let [column, row] = ((place + 1.0) * 0.5 * inside as f32).to_array().map(|at| at as usize + 1);
        texels.at([x * side + column, y * side + row, layer])
    };
    let upper = texel(0.0, 0.0).lerp(texel(1.0, 0.0), share.x);
    upper.lerp(texel(0.0, 1.0).lerp(texel(1.0, 1.0), share.x), share.y)
}

#[test]
fn a_million_directions_are_read_as_without_edges() {
    let case = Case::new();
    for (file, side) in [(ddgi::IRRADIANCE_FILE, IRRADIANCE_SIDE), (ddgi::DISTANCE_FILE, DISTANCE_SIDE)] {
        let texels = Texels::of(&case.files, file);
        let count = 1 << 20;
        let (mut worst, mut without_border, mut over_edges) = (0.0_f32, 0.0_f32, 0);
        for direction in (0..count).map(|index| relight_direction(index, count)) {
            let at = place_of(direction);
            let wanted = seamless(&texels, side, [1, 1, 1], at);
            let error = |at: Vec2| {
                let read = bilinear(&texels, side, [1, 1, 1], at);
                (read - wanted).abs().max_element() / wanted.abs().max_element().max(1e-6)
            };
            worst = worst.max(error(at));
            // A tile without a border ends at the middles of its outermost texels.
            let end = 1.0 - 1.0 / (side - 2) as f32;
            let clamped = at.clamp(Vec2::splat(-end), Vec2::splat(end));
            over_edges += u32::from(clamped != at);
            without_border = without_border.max(error(clamped));
        }
        assert!(worst < 1e-5, "{file}: {worst}");
        assert!(
            over_edges > count / 20 && without_border > 100.0 * 1e-5,
            "{file}: {over_edges}, {without_border}"
        );
    }
}

#[test]
fn borders_hold_what_lies_across_the_edge() {
    for side in [IRRADIANCE_SIDE, DISTANCE_SIDE] {
        let inside = side - 2;
        let place = |at: usize| (2 * at + 1) as f32 / inside as f32 - 1.0;
        let middle = |[x, y]: [usize; 2]| direction_of(Vec2::new(place(x), place(y)));
        assert_eq!(inside_of(side, [3, 4]), [2, 3]);
        let last = inside - 1;
        assert_eq!(inside_of(side, [0, 0]), [last, last]);
        assert_eq!(inside_of(side, [side - 1, 0]), [0, last]);
        // A border texel's neighbours in the tile and its own number are neighbours on the sphere.
        for along in 1..=inside {
            for (border, next) in [([0, along], [0, along - 1]), ([along, side - 1], [along - 1, last])] {
                let [across, next] = [inside_of(side, border), next].map(middle);
                assert!(across.dot(next) > 0.75, "{border:?}: {across} beside {next}");
            }
        }
    }
}

#[test]
fn distances_are_those_of_walls_and_states_those_of_probes() {
    let case = Case::new();
    let volume = case.volume();
    let [distances, states] =
        [ddgi::DISTANCE_FILE, ddgi::PROBES_FILE].map(|name| Texels::of(&case.files, name));
    let [x, y, z] = volume.size();
    for at in (0..x * y * z).map(|at| [at % x, at / x % y, at / (x * y)]) {
        let [column, layer, row] = at;
        let index = volume.index(at);
        let state = states.at([column, row, layer]);
        let probe = volume.lattice.probe_at[index];
        assert_eq!(state.w, if probe == NO_PROBE { 0.0 } else { 1.0 });
        let spacing_m = volume.lattice.spacing_m;
        let place = (volume.lattice.point(index).as_vec3() + state.truncate()) * spacing_m;
        let own = volume.space.positions_m()[probe as usize].truncate();
        assert!((place - own).length() < HALF * spacing_m, "{place} {own}");
        for normal in normals() {
            let read = bilinear(&distances, DISTANCE_SIDE, [column, row, layer], place_of(normal));
            let wanted = (volume.space.distance_m(probe, normal) / spacing_m).min(2.598);
            let spread = (read.y - read.x * read.x).max(0.0).sqrt();
            // Means over a lobe of some ten degrees.
            assert!((read.x - wanted).abs() < 0.12 * wanted + 3.0 * spread + 0.02, "{read} for {wanted}");
        }
    }
}

/// What Godot reads of a resource.
struct GodotData {
    bounds: Vec<f32>,
    bsp: Vec<i32>,
    points: Vec<f32>,
    sh: Vec<f32>,
    tetrahedra: Vec<i32>,
}

impl GodotData {
    fn of(files: &ProbeFiles) -> Self {
        let (_, bytes) = files.files.iter().find(|(name, _)| name == godot::FILE).unwrap();
        let text = std::str::from_utf8(bytes).unwrap();
        assert!(
            text.starts_with(
                "[gd_resource type=\"LightmapGIData\" format=3]\n\n[resource]\nprobe_data = {\n"
            )
        );
        fn numbers<T: std::str::FromStr<Err: std::fmt::Debug>>(text: &str, name: &str, of: &str) -> Vec<T> {
            let (_, rest) = text.split_once(&format!("\"{name}\": {of}(")).unwrap();
            let (inside, _) = rest.split_once(')').unwrap();
            inside.split(", ").map(|number| number.parse().unwrap()).collect()
        }
        Self {
            bounds: numbers(text, "bounds", "AABB"),
            bsp: numbers(text, "bsp", "PackedInt32Array"),
            points: numbers(text, "points", "PackedVector3Array"),
            sh: numbers(text, "sh", "PackedColorArray"),
            tetrahedra: numbers(text, "tetrahedra", "PackedInt32Array"),
        }
    }

    /// Tetrahedron that the tree leads to.
    fn walk(&self, at_m: Vec3) -> usize {
        let mut node = 0;
        while node >= 0 {
            let own = &self.bsp[6 * node as usize..][..6];
            let [x, y, z, d] = [0, 1, 2, 3].map(|j| f32::from_bits(own[j] as u32));
            node = if Vec3::new(x, y, z).dot(at_m) > d + 1e-5 { own[4] } else { own[5] };
        }
        assert_ne!(node, bsp::EMPTY, "nothing is at {at_m}");
        (-1 - node) as usize
    }

    /// Barycentric coordinates of a point, and how far it lies out of the tetrahedron.
    fn shares(&self, tetrahedron: usize, at_m: Vec3) -> ([f32; 4], f32) {
        let [a, b, c, d] =
            self.vertices(tetrahedron).map(|vertex| Vec3::from_slice(&self.points[3 * vertex..]));
        let volume = |a: Vec3, b: Vec3, c: Vec3, d: Vec3| (b - a).cross(c - a).dot(d - a);
        let parts =
            [volume(at_m, b, c, d), volume(a, at_m, c, d), volume(a, b, at_m, d), volume(a, b, c, at_m)];
        let shares = parts.map(|part| part / volume(a, b, c, d));
        (shares, shares.iter().fold(0.0, |out, share| out.max(-share)))
    }

    fn vertices(&self, tetrahedron: usize) -> [usize; 4] {
        std::array::from_fn(|j| self.tetrahedra[4 * tetrahedron + j] as usize)
    }

    /// E at a point and normal, as its instances and shaders make it, and how far the point lies out of its tetrahedron.
    fn irradiance(&self, at_m: Vec3, n: Vec3) -> (Vec3, f32) {
        let tetrahedron = self.walk(at_m);
        let (shares, out) = self.shares(tetrahedron, at_m);
        let vertices = self.vertices(tetrahedron);
        let sh = |j: usize| -> Vec3 {
            let row = |vertex: usize| Vec3::from_slice(&self.sh[4 * (9 * vertex + j)..]);
            vertices.iter().zip(shares).map(|(vertex, share)| row(*vertex) * share.clamp(0.0, 1.0)).sum()
        };
        let ambient = 0.886_227 * sh(0)
            + 1.023_327 * (sh(1) * n.y + sh(2) * n.z + sh(3) * n.x)
            + 0.858_086 * (sh(4) * n.x * n.y + sh(5) * n.y * n.z + sh(7) * n.x * n.z)
            + 0.247_708 * sh(6) * (3.0 * n.z * n.z - 1.0)
            + 0.429_043 * sh(8) * (n.x * n.x - n.y * n.y);
        (PI * ambient, out)
    }
}

#[test]
fn tetrahedra_are_walked_and_read_as_godot_does() {
    for is_lattice in [true, false] {
        let bake = fixture::field_bake(is_lattice);
        let light = settled(&bake).probes;
        let space = bake.light.free_space().unwrap();
        let data = GodotData::of(&files(space, &light, &[ProbeFormat::Godot]).unwrap());
        let volume = Volume::new(space, &light);
        // At probes it is their own light; a lattice is exported as if none were moved.
        for probe in volume.probes() {
            let at_m = space.positions_m()[probe as usize].truncate();
            let away = at_m / space.spacing_m() - (at_m / space.spacing_m()).round();
            if is_lattice && away.abs().max_element() > 1e-4 {
                continue;
            }
            for normal in normals().take(16) {
                let wanted = volume.irradiance(probe, &harmonics([normal])[0]);
                let (found, out) = data.irradiance(at_m, normal);
                let is_near = (found - wanted).length() < 1e-4 * wanted.length().max(0.1);
                assert!(is_near && out < 1e-4, "{found} for {wanted}, lattice: {is_lattice}");
            }
        }
        // A point that lies in a tetrahedron is led to one that it lies in.
        let (low_m, size_m) = (Vec3::from_slice(&data.bounds), Vec3::from_slice(&data.bounds[3..]));
        let mut within = 0;
        for step in 0..2000 {
            let along = step as f32 / 2000.0;
            let at_m = low_m + size_m * Vec3::new(along, (7.1 * along).fract(), (0.5 + 3.3 * along).fract());
            let (_, out) = data.irradiance(at_m, Vec3::Y);
            if (0..data.tetrahedra.len() / 4).any(|other| data.shares(other, at_m).1 < 1e-6) {
                assert!(out < 1e-3, "{out} out of the tetrahedron at {at_m}, lattice: {is_lattice}");
                within += 1;
            }
        }
        assert!(within > 1000, "{within} of 2000 points lie in tetrahedra");
    }
}

#[derive(Debug)]
struct Sparse {
    probe_at: Vec<u32>,
    positions_m: Vec<Vec4>,
}

impl FreeSpace for Sparse {
    fn spacing_m(&self) -> f32 {
        0.5
    }

    fn lattice(&self) -> Option<Lattice<'_>> {
        let Self { probe_at, .. } = self;
        let is_there = !probe_at.is_empty();
        is_there.then_some(Lattice {
            spacing_m: 0.5,
            low: IVec3::NEG_ONE,
            size: IVec3::new(3, 2, 2),
            probe_at,
        })
    }

    fn tetrahedra(&self) -> Option<Tetrahedra<'_>> {
        None
    }

    fn positions_m(&self) -> &[Vec4] {
        &self.positions_m
    }

    fn distance_m(&self, _: u32, _: Vec3) -> f32 {
        f32::INFINITY
    }
}

#[test]
fn points_without_a_probe_take_that_of_the_nearest_and_wrong_light_is_refused() {
    let mut probe_at = vec![NO_PROBE; 12];
    (probe_at[0], probe_at[8]) = (1, 0);
    let sparse = Sparse { probe_at, positions_m: vec![Vec4::ZERO; 2] };
    let light = vec![Vec4::ONE; 2 * PROBE_COEFFICIENTS];
    let volume = Volume::new(&sparse, &light);
    assert_eq!(volume.probe_of, [1, 1, 0, 1, 1, 0, 1, 0, 0, 1, 0, 0]);
    assert_eq!(volume.lattice.point(8), IVec3::new(1, -1, 0));
    let all = files(&sparse, &light, &ProbeFormat::ALL).unwrap();
    assert_eq!(all.files.len(), 6);
    assert!(all.files.iter().all(|(name, _)| is_file(name)) && all.warnings.is_empty());
    let one = files(&sparse, &light, &[ProbeFormat::Unity]).unwrap();
    assert_eq!(one.files.len(), 1);
    assert!(one.extras.get("cube").is_none() && one.extras.get("unity").is_some());
    let refused = |light: &[Vec4]| files(&sparse, light, &ProbeFormat::ALL).unwrap_err().to_string();
    assert!(refused(&light[1..]).contains("17 coefficients, there are 18"));
    let endless = vec![Vec4::INFINITY; 2 * PROBE_COEFFICIENTS];
    assert!(refused(&endless).contains("no finite number"));
}
