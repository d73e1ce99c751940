//! Exports of a real bake, read by the readers of others: an engine's bilinear reads show the light that the client shows.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use glam::{Vec2, Vec3, Vec4};
use half::f16;
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::parse_light;
use lightkiln_client::passes::atlas::reference::{AtlasPages, shown, spread};
use lightkiln_client::preview::{Backend, light_receivers};
use lightkiln_client::scene::LoadedDraw;

use super::processes::{kiln, run};
use super::{SMALL, cornell};

const LIGHT: &str = "point pos=0,1.6,0.3 color=1,0.9,0.7 power=60";
/// Largest relative difference where all four texels are receivers without walls: half floats keep 11 bits.
const LINKED_TOLERANCE: f32 = 1.5e-3;
/// Largest relative RMS difference everywhere: where boxes stand on the floor, an engine mixes light from under them in.
const ALL_TOLERANCE: f32 = 0.05;

fn within(folder: &Path) -> Command {
    let mut command = kiln(folder);
    command.current_dir(folder);
    command
}

fn baked(folder: &Path) {
    let scene = cornell().display().to_string();
    run(within(folder), &[&["bake", &scene, "--out", "own"][..], &SMALL].concat(), 0);
}

/// An export as an engine has it.
struct Engine {
    scene: gltf::Gltf,
    pages: BTreeMap<String, (Vec2, Vec<Vec3>)>,
}

impl Engine {
    fn read(folder: &Path) -> Self {
        let scene = gltf::Gltf::open(folder.join("scene.glb")).unwrap();
        let mut pages = BTreeMap::new();
        for image in scene.images() {
            let gltf::image::Source::Uri { uri, .. } = image.source() else { continue };
            let bytes = fs::read(folder.join(uri)).unwrap();
            let reader = ktx2::Reader::new(&bytes).unwrap();
            let size = [reader.header().pixel_width, reader.header().pixel_height].map(|side| side as f32);
            let level = reader.levels().next().unwrap();
            let bytes = zstd::bulk::decompress(level.data, level.uncompressed_byte_length as usize).unwrap();
            let channel = |pair: &[u8]| f16::from_le_bytes([pair[0], pair[1]]).to_f32();
            let texel = |bytes: &[u8]| Vec3::from([0, 2, 4].map(|at| channel(&bytes[at..at + 2])));
            pages.insert(uri.to_owned(), (Vec2::from(size), bytes.chunks_exact(8).map(texel).collect()));
        }
        Self { scene, pages }
    }

    /// Irradiance that a material shows at coordinates of its page, in W·m⁻².
    fn irradiance(&self, material: &gltf::Material<'_>, uv: Vec2) -> Vec3 {
        let lightmap = material.extension_value("MOZ_lightmap").unwrap();
        let texture = self.scene.textures().nth(lightmap["index"].as_u64().unwrap() as usize).unwrap();
        let image = texture.extension_value("KHR_texture_basisu").unwrap()["source"].as_u64().unwrap();
        let gltf::image::Source::Uri { uri, .. } = self.scene.images().nth(image as usize).unwrap().source()
        else {
            panic!("a page is a file of its own")
        };
        let (size, texels) = &self.pages[uri];
        let at = uv * *size - 0.5;
        let share = at - at.floor();
        let texel = |dx: f32, dy: f32| {
            let inside = (at.floor() + Vec2::new(dx, dy)).clamp(Vec2::ZERO, *size - 1.0);
            texels[inside.y as usize * size.x as usize + inside.x as usize]
        };
        let upper = texel(0.0, 0.0).lerp(texel(1.0, 0.0), share.x);
        let lower = texel(0.0, 1.0).lerp(texel(1.0, 1.0), share.x);
        upper.lerp(lower, share.y) * lightmap["intensity"].as_f64().unwrap() as f32
    }
}

/// A bake under the light, as the client reads it.
struct Client {
    bake: LoadedBake,
    pages: AtlasPages,
}

impl Client {
    fn of(bundle: &Path) -> Self {
        let kinds = lightkiln_client::kinds::all();
        let bake = LoadedBake::load(&Source::bundle(bundle).unwrap(), &kinds).unwrap();
        let lit =
            light_receivers(&bake, vec![parse_light(LIGHT).unwrap()], None, vec![], Backend::Cpu).unwrap();
        let lightmap = bake.light.lightmap(&bake.scene).unwrap();
        let light = lit.settled.light;
        let straight: Vec<Vec4> = light.direct.iter().zip(&light.emit).map(|(a, b)| *a + *b).collect();
        let pages = spread(lightmap.layout, lightmap.texels, &straight, &light.indirect);
        Self { bake, pages }
    }

    fn irradiance(&self, draw: &LoadedDraw, texel: Vec2) -> Option<Vec3> {
        shown(&self.bake.scene.lightmap, &self.pages, draw.front, texel.into())
    }

    /// All of the four texels around a place are receivers without walls.
    fn is_linked_around(&self, draw: &LoadedDraw, texel: Vec2) -> bool {
        let block = self.bake.scene.lightmap.block(draw.front).unwrap();
        [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].iter().all(|(dx, dy)| {
            let at = texel + Vec2::new(*dx, *dy);
            let size = Vec2::new(block.size[0] as f32, block.size[1] as f32);
            let [column, row] = [at.x as u32 + block.origin[0], at.y as u32 + block.origin[1]];
            let page = block.page as usize;
            let index = (row * self.pages.sizes[page][0] + column) as usize;
            // All four links, and no edge.
            at.cmpge(Vec2::ZERO).all() && at.cmplt(size).all() && self.pages.pages[page][index].w == 16.0
        })
    }
}

/// Relative differences of an engine's light from the client's: RMS everywhere, the largest at linked texels, and how many these are.
fn compared(client: &Client, engine: &Engine) -> (f32, f32, usize) {
    let blob = engine.scene.blob.as_ref().unwrap();
    let draws = &client.bake.scene.draws.draws;
    assert_eq!(draws.len(), engine.scene.meshes().count(), "all meshes are seen from one side");
    let (mut squares, mut count, mut most, mut linked) = (0.0_f64, 0, 0.0_f32, 0);
    for (draw, mesh) in draws.iter().zip(engine.scene.meshes()) {
        let primitive = mesh.primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(blob));
        let uv: Vec<Vec2> = reader.read_tex_coords(1).unwrap().into_f32().map(Vec2::from).collect();
        for triangle in &draw.triangles {
            for (u, v) in (0..24).flat_map(|u| (0..24 - u).map(move |v| (u, v))) {
                let [u, v] = [u, v].map(|at| (at as f32 + 0.3) / 24.0);
                let mixed = |of: &dyn Fn(usize) -> Vec2| {
                    let [a, b, c] = triangle.map(|vertex| of(vertex as usize));
                    a + (b - a) * u + (c - a) * v
                };
                let texel = mixed(&|vertex| Vec2::from(draw.vertices[vertex].lightmap_texel));
                let Some(own) = client.irradiance(draw, texel) else { continue };
                let own = own.max(Vec3::ZERO);
                let found = engine.irradiance(&primitive.material(), mixed(&|vertex| uv[vertex]));
                let difference = (found - own).abs().max_element() / own.max_element().max(1.0);
                squares += f64::from(difference).powi(2);
                count += 1;
                if client.is_linked_around(draw, texel) {
                    most = most.max(difference);
                    linked += 1;
                }
            }
        }
    }
    assert!(count > 5000);
    ((squares / f64::from(count)).sqrt() as f32, most, linked)
}

#[test]
fn engine_reads_the_light_of_an_exported_bake() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    baked(folder);
    let export = |out: &str, more: &[&str]| {
        let command = ["export", "own", "--out", out, "--light", LIGHT, "--backend", "cpu", "--json"];
        run(within(folder), &[&command[..], more].concat(), 0).json()
    };
    let told = export("lit", &[]);
    assert_eq!(told["files"].as_array().unwrap().len(), 1 + told["pages"].as_array().unwrap().len());
    assert_eq!((&told["converged"], &told["intensity"]), (&true.into(), &1.0.into()));
    export("fine", &["--scale", "3"]);
    let client = Client::of(&folder.join("own"));
    let [lit, fine] = ["lit", "fine"].map(|out| compared(&client, &Engine::read(&folder.join(out))));
    println!("relative RMS, largest at linked texels, how many: {lit:?}, with three texels for one {fine:?}");
    for (rms, most, linked) in [lit, fine] {
        assert!(rms < ALL_TOLERANCE && most < LINKED_TOLERANCE && linked > 1000, "{rms} {most} {linked}");
    }
    assert!(fine.0 < 0.8 * lit.0, "finer pages keep light to its side of walls");
    // Light without its direct part is told from all of it.
    export("indirect", &["--irradiance", "indirect"]);
    let (rms, most, _) = compared(&client, &Engine::read(&folder.join("indirect")));
    assert!(rms > 2.0 * ALL_TOLERANCE && most > 100.0 * LINKED_TOLERANCE, "{rms} {most}");
    // The same again is the same bytes, in place of what was there.
    let files = |out: &str| -> BTreeMap<_, _> {
        let entries = fs::read_dir(folder.join(out)).unwrap().map(|entry| entry.unwrap());
        entries.map(|entry| (entry.file_name(), fs::read(entry.path()).unwrap())).collect()
    };
    let first = files("lit");
    export("indirect", &[]);
    assert_eq!(first, files("indirect"));
}

#[test]
fn export_that_cannot_be_is_refused_and_leaves_what_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let refused = |arguments: &[&str]| run(within(folder), arguments, 2).stderr();
    let absent = refused(&["export", "absent", "--out", "a"]);
    assert!(absent.contains("manifest.json"), "{absent}");
    baked(folder);
    fs::create_dir(folder.join("diary")).unwrap();
    fs::write(folder.join("diary/monday.txt"), "dear diary").unwrap();
    for (arguments, wanted) in [
        (["--out", "diary"], "monday.txt"),
        (["--out", "own"], "of no export"),
        (["--out", ".."], "ends in no name"),
        (["--light", "lamp"], "'lamp'"),
        (["--scale", "2"], "1 or 3"),
        (["--probes", "cube"], "no light in free space"),
        (["--probes", "cubes"], "'cubes'"),
        (["--material", "blue=0,0,1"], "'blue'"),
    ] {
        let out = if arguments[0] == "--out" { &[][..] } else { &["--out", "a"][..] };
        let said = refused(&[&["export", "own"][..], &arguments, out].concat());
        assert!(said.contains(wanted), "{arguments:?}: {said}");
    }
    assert!(!folder.join("a").exists());
    assert_eq!(fs::read_dir(folder.join("diary")).unwrap().count(), 1);
}
