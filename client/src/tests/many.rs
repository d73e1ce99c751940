//! Ten million receivers.

use lightkiln_proto::content::{ClusterTransport, Receivers, TexelEdge, TransportFactors};
use lightkiln_proto::kinds::prt as prt_kind;
use lightkiln_proto::manifest::Block;
use lightkiln_proto::relight::PatchTable;

use crate::error::{ClientError, Result};
use crate::fixture;
use crate::kinds::prt;
use crate::lightmap::{LightmapLight, LightmapPasses};
use crate::lights::Caster;
use crate::passes::gpu::Gpu;
use crate::passes::meshes::Meshes;
use crate::passes::shadow::{ShadowPass, ShadowPlan};
use crate::scene::LoadedScene;

/// Side of a block in texels.
const SIDE: u32 = 1024;
/// Blocks.
const BLOCKS: u32 = 10;
/// Rows of a block in a cluster.
const ROWS: u32 = 64;

/// The fixture's scene with blocks that no mesh shows.
fn scene() -> LoadedScene {
    let mut manifest = fixture::manifest(prt_kind::NAME);
    let lightmap = manifest.lightmap.as_mut().unwrap();
    let page = lightmap.pages.len() as u32;
    lightmap.pages.push([4 * SIDE, BLOCKS.div_ceil(4) * SIDE]);
    lightmap.blocks.extend((0..BLOCKS).map(|block| Block {
        key: key(block),
        name: format!("block {block}"),
        size: [SIDE; 2],
        page,
        origin: [SIDE * (block % 4), SIDE * (block / 4)],
    }));
    LoadedScene::assemble(manifest, vec![fixture::geometry()], vec![fixture::texture()]).unwrap()
}

fn key(block: u32) -> u64 {
    1000 + u64::from(block)
}

/// Some rows of a block, each of whose receivers reads the first column alone.
fn cluster(block: u32, first_row: u32, column: u64) -> ClusterTransport {
    let texel: Vec<[u16; 2]> =
        (first_row..first_row + ROWS).flat_map(|y| (0..SIDE).map(move |x| [x as u16, y as u16])).collect();
    let count = texel.len();
    let receivers = Receivers {
        blocks: vec![key(block)],
        block: vec![0; count],
        position_m: texel.iter().map(|[x, y]| [f32::from(*x), 0.0, f32::from(*y)]).collect(),
        texel,
        normal: vec![[0.0, 1.0, 0.0]; count],
        albedo: vec![[0.5; 3]; count],
        emission: vec![[0.0; 3]; count],
        links: vec![0; count],
        coverage: vec![u16::MAX; count],
        edge: vec![TexelEdge::NONE; count],
    };
    let factors = TransportFactors {
        keys: vec![column],
        rank: 1,
        u: vec![1.0; count],
        vt: vec![0.25],
        ..TransportFactors::default()
    };
    ClusterTransport { receivers, factors, ..ClusterTransport::default() }
}

/// The fixture's light with ten million receivers beside it.
fn light(scene: &LoadedScene) -> LightmapLight<PatchTable> {
    let mut contents = fixture::prt_contents();
    let column = contents.clusters[0].factors.keys[0];
    for block in 0..BLOCKS {
        contents.clusters.extend((0..SIDE / ROWS).map(|run| cluster(block, ROWS * run, column)));
    }
    let light = prt::assemble(scene, &contents).unwrap();
    let receivers = light.transport.receivers.len();
    assert!(receivers > 10_000_000, "{receivers}");
    light
}

/// The passes of the light, and the receivers that it has.
fn passes(gpu: &Gpu) -> (Result<LightmapPasses>, usize) {
    let scene = scene();
    let light = light(&scene);
    let plan =
        ShadowPlan::new(&Caster::of(&scene.manifest.lights), scene.manifest.bounds_m, 512, None).unwrap();
    let meshes = Meshes::new(gpu, &scene).unwrap();
    let shadow = ShadowPass::new(gpu, &scene, &meshes, &plan.room()).unwrap();
    (LightmapPasses::new(gpu, &scene, &light, &shadow), light.transport.receivers.len())
}

#[test]
#[ignore = "needs 2 GiB of memory and a graphics adapter that binds 161 MiB at once"]
fn ten_million_receivers_load() {
    let gpu = Gpu::open().unwrap();
    let (name, most) = (&gpu.name, gpu.binding_max);
    assert!(most >= 161 << 20, "does not apply: {name} binds {most} bytes at once, fewer than 161 MiB");
    let (passes, receivers) = passes(&gpu);
    assert_eq!(passes.unwrap().resident.receiver_count, receivers);
    gpu.check().unwrap();
}

#[test]
#[ignore = "needs 2 GiB of memory and a graphics adapter"]
fn ten_million_receivers_are_refused_by_name_and_with_a_cure_where_the_adapter_does_not_bind_them() {
    let mut gpu = Gpu::open().unwrap();
    // As the least that WebGPU promises.
    gpu.binding_max = gpu.binding_max.min(128 << 20);
    let (passes, _) = passes(&gpu);
    let Err(error) = passes else { panic!("arrays above the adapter's limit were bound") };
    let told = error.to_string();
    assert!(matches!(error, ClientError::AdapterFull { .. }), "{told}");
    assert!(told.contains(&gpu.binding_max.to_string()) && told.contains("--backend cpu"), "{told}");
}
