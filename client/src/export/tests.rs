//! Exports read back by the readers of others, and their light held against the client's own reads.

use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};

use glam::{Vec2, Vec3, Vec4};
use half::f16;
use lightkiln_proto::manifest::Manifest;

use super::dilate::Charts;
use super::pages::Place;
use super::*;
use crate::bake::LoadedBake;
use crate::fixture;
use crate::passes::atlas::reference::sample;
use crate::preview::{Backend, light_receivers};

/// Largest relative RMS difference of reads everywhere: across walls an engine mixes light of both sides.
const ALL_TOLERANCE: f32 = 0.02;
/// Largest difference of a read inside of linked texels, relative to the light there: half floats keep 11 bits.
const LINKED_TOLERANCE: f32 = 1.5e-3;

/// The fixture's light, which most tests read.
static LIGHT: LazyLock<ReceiverLight> = LazyLock::new(|| settled(&bake()));

fn files() -> Vec<TextureFile> {
    let folder = tempfile::tempdir().unwrap();
    fixture::write_bundle(folder.path(), "prt");
    let source = Source::bundle(folder.path()).unwrap();
    texture_files(&source, &bake()).unwrap()
}

fn bake() -> LoadedBake {
    let mut bake = fixture::prt_bake(&fixture::prt_contents());
    // The texture is a chunk of the bundle alone.
    let folder = tempfile::tempdir().unwrap();
    let Manifest { chunks, .. } = fixture::write_bundle(folder.path(), "prt");
    Arc::make_mut(&mut bake.scene).manifest.chunks = chunks;
    bake
}

fn settled(bake: &LoadedBake) -> ReceiverLight {
    light_receivers(bake, fixture::lights(), None, vec![1.0], Backend::Cpu).unwrap().settled.light
}

fn exported(bake: &LoadedBake, options: Options<'_>) -> Exported {
    export(bake, &files(), &LIGHT, &[1.0], options).unwrap()
}

/// A page as an engine has it.
struct Page {
    size: [u32; 2],
    texels: Vec<Vec3>,
}

impl Page {
    fn read(bytes: &[u8], intensity: f32) -> Self {
        let reader = ::ktx2::Reader::new(bytes).unwrap();
        let header = reader.header();
        let size = [header.pixel_width, header.pixel_height];
        let level = reader.levels().next().unwrap();
        let bytes = zstd::bulk::decompress(level.data, level.uncompressed_byte_length as usize).unwrap();
        let channels: Vec<f32> =
            bytes.chunks_exact(2).map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32()).collect();
        let texels = channels.chunks_exact(4).map(|texel| {
            assert_eq!(texel[3], 1.0);
            Vec3::from_slice(texel) * intensity
        });
        Self { size, texels: texels.collect() }
    }

    /// A bilinear read, clamped to the edge, as glTF's samplers define it.
    fn bilinear(&self, uv: [f32; 2]) -> Vec3 {
        let at = Vec2::from(uv) * Vec2::new(self.size[0] as f32, self.size[1] as f32) - 0.5;
        let (base, share) = (at.floor(), at - at.floor());
        let texel = |dx: f32, dy: f32| {
            let column = (base.x + dx).clamp(0.0, self.size[0] as f32 - 1.0) as usize;
            let row = (base.y + dy).clamp(0.0, self.size[1] as f32 - 1.0) as usize;
            self.texels[row * self.size[0] as usize + column]
        };
        let upper = texel(0.0, 0.0).lerp(texel(1.0, 0.0), share.x);
        upper.lerp(texel(0.0, 1.0).lerp(texel(1.0, 1.0), share.x), share.y)
    }
}

/// Relative differences between an engine's reads and the client's, over points of all charts; and those of them at points around
/// which all texels are linked receivers.
struct Compared {
    all: Vec<f32>,
    linked: Vec<f32>,
}

impl Compared {
    fn rms(of: &[f32]) -> f32 {
        (of.iter().map(|difference| difference * difference).sum::<f32>() / of.len().max(1) as f32).sqrt()
    }

    fn most(of: &[f32]) -> f32 {
        of.iter().copied().fold(0.0, f32::max)
    }
}

/// Light at receivers as pages that the client reads.
fn pages_of(bake: &LoadedBake, light: &ReceiverLight, share: Share) -> AtlasPages {
    shown(lightmap_of(bake).unwrap().unwrap(), light, share).unwrap()
}

fn compared(bake: &LoadedBake, exported: &Exported, scale: u32, own: &AtlasPages) -> Compared {
    let scene = &bake.scene;
    let pages: Vec<Page> =
        exported.files[1..].iter().map(|(_, bytes)| Page::read(bytes, exported.intensity)).collect();
    let charts: Charts = charts(&scene.draws, scene.lightmap.blocks.len());
    let sizes: Vec<_> =
        scene.lightmap.blocks.iter().map(|block| Some(block.size.map(|side| side * scale))).collect();
    let places = Pages::pack(&sizes).unwrap();
    assert_eq!(places.sizes, exported.pages);
    let mut found = Compared { all: Vec::new(), linked: Vec::new() };
    let mean = own.pages.iter().flatten().filter(|texel| texel.w > 0.0).map(|texel| texel.x).sum::<f32>()
        / own.pages.iter().flatten().filter(|texel| texel.w > 0.0).count() as f32;
    for (block, (place, chart)) in places.places.iter().zip(&charts).enumerate() {
        let place: Place = place.unwrap();
        for [a, b, c] in chart {
            for (u, v) in (0..40).flat_map(|u| (0..40 - u).map(move |v| (u, v))) {
                let [u, v] = [u, v].map(|at| (at as f32 + 0.3) / 40.0);
                let texel = (*a + (*b - *a) * u + (*c - *a) * v).to_array();
                let client = sample(&scene.lightmap, own, block as u32, texel).max(Vec3::ZERO);
                let page = &pages[place.page as usize];
                let engine = page.bilinear(meshes::page_uv(texel, &place, page.size, scale));
                let difference = (engine - client).abs().max_element() / client.max_element().max(mean);
                found.all.push(difference);
                if is_linked_around(bake, own, block, texel) {
                    let own = client.max_element().max(1e-6 * mean);
                    found.linked.push((engine - client).abs().max_element() / own);
                }
            }
        }
    }
    assert!(found.all.len() > 5000 && found.linked.len() > 1000, "{} linked", found.linked.len());
    assert!(found.all.iter().chain(&found.linked).all(|difference| difference.is_finite()));
    found
}

/// All of the four texels around a place are receivers without walls.
fn is_linked_around(bake: &LoadedBake, own: &AtlasPages, block: usize, [x, y]: [f32; 2]) -> bool {
    let block = &bake.scene.lightmap.blocks[block];
    let plain = 1.0 + 15.0;
    [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].iter().all(|(dx, dy)| {
        let [column, row] = [x + dx, y + dy];
        if column < 0.0 || row < 0.0 || column >= block.size[0] as f32 || row >= block.size[1] as f32 {
            return false;
        }
        let [column, row] = [column as u32 + block.origin[0], row as u32 + block.origin[1]];
        let width = own.sizes[block.page as usize][0];
        let texel: Vec4 = own.pages[block.page as usize][(row * width + column) as usize];
        texel.w == plain
    })
}

#[test]
fn engine_reads_the_light_that_the_client_reads() {
    let bake = bake();
    for share in [Share::All, Share::Indirect] {
        let own = pages_of(&bake, &LIGHT, share);
        let of = |scale| {
            compared(&bake, &exported(&bake, Options { share, scale, ..Options::default() }), scale, &own)
        };
        let [once, thrice] = SCALES.map(of);
        for found in [&once, &thrice] {
            assert!(found.linked.len() > 1000, "{}", found.linked.len());
            assert!(Compared::most(&found.linked) < LINKED_TOLERANCE, "{}", Compared::most(&found.linked));
        }
        let errors = [&once, &thrice].map(|found| Compared::rms(&found.all));
        println!("{share:?}: relative RMS {errors:?}, linked {}", Compared::most(&once.linked));
        assert!(errors[0] < ALL_TOLERANCE && errors[1] < 0.6 * errors[0], "{errors:?}");
    }
}

#[test]
fn comparison_tells_other_light_from_the_clients() {
    let bake = bake();
    let found = exported(&bake, Options::default());
    let indirect = pages_of(&bake, &LIGHT, Share::Indirect);
    assert!(Compared::most(&compared(&bake, &found, 1, &indirect).linked) > 100.0 * LINKED_TOLERANCE);
    // Nor is light of half a texel beside it the same.
    let mut moved = pages_of(&bake, &LIGHT, Share::All);
    for page in &mut moved.pages {
        for index in (1..page.len()).rev() {
            page[index] = (0.5 * (page[index] + page[index - 1])).truncate().extend(page[index].w);
        }
    }
    assert!(Compared::most(&compared(&bake, &found, 1, &moved).linked) > 10.0 * LINKED_TOLERANCE);
}

#[test]
fn equal_light_gives_equal_bytes() {
    let bake = bake();
    let options = Options { scale: 3, ..Options::default() };
    let first = exported(&bake, options);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let second = pool.install(|| exported(&bake, options));
    assert_eq!(first, second);
}

#[test]
fn glb_is_valid_and_holds_the_scene_of_the_bundle() {
    let bake = bake();
    let found = exported(&bake, Options::default());
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    let blob = read.blob.clone().unwrap();
    // Five walls, and the sheet's two sides.
    assert_eq!(read.meshes().count(), 7);
    assert_eq!(read.nodes().filter(|node| node.camera().is_some()).count(), 1);
    let mut sheet = Vec::new();
    let mut area = 0.0;
    for mesh in read.meshes() {
        let primitive = mesh.primitives().next().unwrap();
        let material = primitive.material();
        let reader = primitive.reader(|_| Some(&blob));
        let positions: Vec<Vec3> = reader.read_positions().unwrap().map(Vec3::from).collect();
        let normals: Vec<Vec3> = reader.read_normals().unwrap().map(Vec3::from).collect();
        let uv: Vec<[f32; 2]> = reader.read_tex_coords(1).unwrap().into_f32().collect();
        assert_eq!((positions.len(), normals.len(), uv.len()), (4, 4, 4));
        assert!(uv.iter().flatten().all(|at| (0.0..=1.0).contains(at)));
        let corners: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
        for corner in corners.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|index| positions[corner[index] as usize]);
            let across = (b - a).cross(c - a);
            assert!(
                across.dot(normals[corner[0] as usize]) > 0.0,
                "triangles are seen from their normal's side"
            );
            area += 0.5 * across.length();
        }
        let lightmap = material.extension_value(LIGHTMAP).unwrap();
        assert_eq!((lightmap["texCoord"].as_u64(), lightmap["intensity"].as_f64()), (Some(1), Some(1.0)));
        let texture = read.textures().nth(lightmap["index"].as_u64().unwrap() as usize).unwrap();
        let source = texture.extension_value("KHR_texture_basisu").unwrap()["source"].as_u64().unwrap();
        let image = read.images().nth(source as usize).unwrap();
        let gltf::image::Source::Uri { uri, .. } = image.source() else {
            panic!("a page is a file of its own")
        };
        assert!(found.files.iter().any(|(name, _)| name == uri), "{uri}");
        let extras: serde_json::Value =
            serde_json::from_str(material.extras().as_ref().unwrap().get()).unwrap();
        assert_eq!(
            (extras["lightmap"].as_str(), extras["lightmapIntensity"].as_f64()),
            (Some(uri), Some(1.0))
        );
        assert!(!material.double_sided());
        if material.name() == Some("sheet") {
            sheet.push((normals[0], uv, material));
        }
    }
    let own: f32 = bake
        .scene
        .draws
        .draws
        .iter()
        .map(|draw| if draw.back == crate::scene::NO_BLOCK { 1.0 } else { 2.0 } * draw_area(draw))
        .sum();
    assert!((area - own).abs() < 1e-3 * own, "{area} {own}");
    let [front, back] = &sheet[..] else { panic!("{} sides", sheet.len()) };
    assert!((front.0 + back.0).length() < 1e-6 && front.1 != back.1);
    let material = &front.2;
    assert_eq!(material.alpha_mode(), gltf::material::AlphaMode::Mask);
    assert_eq!(material.alpha_cutoff(), Some(0.5));
    let strength = material.emissive_strength().unwrap_or(1.0);
    assert_eq!(material.emissive_factor().map(|channel| channel * strength), [0.3, 0.2, 0.05]);
    let base = material.pbr_metallic_roughness().base_color_texture().unwrap();
    let gltf::image::Source::View { view, mime_type } = base.texture().source().unwrap().source() else {
        panic!("the texture is inside")
    };
    assert_eq!((mime_type, base.tex_coord()), ("image/png", 0));
    assert_eq!(&blob[view.offset()..][..view.length()], files()[0].bytes);
}

fn draw_area(draw: &crate::scene::LoadedDraw) -> f32 {
    let of = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|index| Vec3::from(draw.vertices[index as usize].position_m));
        0.5 * (b - a).cross(c - a).length()
    };
    draw.triangles.iter().map(of).sum()
}

#[test]
fn uv_of_the_file_are_moved_as_its_texture_was() {
    let bake = bake();
    let found = exported(&bake, Options::default());
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    let blob = read.blob.clone().unwrap();
    let mesh =
        read.meshes().find(|mesh| mesh.primitives().any(|of| of.material().name() == Some("sheet"))).unwrap();
    let primitive = mesh.primitives().next().unwrap();
    let uv: Vec<[f32; 2]> =
        primitive.reader(|_| Some(&blob)).read_tex_coords(0).unwrap().into_f32().collect();
    assert_eq!(uv, [[0.1, 0.0], [2.1, 0.0], [2.1, 2.0], [0.1, 2.0]]);
    let sampler =
        primitive.material().pbr_metallic_roughness().base_color_texture().unwrap().texture().sampler();
    use gltf::texture::WrappingMode;
    assert_eq!((sampler.wrap_s(), sampler.wrap_t()), (WrappingMode::Repeat, WrappingMode::MirroredRepeat));
}

#[test]
fn meshes_without_a_place_in_the_lightmap_are_exported_without_light_and_said() {
    let mut bake = bake();
    let scene = Arc::make_mut(&mut bake.scene);
    for draw in &mut scene.draws.draws[4..] {
        draw.back = crate::scene::NO_BLOCK;
    }
    scene.draws.draws[0].front = crate::scene::NO_BLOCK;
    let found = exported(&bake, Options::default());
    assert_eq!(found.warnings.len(), 2, "{:?}", found.warnings);
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    let unlit = read.meshes().filter(|mesh| {
        mesh.primitives().all(|primitive| primitive.material().extension_value(LIGHTMAP).is_none())
    });
    assert_eq!(unlit.count(), 2);
    for draw in &mut Arc::make_mut(&mut bake.scene).draws.draws {
        (draw.front, draw.back) = (crate::scene::NO_BLOCK, crate::scene::NO_BLOCK);
    }
    let found = exported(&bake, Options::default());
    assert_eq!((found.files.len(), found.pages.len()), (1, 0));
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    assert_eq!(read.meshes().count(), 6);
    assert!(read.materials().any(|material| material.double_sided()), "the sheet is one mesh");
}

#[test]
fn light_beyond_half_floats_is_scaled_by_a_power_of_two() {
    let bake = bake();
    let plain = &*LIGHT;
    for factor in [1e9_f32, 1e-9] {
        let scaled = |array: &Vec<Vec4>| array.iter().map(|light| *light * factor).collect();
        let light = ReceiverLight {
            direct: scaled(&plain.direct),
            emit: scaled(&plain.emit),
            indirect: scaled(&plain.indirect),
            probes: Vec::new(),
        };
        let found = export(&bake, &files(), &light, &[], Options::default()).unwrap();
        assert!(found.intensity != 1.0 && found.intensity.log2().fract() == 0.0, "{}", found.intensity);
        let own = pages_of(&bake, &light, Share::All);
        let most = Compared::most(&compared(&bake, &found, 1, &own).linked);
        assert!(most < LINKED_TOLERANCE, "{most}");
    }
}

#[test]
fn dim_texels_beside_bright_ones_keep_their_digits() {
    let places = Pages::pack(&[Some([2, 1])]).unwrap();
    for bright in [1e9_f32, 4e4, 1e-3] {
        let mut block = vec![Vec3::splat(1e-6 * bright); 12];
        block[5] = Vec3::splat(bright);
        let blocks = [block];
        let factor = intensity_of(blocks[0].iter().copied()).unwrap();
        assert!((16_384.0..32_768.0).contains(&(bright / factor)), "{bright} / {factor}");
        let page = Page::read(&page_file(&places, &blocks, 0, factor).unwrap(), factor);
        for (index, light) in blocks[0].iter().enumerate() {
            let found = page.texels[index / 4 * page.size[0] as usize + index % 4];
            assert!((found - *light).abs().max_element() < 6e-4 * light.x, "{found} {light}");
        }
    }
}

#[test]
fn pages_that_not_all_adapters_read_are_said() {
    let found = warnings(Unlit::default(), &[[16_384, 5], [PAGE_MAX, PAGE_MAX], [64, 9000]]);
    assert!(found.len() == 1 && found[0].starts_with("2 pages"), "{found:?}");
}

#[test]
fn glass_and_bright_emission_are_told_by_their_extensions() {
    let mut bake = bake();
    let scene = Arc::make_mut(&mut bake.scene);
    let of = |name: &str| scene.manifest.materials.iter().position(|of| of.name == name).unwrap() as u32;
    let [quarter, half] = [of("quarter"), of("half")];
    scene.draws.draws[0].material = quarter;
    scene.draws.draws[1].material = half;
    let found = export(&bake, &files(), &LIGHT, &[10.0], Options::default()).unwrap();
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    let named = |name: &str| read.materials().find(|material| material.name() == Some(name)).unwrap();
    let (sheet, quarter, half) = (named("sheet"), named("quarter"), named("half"));
    let strength = sheet.emissive_strength().unwrap();
    for (factor, wanted) in sheet.emissive_factor().iter().zip([3.0_f32, 2.0, 0.5]) {
        assert!(*factor <= 1.0 && (factor * strength - wanted).abs() < 1e-5, "{factor} {strength}");
    }
    use gltf::material::AlphaMode;
    let modes = [&sheet, &quarter, &half].map(|material| material.alpha_mode());
    assert_eq!(modes, [AlphaMode::Mask, AlphaMode::Blend, AlphaMode::Opaque]);
    assert_eq!(half.transmission().unwrap().transmission_factor(), 1.0);
    assert!(sheet.transmission().is_none() && quarter.transmission().is_none());
    let roughness = [&sheet, &quarter, &half].map(|of| of.pbr_metallic_roughness().roughness_factor());
    assert_eq!(roughness, [1.0, 1.0, 0.0], "clear glass is not frosted");
    let used: Vec<&str> = read.extensions_used().collect();
    for name in ["KHR_materials_emissive_strength", "KHR_materials_transmission"] {
        assert!(used.contains(&name), "{used:?}");
    }
}

#[test]
fn what_no_light_makes_an_export_is_refused_before_any() {
    let bake = bake();
    check(&bake, &files(), 3).unwrap();
    assert!(check(&bake, &files(), 2).unwrap_err().to_string().contains("--scale 2"));
    assert!(check(&bake, &[], 1).unwrap_err().to_string().contains("0 files of 1"));
}

#[test]
fn light_that_is_no_number_or_of_other_receivers_is_refused() {
    let bake = bake();
    let refused = |change: fn(&mut ReceiverLight)| {
        let mut light = LIGHT.clone();
        change(&mut light);
        let found = export(&bake, &files(), &light, &[], Options::default());
        found.map(|found| found.intensity).unwrap_err().to_string()
    };
    assert!(refused(|light| light.direct[3].x = f32::NAN).contains("finite"));
    assert!(refused(|light| light.indirect[3].y = f32::INFINITY).contains("finite"));
    assert!(refused(|light| light.emit.truncate(3)).contains("receivers"));
    let even = Options { scale: 2, ..Options::default() };
    let error = export(&bake, &files(), &LIGHT, &[], even).unwrap_err().to_string();
    assert!(error.contains("--scale 2"), "{error}");
    let error = export(&bake, &[], &LIGHT, &[], Options::default()).unwrap_err().to_string();
    assert!(error.contains("0 files of 1"), "{error}");
}

#[test]
fn kind_over_probes_is_exported_alike() {
    let bake = fixture::sh_bake();
    let light = settled(&bake);
    let found = export(&bake, &files(), &light, &[], Options::default()).unwrap();
    let own = pages_of(&bake, &light, Share::All);
    assert!(Compared::most(&compared(&bake, &found, 1, &own).linked) < LINKED_TOLERANCE);
}

#[test]
fn textures_of_one_picture_are_written_once() {
    let bake = bake();
    let found = exported(&bake, Options::default());
    let read = gltf::Gltf::from_slice(&found.files[0].1).unwrap();
    let mut by_source: BTreeMap<usize, usize> = BTreeMap::new();
    for texture in read.textures() {
        *by_source.entry(texture.source().unwrap().index()).or_default() += 1;
    }
    // The sheet's on both of its sides; the black texel of all pages.
    assert_eq!(by_source.values().copied().collect::<Vec<_>>(), [found.pages.len(), 1]);
}
