//! The table of chunk kinds: numbers, names, sections, and a description of the content. Kinds of bake share the rows here
//! and add their own.

use serde_json::{Value, json};

use super::{
    ChunkError, ChunkKind, cluster, cluster_layers, decode_cluster, decode_directory, decode_geometry,
    decode_patches, decode_texture, directory, geometry, patches, texture,
};
use crate::manifest::Layer;

/// A cluster's factorised transport.
pub const CLUSTER: ChunkKind = ChunkKind(1);
/// Meshes to draw.
pub const GEOMETRY: ChunkKind = ChunkKind(3);
/// An image file as it was in the scene.
pub const TEXTURE: ChunkKind = ChunkKind(4);
/// Surface patches.
pub const PATCHES: ChunkKind = ChunkKind(5);
/// A page of a bake's directory.
pub const DIRECTORY: ChunkKind = ChunkKind(6);

/// Lists the layers of a chunk, of which the first bytes and the whole length are given.
pub type ListLayers = fn(&[u8], u64) -> Result<Vec<Layer>, ChunkError>;

/// One kind of chunk.
#[derive(Clone, Copy, Debug)]
pub struct ChunkRow {
    /// Number in the chunk's header, unique among all rows.
    pub kind: ChunkKind,
    /// Name, for people and in FORMAT.md.
    pub name: &'static str,
    /// Tags of sections and their names.
    pub sections: &'static [(u8, &'static str)],
    /// Decodes a whole chunk and counts its content, by name.
    pub describe: fn(&[u8]) -> Result<Value, ChunkError>,
    /// Lists the prefixes that are coarser versions, smallest first; `None` where a chunk is of use only as a whole.
    pub layers: Option<ListLayers>,
}

/// Rows that kinds of bake share.
pub const SHARED: &[ChunkRow] = &[
    ChunkRow {
        kind: CLUSTER,
        name: "cluster",
        sections: &[
            (cluster::tags::BASE, "base"),
            (cluster::tags::RECEIVERS, "receivers"),
            (cluster::tags::FACTORS, "factors"),
            (cluster::tags::FACTORS_LOW, "factors low"),
            (cluster::tags::NEAR, "near"),
        ],
        describe: describe_cluster,
        layers: Some(cluster_layers),
    },
    ChunkRow {
        kind: GEOMETRY,
        name: "geometry",
        sections: &geometry::tags::ALL,
        describe: describe_geometry,
        layers: None,
    },
    ChunkRow {
        kind: TEXTURE,
        name: "texture",
        sections: &[(texture::tags::FILE, "file")],
        describe: describe_texture,
        layers: None,
    },
    ChunkRow {
        kind: PATCHES,
        name: "patches",
        sections: &[(patches::tags::PATCHES, "patches"), (patches::tags::LEAVES, "leaves")],
        describe: describe_patches,
        layers: None,
    },
    ChunkRow {
        kind: DIRECTORY,
        name: "directory",
        sections: &[(directory::tags::CLUSTERS, "clusters")],
        describe: describe_directory,
        layers: None,
    },
];

fn describe_cluster(bytes: &[u8]) -> Result<Value, ChunkError> {
    let cluster = decode_cluster(bytes)?;
    Ok(json!({
        "receivers": cluster.receivers.len(),
        "blocks": cluster.receivers.blocks.len(),
        "column keys": cluster.factors.keys.len(),
        "bands": cluster.factors.bands,
        "sky": cluster.factors.sky,
        "rank": cluster.factors.rank,
        "emitters": cluster.emitters.len(),
        "near hits": cluster.near.len(),
        "receivers with near hits": cluster.near.ranges().filter(|hits| !hits.is_empty()).count(),
        "bounds_m": cluster.bounds_m,
    }))
}

fn describe_geometry(bytes: &[u8]) -> Result<Value, ChunkError> {
    let draws = decode_geometry(bytes)?.draws;
    Ok(json!({
        "draws": draws.len(),
        "vertices": draws.iter().map(|draw| draw.position_m.len()).sum::<usize>(),
        "triangles": draws.iter().map(|draw| draw.triangles.len()).sum::<usize>(),
    }))
}

fn describe_patches(bytes: &[u8]) -> Result<Value, ChunkError> {
    let set = decode_patches(bytes)?;
    Ok(json!({
        "patches": set.patches.len(),
        "leaves": set.leaf_starts.len().saturating_sub(1),
        "receivers": set.texel.len(),
        "blocks": set.blocks.len(),
        "sky_parts": set.sky_parts,
    }))
}

fn describe_texture(bytes: &[u8]) -> Result<Value, ChunkError> {
    let texture = decode_texture(bytes)?;
    Ok(json!({ "media_type": texture.media_type, "file_bytes": texture.bytes.len() }))
}

fn describe_directory(bytes: &[u8]) -> Result<Value, ChunkError> {
    let (rows, chunks) = decode_directory(bytes)?;
    Ok(json!({
        "clusters": rows.len(),
        "receivers": rows.iter().map(|row| u64::from(row.receivers)).sum::<u64>(),
        "bytes of clusters": chunks.iter().map(|chunk| chunk.bytes).sum::<u64>(),
    }))
}
