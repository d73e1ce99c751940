//! An export of Lightkiln in Bevy 0.20: `cargo run -- cornell-lit` shows `assets/cornell-lit/scene.glb` from its first camera.
//!
//! | option | effect |
//! |---|---|
//! | `--exposure N` | radiance times N is brightness 1, before the curve |
//! | `--tone linear` | no curve |
//! | `--size WxH` | of the window |
//! | `--object FILE` | shows a glTF of `assets` too, which has no page: the light in free space lights it |
//! | `--at X,Y,Z` | where that object stands, in metres |
//! | `--point X,Y,Z,R,G,B,W` | that point light of `kiln export` shines on the object, and on nothing that has a page |
//! | `--picture FILE` | saves what the window shows, and ends |

use std::collections::HashSet;
use std::f32::consts::PI;
use std::str::FromStr;

use bevy::asset::io::file::FileAssetReader;
use bevy::camera::Exposure;
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::gltf::GltfMaterialExtras;
use bevy::light::{GlobalAmbientLight, IrradianceVolume, LightProbe};
use bevy::pbr::Lightmap;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured, save_to_disk};
use bevy::window::WindowResolution;
use serde::Deserialize;
use serde_json::Value;

/// cd·m⁻² of a radiance of 1 W·m⁻²·sr⁻¹: what the scene's watts are worth beside other lights of the game.
const LUMINANCE_OF_RADIANCE: f32 = 683.0;
/// Frames between the last file and the picture.
const FRAMES: u32 = 30;

/// Wishes of the command line.
#[derive(Resource, Clone)]
struct Wanted {
    /// Folder of the export below `assets`.
    folder: String,
    exposure: f32,
    tone: Tonemapping,
    size: [u32; 2],
    object: Option<String>,
    at_m: Vec3,
    /// Place, colour and power.
    point: Option<[f32; 7]>,
    picture: Option<String>,
}

/// Handles of all that is loaded.
#[derive(Resource, Default)]
struct Loaded(Vec<UntypedHandle>);

/// A material's extras, as `kiln export` writes them.
#[derive(Deserialize)]
struct Extras {
    lightmap: String,
    #[serde(rename = "lightmapIntensity")]
    intensity: f32,
}

/// The lattice of a bake with light in free space, from the asset's extras.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Probes {
    low_m: [f32; 3],
    spacing_m: f32,
    size: [u32; 3],
    cube: Cube,
}

#[derive(Deserialize)]
struct Cube {
    file: String,
    intensity: f32,
}

fn main() -> AppExit {
    let wanted = wanted(std::env::args().skip(1)).unwrap_or_else(|problem| {
        eprintln!("{problem}");
        std::process::exit(2);
    });
    let [width, height] = wanted.size;
    let window = Window {
        title: "Lightkiln in Bevy".to_owned(),
        resolution: WindowResolution::new(width, height).with_scale_factor_override(1.0),
        ..default()
    };
    // A picture is taken once all shaders are there.
    let render = RenderPlugin { synchronous_pipeline_compilation: wanted.picture.is_some(), ..default() };
    App::new()
        .add_plugins(
            DefaultPlugins.set(WindowPlugin { primary_window: Some(window), ..default() }).set(render),
        )
        .insert_resource(wanted)
        .init_resource::<Loaded>()
        // All light is in the pages and in the volume.
        .insert_resource(GlobalAmbientLight { brightness: 0.0, ..default() })
        .insert_resource(ClearColor(Color::BLACK))
        .add_systems(Startup, load)
        .add_systems(Update, take_picture)
        // Scenes are spawned after `Update`.
        .add_systems(PostUpdate, (set_cameras, set_materials))
        .run()
}

/// Reads the command line.
fn wanted(mut words: impl Iterator<Item = String>) -> Result<Wanted, String> {
    let mut wanted = Wanted {
        folder: "cornell-lit".to_owned(),
        exposure: 1.0,
        tone: Tonemapping::AcesFitted,
        size: [1280, 720],
        object: None,
        at_m: Vec3::ZERO,
        point: None,
        picture: None,
    };
    while let Some(word) = words.next() {
        if !word.starts_with("--") {
            wanted.folder = word;
            continue;
        }
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        match word.as_str() {
            "--exposure" => [wanted.exposure] = numbers(&value, ' ')?,
            "--tone" if value == "linear" => wanted.tone = Tonemapping::None,
            "--size" => wanted.size = numbers(&value, 'x')?,
            "--object" => wanted.object = Some(value),
            "--at" => wanted.at_m = Vec3::from(numbers::<f32, 3>(&value, ',')?),
            "--point" => wanted.point = Some(numbers(&value, ',')?),
            "--picture" => wanted.picture = Some(value),
            _ => return Err(format!("{word} {value} is no option")),
        }
    }
    Ok(wanted)
}

/// So many numbers.
fn numbers<T: FromStr, const N: usize>(text: &str, between: char) -> Result<[T; N], String> {
    let found: Result<Vec<T>, _> = text.split(between).map(str::parse).collect();
    found.ok().and_then(|found| found.try_into().ok()).ok_or_else(|| format!("{text} is not understood"))
}

fn load(mut commands: Commands, server: Res<AssetServer>, wanted: Res<Wanted>, mut loaded: ResMut<Loaded>) {
    let scene = server.load(GltfAssetLabel::Scene(0).from_asset(format!("{}/scene.glb", wanted.folder)));
    loaded.0.push(scene.clone().untyped());
    commands.spawn(WorldAssetRoot(scene));
    if let Some(object) = &wanted.object {
        let object = server.load(GltfAssetLabel::Scene(0).from_asset(object.clone()));
        loaded.0.push(object.clone().untyped());
        commands.spawn((WorldAssetRoot(object), Transform::from_translation(wanted.at_m)));
    }
    if let Some(point) = wanted.point {
        commands.spawn(lamp(point));
    }
    let document = document(&wanted.folder).unwrap_or_default();
    // Bevy spawns the cameras of an export with its scene.
    if document["cameras"].as_array().is_none_or(Vec::is_empty) {
        commands.spawn((Camera3d::default(), camera_that_sees_all(&document)));
    }
    let probes = &document["asset"]["extras"]["probes"];
    if let Ok(probes) = serde_json::from_value::<Probes>(probes.clone()) {
        let voxels = server.load(format!("{}/{}", wanted.folder, probes.cube.file));
        loaded.0.push(voxels.clone().untyped());
        commands.spawn(volume(&probes, voxels));
    }
}

/// The JSON of a GLB, its first chunk: Bevy's loader does not keep the asset's extras.
fn document(folder: &str) -> Option<Value> {
    let file = FileAssetReader::get_base_path().join("assets").join(folder).join("scene.glb");
    let file = std::fs::read(file).ok()?;
    let length = u32::from_le_bytes(file.get(12..16)?.try_into().ok()?) as usize;
    serde_json::from_slice(file.get(20..20 + length)?).ok()
}

/// Looks at all meshes, which lie in world space, from the front.
fn camera_that_sees_all(document: &Value) -> Transform {
    let corner =
        |accessor: &Value, name: &str| serde_json::from_value::<[f32; 3]>(accessor[name].clone()).ok();
    let meshes = document["meshes"].as_array().into_iter().flatten();
    let primitives = meshes.flat_map(|mesh| mesh["primitives"].as_array().into_iter().flatten());
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for primitive in primitives {
        let position = primitive["attributes"]["POSITION"].as_u64().unwrap_or(0) as usize;
        let accessor = &document["accessors"][position];
        if let (Some(least), Some(most)) = (corner(accessor, "min"), corner(accessor, "max")) {
            (low, high) = (low.min(Vec3::from(least)), high.max(Vec3::from(most)));
        }
    }
    if low.cmpgt(high).any() {
        return Transform::default();
    }
    let middle = 0.5 * (low + high);
    Transform::from_translation(middle + 1.5 * low.distance(high) * Vec3::Z).looking_at(middle, Vec3::Y)
}

/// Direct light, which a volume has none of.
fn lamp([x, y, z, red, green, blue, power_w]: [f32; 7]) -> impl Bundle {
    let light = PointLight {
        color: Color::linear_rgb(red, green, blue),
        intensity: power_w * LUMINANCE_OF_RADIANCE,
        range: 100.0,
        shadow_maps_enabled: true,
        // Pages have its light already.
        affects_lightmapped_mesh_diffuse: false,
        ..default()
    };
    (light, Transform::from_xyz(x, y, z))
}

/// Light in free space, for what has no page.
fn volume(probes: &Probes, voxels: Handle<Image>) -> impl Bundle + use<> {
    let size = UVec3::from(probes.size).as_vec3();
    // Voxels' middles are points of the lattice.
    let middle_m = Vec3::from(probes.low_m) + 0.5 * (size - 1.0) * probes.spacing_m;
    let volume = IrradianceVolume {
        voxels,
        // Bevy multiplies it by base colour alone, as it does pages.
        intensity: probes.cube.intensity / PI * LUMINANCE_OF_RADIANCE,
        affects_lightmapped_meshes: false,
    };
    (LightProbe::default(), volume, Transform::from_translation(middle_m).with_scale(size * probes.spacing_m))
}

fn set_cameras(mut commands: Commands, wanted: Res<Wanted>, new: Query<Entity, Added<Camera3d>>) {
    for camera in &new {
        // Bevy's exposure is 1 / (1.2 · 2^EV100).
        let exposure = Exposure { ev100: (LUMINANCE_OF_RADIANCE / (1.2 * wanted.exposure)).log2() };
        commands.entity(camera).insert((exposure, wanted.tone, DebandDither::Disabled));
    }
}

/// Gives new meshes of the export their page, and materials the factors on it and on their emission.
fn set_materials(
    mut commands: Commands,
    server: Res<AssetServer>,
    wanted: Res<Wanted>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut changed: Local<HashSet<AssetId<StandardMaterial>>>,
    mut loaded: ResMut<Loaded>,
    new: Query<
        (Entity, Option<&GltfMaterialExtras>, &MeshMaterial3d<StandardMaterial>),
        Added<MeshMaterial3d<StandardMaterial>>,
    >,
) {
    for (entity, extras, material) in &new {
        let extras = extras.and_then(|extras| serde_json::from_str::<Extras>(&extras.value).ok());
        if let Some(extras) = &extras {
            let image = server.load(format!("{}/{}", wanted.folder, extras.lightmap));
            loaded.0.push(image.clone().untyped());
            commands.entity(entity).insert(Lightmap { image, ..default() });
        }
        // Meshes share materials: each is changed once.
        if changed.insert(material.id())
            && let Some(mut material) = materials.get_mut(&material.0)
        {
            // Emission is in W·m⁻²·sr⁻¹; without this weight the camera's exposure leaves it out.
            material.emissive *= LUMINANCE_OF_RADIANCE;
            material.emissive_exposure_weight = 1.0;
            if let Some(extras) = extras {
                // Bevy multiplies a page by base colour alone: the 1/π of a diffuse surface stands here.
                material.lightmap_exposure = extras.intensity / PI * LUMINANCE_OF_RADIANCE;
            }
        }
    }
}

/// Saves the picture some frames after all is loaded.
fn take_picture(
    mut commands: Commands,
    server: Res<AssetServer>,
    wanted: Res<Wanted>,
    loaded: Res<Loaded>,
    drawn: Query<(), With<MeshMaterial3d<StandardMaterial>>>,
    mut frames: Local<u32>,
    mut exit: MessageWriter<AppExit>,
) {
    let Some(picture) = &wanted.picture else { return };
    if loaded.0.iter().any(|handle| server.recursive_dependency_load_state(handle).is_failed()) {
        exit.write(AppExit::error());
    }
    if drawn.is_empty() || !loaded.0.iter().all(|handle| server.is_loaded_with_dependencies(handle)) {
        return;
    }
    *frames += 1;
    if *frames == FRAMES {
        let mut screenshot = commands.spawn(Screenshot::primary_window());
        screenshot.observe(save_to_disk(picture.clone()));
        screenshot.observe(|_: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
            exit.write(AppExit::Success);
        });
    }
}
