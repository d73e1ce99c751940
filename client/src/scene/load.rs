//! Fetches and decodes the chunks of a scene.

use lightkiln_proto::chunk;
use lightkiln_proto::content::Geometry;
use lightkiln_proto::manifest::{GEOMETRY, Manifest, TEXTURES};

use super::Texture;
use crate::error::Result;
use crate::fetch::{Source, decoded};

/// Geometry and textures of a manifest.
pub(super) fn scene_chunks(source: &Source, manifest: &Manifest) -> Result<(Vec<Geometry>, Vec<Texture>)> {
    let geometry = decoded(source, manifest, GEOMETRY, |bytes| Ok(chunk::decode_geometry(bytes)?))?;
    let textures = decoded(source, manifest, TEXTURES, |bytes| {
        Ok(Texture::decode(&chunk::decode_texture(bytes)?.bytes)?)
    })?;
    Ok((geometry, textures))
}
