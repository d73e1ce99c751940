//! The scene of a bake: manifest, meshes, textures, the lightmap's layout if it has one, and objects beside it.

mod draws;
mod lightmap;
mod load;
mod objects;
mod recolour;
mod texture;

use std::sync::Arc;

use glam::Vec3;
use lightkiln_proto::content::Geometry;
use lightkiln_proto::manifest::{Glass, Manifest, Material, TextureUse};

use crate::error::{ClientError, Result};
use crate::fetch::Source;

pub use draws::{DrawTable, LoadedDraw, Vertex};
pub use lightmap::{LightmapLayout, MAX_ATLAS_TEXELS, MAX_PAGE_SIDE, MAX_PAGES, NO_BLOCK, PlacedBlock};
pub use objects::{Object, ObjectShape, Rigid, Stance, world_from_object};
pub(crate) use objects::{PosedDraw, bounds_of, check_stances, turn_of};
pub use recolour::{ALBEDO_MAX, Albedo, Recolour, Tints, check_recolours};
pub(crate) use recolour::{check_among, named_in};
pub(crate) use texture::srgb_of_linear;
pub use texture::{Encoding, Texture};

/// A scene, ready to be drawn.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// Manifest of the bake.
    pub manifest: Manifest,
    /// Meshes to draw.
    pub draws: DrawTable,
    /// Textures, with mip levels.
    pub textures: Vec<Arc<Texture>>,
    /// Pages of the lightmap, and the blocks in them.
    pub lightmap: LightmapLayout,
    /// Warnings about meshes that are drawn with less than they need.
    pub warnings: Vec<String>,
    /// Objects beside the bake, whose meshes and materials come behind its own.
    objects: Vec<objects::PlacedObject>,
}

impl LoadedScene {
    /// Fetches the manifest and the scene's chunks; the kind's part of the manifest is not checked.
    pub fn load(source: &Source) -> Result<Self> {
        let (_, manifest) = source.manifest()?;
        Self::fetch(source, manifest)
    }

    /// Fetches, verifies and decodes the scene's chunks.
    pub fn fetch(source: &Source, manifest: Manifest) -> Result<Self> {
        let (geometry, textures) = load::scene_chunks(source, &manifest)?;
        Self::assemble(manifest, geometry, textures)
    }

    /// Joins decoded chunks; anything that contradicts the manifest is an error.
    pub fn assemble(manifest: Manifest, geometry: Vec<Geometry>, textures: Vec<Texture>) -> Result<Self> {
        let mut warnings = Vec::new();
        let lightmap = LightmapLayout::new(&manifest)?;
        let draws = draws::join(&manifest, geometry, &lightmap, &mut warnings)?;
        check_textures(&manifest, textures.len())?;
        let textures = encoded(&manifest.materials, textures)
            .map_err(|index| ClientError::inconsistent(format!("texture {index}"), READ_TWICE.to_owned()))?;
        let textures = textures.into_iter().map(Arc::new).collect();
        Ok(Self { manifest, draws, textures, lightmap, warnings, objects: Vec::new() })
    }

    /// Longest way through the scene's bounds in metres.
    pub fn diagonal_m(&self) -> f32 {
        let [low, high] = self.manifest.bounds_m.map(Vec3::from);
        low.distance(high)
    }

    /// The glass that a mesh is of, if it is.
    pub fn glass_of(&self, mesh: &LoadedDraw) -> Option<&Glass> {
        self.manifest.materials[mesh.material as usize].glass.as_ref()
    }

    /// Some mesh is of glass.
    pub fn has_glass(&self) -> bool {
        self.draws.draws.iter().any(|mesh| self.glass_of(mesh).is_some())
    }
}

/// Fault of a texture that one material reads as colours, another as numbers.
const READ_TWICE: &str = "is read as colours and as numbers";

/// Textures, those that materials read as numbers being such; the first that is read as both is an error.
fn encoded(materials: &[Material], textures: Vec<Texture>) -> std::result::Result<Vec<Texture>, usize> {
    let mut reads = vec![[false; 2]; textures.len()];
    let mut note = |used: &TextureUse, of_numbers: usize| {
        reads.get_mut(used.texture as usize).into_iter().for_each(|reads| reads[of_numbers] = true);
    };
    for material in materials {
        material.colour_textures().for_each(|used| note(used, 0));
        material.number_textures().for_each(|used| note(used, 1));
    }
    if let Some(both) = reads.iter().position(|reads| *reads == [true; 2]) {
        return Err(both);
    }
    let all = textures.into_iter().zip(reads);
    Ok(all
        .map(|(texture, [_, of_numbers])| if of_numbers { texture.of_numbers() } else { texture })
        .collect())
}

fn check_textures(manifest: &Manifest, count: usize) -> Result<()> {
    for (index, material) in manifest.materials.iter().enumerate() {
        if let Some(bad) = material.textures().find(|used| used.texture as usize >= count) {
            let problem = format!("names texture {} of {count}", bad.texture);
            return Err(ClientError::inconsistent(format!("material {index}"), problem));
        }
    }
    Ok(())
}
