use glam::{Vec3, Vec4};
use lightkiln_proto::relight::PatchTable;
use lightkiln_proto::scene::SceneCamera;
use lightkiln_proto::voxels::{Start, VoxelTable, WalkHit, walk_within};

use super::*;
use crate::bake::LoadedBake;
use crate::fixture;
use crate::passes::compare::Difference;
use crate::passes::gpu::Gpu;
use crate::passes::shade::{self, SurfaceDetails};
use crate::preview::{Backend, View, render};
use crate::tests::view_of;

/// Rays of a test: where a walk starts and how wide it is, where it goes and how far, and the normal of its start.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
struct Ray {
    at: Vec3,
    tangent: f32,
    direction: Vec3,
    reach_m: f32,
    normal: Vec3,
    pad: f32,
    /// Written by the adapter.
    end: End,
}

/// End of a walk on the adapter.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
struct End {
    element: u32,
    patch: u32,
    t_m: f32,
    is_back: u32,
}

const RAYS_SHADER: &str = concat!(
    walks_source!(),
    "
struct End { element: u32, patch_number: u32, t: f32, is_back: u32 }
struct Ray { at: vec3f, tangent: f32, direction: vec3f, reach: f32, normal: vec3f, pad: f32, end: End }
@group(1) @binding(0) var<storage, read_write> rays: array<Ray>;
@compute @workgroup_size(64)
fn walk_rays(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&rays) {
        return;
    }
    let ray = rays[id.x];
    let hit = walk(ray.at, ray.normal, ray.direction, ray.tangent, ray.reach);
    rays[id.x].end = End(hit.element, hit.of_patch, hit.t, select(0u, 1u, hit.is_back));
}
"
);

/// Random rays: from free space and from surfaces, of several widths, some of them short.
fn rays(table: &VoxelTable, count: u32) -> Vec<Ray> {
    let mut state = 0x1234_5678_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let half_m = 0.5 * fixture::ROOM;
    let mut cube = || Vec3::new(next(), next(), next()) * 2.0 - 1.0;
    (0..count)
        .map(|index| {
            let at = half_m + half_m * cube() * 1.2;
            let direction = match index % 7 {
                // Along an axis, and in planes of the lattice.
                0 => Vec3::from_array(std::array::from_fn(|axis| {
                    if axis == index as usize / 7 % 3 { -1.0 } else { 0.0 }
                })),
                1 => (cube() * Vec3::new(1.0, 0.0, 1.0)).normalize_or(Vec3::X),
                _ => cube().normalize_or(Vec3::X),
            };
            let tangent = [0.0, 0.01, 0.1, 0.6][index as usize / 3 % 4];
            let reach_m = if index % 5 == 0 { 0.8 } else { 3.0e38 };
            let ray =
                Ray { at, tangent, direction, reach_m, normal: Vec3::ZERO, pad: 0.0, end: End::default() };
            // Every second one starts where another one ends, and goes on from there.
            let hit = walk_within(table, &Start::free(at), direction, 0.0, f32::INFINITY);
            match hit.filter(|hit| index % 2 == 0 && hit.element != lightkiln_proto::voxels::NO_ELEMENT) {
                None => ray,
                Some(hit) => {
                    let row = table.elements[hit.element as usize];
                    let normal = if hit.is_back { -row.normal() } else { row.normal() };
                    let away = cube().normalize_or(normal);
                    let direction = away - normal * (2.0 * away.dot(normal).min(0.0));
                    Ray { at: at + ray.direction * hit.t_m, direction, normal, ..ray }
                }
            }
        })
        .collect()
}

fn start_of(ray: &Ray) -> Start {
    if ray.normal == Vec3::ZERO { Start::free(ray.at) } else { Start::on(ray.at, ray.normal) }
}

fn by_adapter(gpu: &Gpu, light: (&VoxelTable, &PatchTable), rays: &[Ray]) -> Vec<End> {
    let lambda = gpu.blank("lambda", 16).unwrap();
    let table = WalkTable::new(gpu, light, &lambda).unwrap();
    let layout = gpu.bind_layout(&[(wgpu::ShaderStages::COMPUTE, crate::passes::gpu::storage_write())]);
    let buffer = gpu.storage("rays", rays).unwrap();
    let group = gpu.bind(&layout, &[buffer.as_entire_binding()]);
    table.run(gpu, (RAYS_SHADER, "walk_rays"), (&layout, &group), (rays.len() as u32).div_ceil(64));
    gpu.read::<Ray>(&buffer, rays.len()).unwrap().iter().map(|ray| ray.end).collect()
}

/// Whether the adapter's end is the twin's, or that of a walk that rounding may take instead: which starts, or goes, by a few millionths aside.
fn agrees(table: &VoxelTable, ray: &Ray, end: &End) -> (bool, bool) {
    let is = |hit: Option<WalkHit>| match hit {
        None => end.element == 0xffff_fffe,
        Some(hit) => {
            end.element == hit.element
                && end.patch == hit.patch
                && (end.is_back == 1) == hit.is_back
                && (end.t_m - hit.t_m).abs() < 1e-4 * (1.0 + hit.t_m)
        }
    };
    let own = is(walk_within(table, &start_of(ray), ray.direction, ray.tangent, ray.reach_m));
    let is_tie = || {
        (0..128_u32).any(|index| {
            let axis = |bit: u32| if index >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let by = Vec3::new(axis(0), axis(1), axis(2)) * if index < 64 { 1e-6 } else { 1e-5 };
            let turn = Vec3::new(axis(3), axis(4), axis(5)) * 1e-6;
            let start = Start { at_m: ray.at + by, ..start_of(ray) };
            let direction = (ray.direction + turn).normalize();
            is(walk_within(table, &start, direction, ray.tangent, ray.reach_m))
        })
    };
    (own, own || is_tie())
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_meets_the_elements_that_the_twin_meets() {
    let (_, mut light) = fixture::voxel_light();
    let patches = &light.transport.columns;
    let table = light.voxels.take().unwrap();
    let rays = rays(&table, 1 << 16);
    let gpu = Gpu::open().unwrap();
    let ends = by_adapter(&gpu, (&table, patches), &rays);
    let mut differ = 0;
    for (ray, end) in rays.iter().zip(&ends) {
        let (same, tie) = agrees(&table, ray, end);
        differ += usize::from(!same);
        assert!(tie, "{ray:?} ends at {end:?}");
    }
    let met = ends.iter().filter(|end| end.element != 0xffff_fffe).count();
    let backs = ends.iter().filter(|end| end.is_back == 1).count();
    println!("{differ} of {} differ by rounding; {met} met something, {backs} a back", rays.len());
    assert!(differ < rays.len() / 500 && met > rays.len() / 3 && met < rays.len() && backs > 100);

    // Sub-voxels that lie one aside, and a lost level, are told.
    let mut moved = table.clone();
    moved.elements.iter_mut().for_each(|row| row.bits = row.bits.map(|bits| bits.rotate_left(1)));
    let mut coarse = table.clone();
    coarse.levels &= !1;
    for wrong in [moved, coarse] {
        let ends = by_adapter(&gpu, (&wrong, patches), &rays);
        let wrongs = rays.iter().zip(&ends).take(4096).filter(|(ray, end)| !agrees(&table, ray, end).1);
        assert!(wrongs.count() > 40);
    }
}

fn drawn(bake: &LoadedBake, view: &View, backend: Backend) -> Vec<Vec4> {
    let linear = render(bake, view, backend).unwrap().linear;
    linear.into_iter().map(|radiance| Vec3::from(radiance).extend(0.0)).collect()
}

fn views(bake: &LoadedBake) -> [(&'static str, View); 4] {
    let view = View { samples: 1, ..view_of(bake) };
    let of = |walks| View { walks, ..view.clone() };
    let none = Walks { reflections: false, ..Walks::default() };
    // From within: walls are dark from behind.
    let inside = [[0.4, 2.2, 0.5], [2.5, 1.0, 3.0]];
    let camera = SceneCamera { eye_m: inside[0], target_m: inside[1], ..view.camera.clone() };
    [
        ("reflections", of(Walks::default())),
        ("occlusion", of(Walks { occlusion_m: Some(0.7), ..none })),
        ("irradiance", of(Walks { irradiance: true, ..none })),
        ("eye", View { camera, ..of(Walks { eye: true, ..none }) }),
    ]
}

/// Each part is drawn alike by both, and told from a picture without it.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_what_walks_make_as_the_processor_does() {
    let bake = fixture::detailed(fixture::voxel_bake());
    for (name, view) in views(&bake) {
        let walks = Walks { reflections: false, ..Walks::default() };
        let without = drawn(&bake, &View { walks, ..view.clone() }, Backend::Cpu);
        let [got, wanted] = [Backend::Gpu, Backend::Cpu].map(|backend| drawn(&bake, &view, backend));
        let difference = Difference::of_mean(&got, &wanted, shade::TOLERANCE);
        println!("{name}: {difference}");
        assert!(difference.agrees(2.0 * shade::OUTLIERS), "{name}: {difference}");
        let other = Difference::of_mean(&got, &without, shade::TOLERANCE);
        assert!(!other.agrees(10.0 * shade::OUTLIERS), "{name} shows nothing: {other}");
    }
}

/// Walks of a quarter of the pixels look like those of all, and edges stay where they are.
#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_takes_walks_of_neighbours_on_the_same_surface() {
    let bake = fixture::detailed(fixture::voxel_bake());
    let (_, view) = views(&bake)[1].clone();
    let halved = View { walks: Walks { step: 2, ..view.walks }, ..view.clone() };
    let [all, some] = [&view, &halved].map(|view| drawn(&bake, view, Backend::Gpu));
    let difference = Difference::of_mean(&some, &all, 0.1);
    println!("{difference}");
    assert!(difference.agrees(0.03) && difference.largest > 0.0, "{difference}");
}

#[test]
fn walks_that_a_bake_has_no_voxels_for_are_refused_and_reflections_left_out() {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let view = View { samples: 1, details: SurfaceDetails::default(), ..view_of(&bake) };
    assert!(render(&bake, &view, Backend::Cpu).is_ok());
    let asks = View { walks: Walks { occlusion_m: Some(1.0), ..Walks::default() }, ..view.clone() };
    let error = render(&bake, &asks, Backend::Cpu).unwrap_err().to_string();
    assert!(error.contains("--set voxels=on"), "{error}");
    let far = View { walks: Walks { occlusion_m: Some(f32::NAN), ..Walks::default() }, ..view };
    assert!(render(&fixture::voxel_bake(), &far, Backend::Cpu).is_err());
}
