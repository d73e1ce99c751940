//! The manifest: a bake's scene, settings, draws and chunks, and a body that its kind reads.
//!
//! JSON, canonical (sorted keys, no spaces), a pure function of scene and settings. Its clusters, of which there may be a hundred
//! thousand, stand in pages that are chunks, its [`directory`](Manifest::directory).

mod clusters;
mod directory;
mod framing;
mod lightmap;
mod materials;

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use crate::chunk::{CHUNK_BYTES_MAX, ChunkError};
use crate::ids::Digest;
use crate::scene::{LightKind, SceneCamera, SceneLight};

pub use clusters::{
    CLUSTERS, ClusterRow, ClusterTotals, Layer, OVERVIEW, PrefixCheck, check_clusters, with_chunks,
};
pub use directory::{CLUSTERS_MAX, DIRECTORY, DirectoryPage, PAGE_BYTES_MAX, Stored};
pub use framing::{Chosen, Framing};
pub(crate) use lightmap::hex_key;
pub use lightmap::{Block, Lightmap};
pub use materials::{Emitter, Glass, Material, NormalMap, Specular, TextureUse, Wrap};

/// Value of [`Manifest::format`].
pub const FORMAT: &str = "lightkiln-manifest";
/// Version of the manifest that this code reads and writes.
pub const VERSION: u32 = 3;
/// Largest manifest that is read.
pub const MAX_BYTES: usize = 256 << 20;

/// Role of texture chunks: image files as in the scene, in the order in which materials name them.
pub const TEXTURES: &str = "textures";
/// Role of geometry chunks.
pub const GEOMETRY: &str = "geometry";

/// A whole bake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version, [`VERSION`].
    pub version: u32,
    /// Kind of bake: it says what `settings`, `body` and the roles of chunks mean.
    pub kind: String,
    /// Scene bundle of which it was made.
    pub scene: Digest,
    /// Settings of the kind, all of them.
    pub settings: Value,
    /// Bounds of everything that is drawn, in metres; in a scene with a core, of what is near it.
    pub bounds_m: [[f32; 3]; 2],
    /// Triangles drawn.
    pub triangles: u64,
    /// Layout of the lightmap, where the bake has one.
    pub lightmap: Option<Lightmap>,
    /// Materials that draws name.
    pub materials: Vec<Material>,
    /// Emissive materials whose strength may be changed at run time.
    pub emitters: Vec<Emitter>,
    /// Lights of the scene's file.
    pub lights: Vec<SceneLight>,
    /// Cameras of the scene's file.
    pub cameras: Vec<SceneCamera>,
    /// Camera and light that were chosen where the file has none.
    pub framing: Framing,
    /// Chunks by role; [`TEXTURES`], [`GEOMETRY`] and [`DIRECTORY`] are every kind's, the others the kind's own.
    pub chunks: BTreeMap<String, Vec<ChunkRef>>,
    /// Pages of the directory; page i is the i-th chunk of role [`DIRECTORY`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub directory: Vec<DirectoryPage>,
    /// Clusters, of which the directory tells; row i belongs to the i-th chunk of role [`CLUSTERS`].
    #[serde(skip)]
    pub clusters: Vec<ClusterRow>,
    /// Part that the kind alone reads.
    pub body: Value,
}

/// Why bytes are no manifest, or one that cannot be used.
#[derive(Debug, Error)]
pub enum ManifestError {
    /// Not the JSON of one.
    #[error("it is no manifest")]
    Json(#[from] serde_json::Error),
    /// Of another format or version.
    #[error(
        "its format is '{format:.40}' version {version}, wanted '{FORMAT}' version {VERSION}: use the kiln that wrote \
         it, or bake the scene again"
    )]
    Format {
        /// Format found.
        format: String,
        /// Version found.
        version: u64,
    },
    /// A number too large for its type.
    #[error("{what} has a number that is not finite")]
    Number {
        /// Whose number.
        what: &'static str,
    },
    /// A chunk longer than any is.
    #[error(
        "a chunk of '{role:.40}' has {bytes} bytes, and none has more than {CHUNK_BYTES_MAX}: it is damaged"
    )]
    ChunkLength {
        /// Role of the chunk.
        role: String,
        /// Its length.
        bytes: u64,
    },
    /// Of a kind that this program does not know.
    #[error("it is of kind '{kind:.40}'; this kiln knows: {known}")]
    Kind {
        /// Kind found.
        kind: String,
        /// Kinds known.
        known: String,
    },
    /// A page of its directory that cannot be read.
    #[error("page {index} of its directory is damaged: fetch the bake again, or bake it again")]
    Page {
        /// The page's place among all.
        index: usize,
        /// Why.
        #[source]
        source: ChunkError,
    },
    /// Clusters that no page can hold.
    #[error("its clusters cannot be listed")]
    Clusters(#[from] ChunkError),
    /// A body or settings that the kind cannot read.
    #[error("its {part} is not one of kind '{kind}'")]
    Body {
        /// Part of the manifest.
        part: &'static str,
        /// Kind.
        kind: String,
        /// Why.
        #[source]
        source: serde_json::Error,
    },
    /// Two parts that do not agree.
    #[error("{problem}")]
    Contradiction {
        /// The two parts, and how they differ.
        problem: String,
    },
}

/// The part of every version that tells which one it is.
#[derive(Deserialize)]
struct Header {
    format: String,
    version: u64,
}

impl Manifest {
    /// Reads a manifest, but for its clusters, see [`Self::with_directory`]. Errs unless it is of this version, all numbers of its
    /// shared part are finite, no chunk is longer than one may be, so that lengths can be added, and its directory can be read; its
    /// kind checks the rest ([`crate::kinds::Kinds::check`]).
    pub fn from_json(bytes: &[u8]) -> Result<Self, ManifestError> {
        let Header { format, version } = serde_json::from_slice(bytes)?;
        if format != FORMAT || version != u64::from(VERSION) {
            return Err(ManifestError::Format { format, version });
        }
        let manifest: Self = serde_json::from_slice(bytes)?;
        manifest.check_numbers()?;
        manifest.check_lengths()?;
        manifest.check_directory()?;
        Ok(manifest)
    }

    /// Chunks of a role; none where the bake has no such role.
    pub fn chunks(&self, role: &str) -> &[ChunkRef] {
        self.chunks.get(role).map_or(&[], Vec::as_slice)
    }

    /// Bytes of a role's chunks.
    pub fn bytes_of(&self, role: &str) -> u64 {
        self.chunks(role).iter().map(|chunk| chunk.bytes).sum()
    }

    /// Bytes of all chunks.
    pub fn bytes(&self) -> u64 {
        self.chunks.keys().map(|role| self.bytes_of(role)).sum()
    }

    /// Whether chunks of a role are of those that relighting needs: all but meshes, textures, the directory and the overview.
    pub fn is_light(role: &str) -> bool {
        ![TEXTURES, GEOMETRY, DIRECTORY, OVERVIEW].contains(&role)
    }

    /// Bytes of the chunks that relighting needs.
    pub fn bytes_light(&self) -> u64 {
        self.chunks.keys().filter(|role| Self::is_light(role)).map(|role| self.bytes_of(role)).sum()
    }

    /// The body as the kind's own type.
    pub fn body<T: DeserializeOwned>(&self) -> Result<T, ManifestError> {
        self.part("body", &self.body)
    }

    /// The settings as the kind's own type.
    pub fn settings<T: DeserializeOwned>(&self) -> Result<T, ManifestError> {
        self.part("settings", &self.settings)
    }

    /// The lightmap's layout; errs where the bake has none, for kinds that need one.
    pub fn layout(&self) -> Result<&Lightmap, ManifestError> {
        let absent = || ManifestError::Contradiction { problem: "it has no lightmap".into() };
        self.lightmap.as_ref().ok_or_else(absent)
    }

    fn part<T: DeserializeOwned>(&self, part: &'static str, json: &Value) -> Result<T, ManifestError> {
        let kind = || self.kind.clone();
        T::deserialize(json).map_err(|source| ManifestError::Body { part, kind: kind(), source })
    }

    fn check_lengths(&self) -> Result<(), ManifestError> {
        let mut chunks =
            self.chunks.iter().flat_map(|(role, chunks)| chunks.iter().map(move |chunk| (role, chunk)));
        match chunks.find(|(_, chunk)| chunk.bytes > CHUNK_BYTES_MAX as u64) {
            Some((role, chunk)) => Err(ManifestError::ChunkLength { role: role.clone(), bytes: chunk.bytes }),
            None => Ok(()),
        }
    }

    /// JSON numbers may be larger than an f32 holds.
    fn check_numbers(&self) -> Result<(), ManifestError> {
        all_finite("the texel's size", self.lightmap.as_ref().map(|lightmap| lightmap.texel_m).as_slice())?;
        all_finite("the bounds", self.bounds_m.as_flattened())?;
        self.materials.iter().try_for_each(Material::check_numbers)?;
        let Framing { camera, light } = &self.framing;
        self.lights.iter().chain(light.iter().map(|chosen| &chosen.value)).try_for_each(check_light)?;
        self.cameras.iter().chain(camera.iter().map(|chosen| &chosen.value)).try_for_each(check_camera)
    }
}

fn check_light(light: &SceneLight) -> Result<(), ManifestError> {
    let what = "a light";
    all_finite(what, &light.strength)?;
    match &light.kind {
        LightKind::Point { position_m, range_m } => {
            all_finite(what, position_m)?;
            all_finite(what, range_m.as_slice())
        }
        LightKind::Spot { position_m, direction, inner_rad, outer_rad, range_m } => {
            all_finite(what, &[*position_m, *direction].concat())?;
            all_finite(what, &[*inner_rad, *outer_rad])?;
            all_finite(what, range_m.as_slice())
        }
        LightKind::Sun { direction } => all_finite(what, direction),
        LightKind::Rect { position_m, direction, up, size_m, .. } => {
            all_finite(what, &[*position_m, *direction, *up].concat())?;
            all_finite(what, size_m)
        }
        LightKind::Sky { zenith, horizon } => all_finite(what, &[*zenith, *horizon].concat()),
    }
}

fn check_camera(camera: &SceneCamera) -> Result<(), ManifestError> {
    let what = "a camera";
    all_finite(what, &[camera.eye_m, camera.target_m, camera.up].concat())?;
    all_finite(what, &[camera.fov_y_rad])?;
    all_finite(what, camera.orthographic_half_height_m.as_slice())
}

/// Errs unless every number is finite; `what` names whose they are.
pub fn all_finite(what: &'static str, numbers: &[f32]) -> Result<(), ManifestError> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(ManifestError::Number { what }) }
}

/// A chunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChunkRef {
    /// Digest of its bytes.
    pub digest: Digest,
    /// Length.
    pub bytes: u64,
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn read(chunk_bytes: [u64; 2]) -> Result<Manifest, ManifestError> {
        let digest = Digest::of(b"");
        let chunks = chunk_bytes.map(|bytes| json!({ "digest": digest, "bytes": bytes }));
        let manifest = json!({
            "format": FORMAT, "version": VERSION, "kind": "any", "scene": digest, "settings": {},
            "bounds_m": [[0, 0, 0], [1, 1, 1]], "triangles": 0, "lightmap": null, "materials": [], "emitters": [],
            "lights": [], "cameras": [], "framing": {}, "chunks": { "patches": chunks }, "body": {},
        });
        Manifest::from_json(manifest.to_string().as_bytes())
    }

    #[test]
    fn lengths_of_chunks_add_up_or_are_refused_by_their_role() {
        let longest = CHUNK_BYTES_MAX as u64;
        assert_eq!(read([longest, longest]).unwrap().bytes(), 2 * longest);
        for too_long in [longest + 1, u64::MAX - 1] {
            let told = read([2, too_long]).unwrap_err().to_string();
            assert!(told.contains("'patches'") && told.contains(&too_long.to_string()), "{told}");
        }
    }
}
