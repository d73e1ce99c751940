//! An export of Lightkiln in Bevy 0.20. Not run by Lightkiln's tests: written by the documentation and sources of Bevy's crates.
//!
//! `cargo run -- cornell-lit` shows `assets/cornell-lit/scene.glb`.

use std::collections::HashSet;
use std::f32::consts::PI;

use bevy::camera::Exposure;
use bevy::gltf::GltfMaterialExtras;
use bevy::light::{GlobalAmbientLight, IrradianceVolume, LightProbe};
use bevy::pbr::Lightmap;
use bevy::prelude::*;
use serde::Deserialize;

/// cd·m⁻² of a radiance of 1 W·m⁻²·sr⁻¹: what the scene's watts are worth beside other lights of the game.
const LUMINANCE_OF_RADIANCE: f32 = 683.0;

/// Folder of the export below `assets`.
#[derive(Resource)]
struct Export(String);

/// A material's extras, as `kiln export` writes them.
#[derive(Deserialize)]
struct Extras {
    lightmap: String,
    #[serde(rename = "lightmapIntensity")]
    intensity: f32,
}

/// The asset's extras of an export of a bake with light in free space.
#[derive(Deserialize)]
struct SceneExtras {
    probes: Option<Probes>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Probes {
    low_m: [f32; 3],
    spacing_m: f32,
    size: [u32; 3],
    cube: Option<Cube>,
}

#[derive(Deserialize)]
struct Cube {
    file: String,
    intensity: f32,
}

fn main() {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "cornell-lit".to_owned());
    App::new()
        .add_plugins(DefaultPlugins)
        .insert_resource(Export(folder))
        // All light is in the pages.
        .insert_resource(GlobalAmbientLight { brightness: 0.0, ..default() })
        .add_systems(Startup, (load, add_volume))
        .add_systems(Update, add_lightmaps)
        .run();
}

fn load(mut commands: Commands, server: Res<AssetServer>, export: Res<Export>) {
    let scene = GltfAssetLabel::Scene(0).from_asset(format!("{}/scene.glb", export.0));
    commands.spawn(WorldAssetRoot(server.load(scene)));
    // Where Lightkiln's Cornell box is seen from; exports hold cameras too, which Bevy spawns with the scene.
    let exposure = Exposure { ev100: (LUMINANCE_OF_RADIANCE / 1.2).log2() };
    commands.spawn((Camera3d::default(), exposure, Transform::from_xyz(0.0, 2.75, 7.85)));
}

/// The extras of a GLB's asset, which Bevy's loader does not keep: its JSON is the first chunk.
fn scene_extras(folder: &str) -> Option<SceneExtras> {
    let file = std::fs::read(format!("assets/{folder}/scene.glb")).ok()?;
    let length = u32::from_le_bytes(file.get(12..16)?.try_into().ok()?) as usize;
    let json: serde_json::Value = serde_json::from_slice(file.get(20..20 + length)?).ok()?;
    serde_json::from_value(json["asset"]["extras"].clone()).ok()
}

/// Light in free space, for what has no page.
fn add_volume(mut commands: Commands, server: Res<AssetServer>, export: Res<Export>) {
    let Some(probes) = scene_extras(&export.0).and_then(|extras| extras.probes) else { return };
    let Probes { low_m, spacing_m, size, cube: Some(cube) } = probes else { return };
    let size = UVec3::from(size).as_vec3();
    // Voxels' middles are points of the lattice.
    let middle_m = Vec3::from(low_m) + 0.5 * (size - 1.0) * spacing_m;
    commands.spawn((
        LightProbe::default(),
        IrradianceVolume {
            voxels: server.load(format!("{}/{}", export.0, cube.file)),
            intensity: cube.intensity / PI * LUMINANCE_OF_RADIANCE,
            affects_lightmapped_meshes: false,
        },
        Transform::from_translation(middle_m).with_scale(size * spacing_m),
    ));
}

/// Gives new meshes of the export their page, and their material the factor on it.
fn add_lightmaps(
    mut commands: Commands,
    server: Res<AssetServer>,
    export: Res<Export>,
    mut materials: ResMut<Assets<StandardMaterial>>,
    mut changed: Local<HashSet<AssetId<StandardMaterial>>>,
    new: Query<(Entity, &GltfMaterialExtras, &MeshMaterial3d<StandardMaterial>), Added<GltfMaterialExtras>>,
) {
    for (entity, extras, material) in &new {
        let Ok(extras) = serde_json::from_str::<Extras>(&extras.value) else { continue };
        let image = server.load(format!("{}/{}", export.0, extras.lightmap));
        commands.entity(entity).insert(Lightmap { image, ..default() });
        // Meshes share materials: each is changed once.
        if changed.insert(material.id())
            && let Some(mut material) = materials.get_mut(&material.0)
        {
            // Bevy multiplies a page by base colour alone: the 1/π of a diffuse surface stands here.
            material.lightmap_exposure = extras.intensity / PI * LUMINANCE_OF_RADIANCE;
            // Emission is in W·m⁻²·sr⁻¹ as well; without this weight the camera's exposure leaves it out.
            material.emissive *= LUMINANCE_OF_RADIANCE;
            material.emissive_exposure_weight = 1.0;
        }
    }
}
