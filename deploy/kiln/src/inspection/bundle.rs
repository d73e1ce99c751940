//! Figures of a whole bake, from its manifest.

use std::collections::BTreeMap;
use std::fmt;

use lightkiln_proto::kinds::{Figures, Kinds};
use lightkiln_proto::manifest::{Lightmap, Manifest, ManifestError};
use serde::Serialize;
use serde_json::{Map, Value};

/// A bake in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BundleFigures {
    /// Kind of bake.
    pub kind: &'static str,
    /// Triangles drawn.
    pub triangles: u64,
    /// Lightmap, if it has one.
    #[serde(flatten)]
    pub lightmap: Option<LightmapFigures>,
    /// Bytes of all chunks.
    pub bytes_total: u64,
    /// Bytes by role of chunks.
    pub bytes: BTreeMap<String, u64>,
    /// Figures of its kind.
    #[serde(flatten)]
    pub figures: Map<String, Value>,
    /// The same in lines for people.
    #[serde(skip)]
    words: String,
}

/// A lightmap in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LightmapFigures {
    /// Texel size in metres.
    pub texel_m: f32,
    /// Atlas pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks in them.
    pub blocks: usize,
}

impl LightmapFigures {
    fn of(Lightmap { texel_m, pages, blocks }: &Lightmap) -> Self {
        Self { texel_m: *texel_m, pages: pages.clone(), blocks: blocks.len() }
    }
}

impl BundleFigures {
    /// Sums a manifest up; errs when its kind is not in the table, or does not know its body.
    pub fn of(kinds: &Kinds, manifest: &Manifest) -> Result<Self, ManifestError> {
        let kind = kinds.check(manifest)?;
        let Figures { json: figures, words } = kind.inspection(manifest)?;
        let bytes = manifest.chunks.keys().map(|role| (role.clone(), manifest.bytes_of(role))).collect();
        Ok(Self {
            kind: kind.name(),
            triangles: manifest.triangles,
            lightmap: manifest.lightmap.as_ref().map(LightmapFigures::of),
            bytes_total: manifest.bytes(),
            bytes,
            figures,
            words,
        })
    }
}

impl fmt::Display for BundleFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "kind        {}", self.kind)?;
        writeln!(f, "triangles   {}", self.triangles)?;
        if let Some(LightmapFigures { texel_m, pages, blocks }) = &self.lightmap {
            writeln!(f, "pages       {pages:?} of {blocks} blocks, texel {texel_m} m")?;
        }
        write!(f, "bytes       {}:", self.bytes_total)?;
        for (role, bytes) in &self.bytes {
            write!(f, " {role} {bytes}")?;
        }
        write!(f, "\n{}", self.words)
    }
}
