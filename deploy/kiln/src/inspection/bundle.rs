//! Figures of a whole bake, from its manifest.

use std::collections::BTreeMap;
use std::fmt;

use lightkiln_proto::kinds::{Figures, Kinds};
use lightkiln_proto::manifest::{Manifest, ManifestError};
use serde::Serialize;
use serde_json::{Map, Value};

/// A bake in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BundleFigures {
    /// Kind of bake.
    pub kind: &'static str,
    /// Triangles drawn.
    pub triangles: u64,
    /// Texel size in metres.
    pub texel_m: f32,
    /// Atlas pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks in them.
    pub blocks: usize,
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

impl BundleFigures {
    /// Sums a manifest up; errs when its kind is not in the table, or does not know its body.
    pub fn of(kinds: &Kinds, manifest: &Manifest) -> Result<Self, ManifestError> {
        let kind = kinds.check(manifest)?;
        let Figures { json: figures, words } = kind.inspection(manifest)?;
        let bytes = manifest.chunks.keys().map(|role| (role.clone(), manifest.bytes_of(role))).collect();
        Ok(Self {
            kind: kind.name(),
            triangles: manifest.triangles,
            texel_m: manifest.lightmap.texel_m,
            pages: manifest.lightmap.pages.clone(),
            blocks: manifest.lightmap.blocks.len(),
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
        writeln!(f, "pages       {:?} of {} blocks", self.pages, self.blocks)?;
        write!(f, "bytes       {}:", self.bytes_total)?;
        for (role, bytes) in &self.bytes {
            write!(f, " {role} {bytes}")?;
        }
        write!(f, "\n{}", self.words)
    }
}
