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
use lightkiln_proto::manifest::{Glass, Manifest};

use crate::error::{ClientError, Result};
use crate::fetch::Source;

pub use draws::{DrawTable, LoadedDraw, Vertex};
pub use lightmap::{LightmapLayout, MAX_ATLAS_TEXELS, MAX_PAGE_SIDE, MAX_PAGES, NO_BLOCK, PlacedBlock};
pub use objects::{Object, ObjectShape, Rigid, Stance};
pub(crate) use objects::{PosedDraw, bounds_of, check_stances};
pub use recolour::{ALBEDO_MAX, Albedo, Recolour, Tints, check_recolours};
pub use texture::Texture;
pub(crate) use texture::srgb_of_linear;

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

fn check_textures(manifest: &Manifest, count: usize) -> Result<()> {
    for (index, material) in manifest.materials.iter().enumerate() {
        let mut uses = objects::uses(material);
        if let Some(bad) = uses.find(|used| used.texture as usize >= count) {
            let problem = format!("names texture {} of {count}", bad.texture);
            return Err(ClientError::inconsistent(format!("material {index}"), problem));
        }
    }
    Ok(())
}
