//! An export of Lightkiln in Bevy 0.20. Not run by Lightkiln's tests: written by the documentation and sources of Bevy's crates.
//!
//! `cargo run -- cornell-lit` shows `assets/cornell-lit/scene.glb`.

use std::collections::HashSet;
use std::f32::consts::PI;

use bevy::camera::Exposure;
use bevy::gltf::GltfMaterialExtras;
use bevy::light::GlobalAmbientLight;
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

fn main() {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "cornell-lit".to_owned());
    App::new()
        .add_plugins(DefaultPlugins)
        .insert_resource(Export(folder))
        // All light is in the pages.
        .insert_resource(GlobalAmbientLight { brightness: 0.0, ..default() })
        .add_systems(Startup, load)
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
