//! The manifest: which chunks a bake has, where its blocks lie, and what it was made from.
//!
//! JSON, canonical (sorted keys, no spaces), a pure function of scene and settings.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use utoipa::ToSchema;

use crate::ids::Digest;
use crate::prt::{BlockKey, Settings};
use crate::scene::{LightKind, SceneCamera, SceneLight};

/// Value of [`Manifest::format`].
pub const FORMAT: &str = "lightkiln-manifest";
/// Version of the manifest that this code writes.
pub const VERSION: u32 = 1;
/// Largest manifest that is read.
pub const MAX_BYTES: usize = 256 << 20;

/// A whole bake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Always [`FORMAT`].
    pub format: String,
    /// Version, [`VERSION`].
    pub version: u32,
    /// Kind of bake, `prt`.
    pub kind: String,
    /// Scene bundle that it was made from.
    pub scene: Digest,
    /// Settings, all of them.
    pub settings: Settings,
    /// Texel size used, in metres.
    pub texel_m: f32,
    /// Probe spacing used, in metres.
    pub probe_spacing_m: f32,
    /// Bounds of everything that is drawn, in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Totals.
    pub totals: Totals,
    /// Atlas pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks and where they lie, ascending by key.
    pub blocks: Vec<Block>,
    /// Materials that draws name.
    pub materials: Vec<Material>,
    /// Emissive materials whose strength may be changed at run time.
    pub emitters: Vec<Emitter>,
    /// Lights of the scene's file.
    pub lights: Vec<SceneLight>,
    /// Cameras of the scene's file.
    pub cameras: Vec<SceneCamera>,
    /// Texture images (PNG or JPEG as in the scene), stored as chunks of kind `texture`.
    pub textures: Vec<ChunkRef>,
    /// Geometry chunks.
    pub geometry: Vec<ChunkRef>,
    /// Probe batches.
    pub probes: Vec<ChunkRef>,
    /// Surface patches, one chunk, when the basis is patches.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<ChunkRef>,
    /// Clusters.
    pub clusters: Vec<ClusterRef>,
}

/// Why bytes are no manifest.
#[derive(Debug, Error)]
pub enum ManifestError {
    /// Not the JSON of one.
    #[error("it is no manifest")]
    Json(#[from] serde_json::Error),
    /// Of another format or version.
    #[error(
        "its format is '{format:.40}' version {version}, wanted '{FORMAT}' version {VERSION}; a newer kiln may read it"
    )]
    Format {
        /// Format found.
        format: String,
        /// Version found.
        version: u32,
    },
    /// A number too large for what it says.
    #[error("{what} has a number that is not finite")]
    Number {
        /// Whose number.
        what: &'static str,
    },
}

impl Manifest {
    /// Reads a manifest. Errs unless it is of this version and all its numbers are finite.
    pub fn from_json(bytes: &[u8]) -> Result<Self, ManifestError> {
        let manifest: Self = serde_json::from_slice(bytes)?;
        if manifest.format != FORMAT || manifest.version != VERSION {
            let Self { format, version, .. } = manifest;
            return Err(ManifestError::Format { format, version });
        }
        manifest.check_numbers()?;
        Ok(manifest)
    }

    /// JSON numbers may be larger than an f32 holds.
    fn check_numbers(&self) -> Result<(), ManifestError> {
        if !self.settings.numbers().into_iter().all(f64::is_finite) {
            return Err(ManifestError::Number { what: "a setting" });
        }
        all_finite("the texel's size or the probes' spacing", &[self.texel_m, self.probe_spacing_m])?;
        all_finite("the bounds", self.bounds_m.as_flattened())?;
        for cluster in &self.clusters {
            all_finite("a cluster's bounds", cluster.bounds_m.as_flattened())?;
            let ClusterRef { truncation_error, quantisation_error, uncovered_fraction, .. } = *cluster;
            all_finite("a cluster's errors", &[truncation_error, quantisation_error, uncovered_fraction])?;
        }
        self.materials.iter().try_for_each(Material::check_numbers)?;
        self.lights.iter().try_for_each(check_light)?;
        self.cameras.iter().try_for_each(check_camera)
    }
}

impl Material {
    fn check_numbers(&self) -> Result<(), ManifestError> {
        all_finite("a material's colour", &self.base_colour)?;
        all_finite("a material's emission", &self.emissive)?;
        all_finite("a material's alpha cutoff", self.alpha_cutoff.as_slice())?;
        let uses = self.base_colour_texture.iter().chain(&self.emissive_texture);
        uses.flat_map(|texture| &texture.transform)
            .try_for_each(|transform| all_finite("a texture's transform", transform.as_flattened()))
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
        LightKind::Sky { zenith, horizon } => all_finite(what, &[*zenith, *horizon].concat()),
    }
}

fn check_camera(camera: &SceneCamera) -> Result<(), ManifestError> {
    let what = "a camera";
    all_finite(what, &[camera.eye_m, camera.target_m, camera.up].concat())?;
    all_finite(what, &[camera.fov_y_rad])?;
    all_finite(what, camera.orthographic_half_height_m.as_slice())
}

fn all_finite(what: &'static str, numbers: &[f32]) -> Result<(), ManifestError> {
    if numbers.iter().all(|number| number.is_finite()) { Ok(()) } else { Err(ManifestError::Number { what }) }
}

/// Counts over the whole bake.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Totals {
    /// Receivers.
    pub receivers: u64,
    /// Probes.
    pub probes: u64,
    /// Surface patches, when the basis is patches.
    #[serde(default)]
    pub patches: u64,
    /// Clusters.
    pub clusters: u64,
    /// Triangles drawn.
    pub triangles: u64,
    /// Mean rank over clusters, weighted by receivers.
    pub mean_rank: f64,
    /// Highest rank.
    pub rank_max: u32,
    /// Share of the rays along which light can come, weighted by albedo, whose end no supporting probe sees.
    pub uncovered_fraction: f64,
    /// The part of it that is left out; the rest is spread over the probes that the receiver sees.
    pub left_out_fraction: f64,
    /// Receivers that no light can reach, left out of the clusters: inside solids, or where no probe could stand.
    pub receivers_without_light: u64,
    /// Bytes of all chunks.
    pub bytes: u64,
    /// Bytes of the chunks that relighting needs (probes or patches, and clusters).
    pub bytes_light: u64,
}

/// A block: the receivers of one side of one mesh instance, as a rectangle of texels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Identity; 16 hex digits in JSON, as numbers this large do not survive JavaScript.
    #[serde(with = "hex_key")]
    pub key: BlockKey,
    /// Instance path and side, for people.
    pub name: String,
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Atlas page.
    pub page: u32,
    /// Corner in the page, in texels.
    pub origin: [u32; 2],
}

/// A material to draw with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Name.
    pub name: String,
    /// Linear base colour and alpha.
    pub base_colour: [f32; 4],
    /// Base-colour texture: index into `textures`, and wrap modes of u and v.
    pub base_colour_texture: Option<TextureUse>,
    /// Emitted radiance at emitter scale 1, W·m⁻²·sr⁻¹.
    pub emissive: [f32; 3],
    /// Emissive texture, multiplied in.
    pub emissive_texture: Option<TextureUse>,
    /// Index into `emitters` when it emits.
    pub emitter: Option<u16>,
    /// Texels below this alpha are not drawn.
    pub alpha_cutoff: Option<f32>,
    /// Drawn from both sides.
    pub double_sided: bool,
}

/// A texture and how it is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureUse {
    /// Index into the manifest's textures.
    pub texture: u32,
    /// `repeat`, `clamp` or `mirror`, for u and v.
    pub wrap: [Wrap; 2],
    /// 2×3 affine map from the draw's `uv` to this texture's coordinates; `null` when it is the identity.
    pub transform: Option<[[f32; 3]; 2]>,
}

/// Texture wrap modes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wrap {
    /// Repeat.
    Repeat,
    /// Clamp to edge.
    Clamp,
    /// Mirrored repeat.
    Mirror,
}

/// An emissive material as a light whose strength can change.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Emitter {
    /// Material's name.
    pub name: String,
    /// Emitting area in m².
    pub area_m2: f64,
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

/// A cluster's chunk and what one must know to choose how much of it to fetch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClusterRef {
    /// Digest of its bytes.
    pub digest: Digest,
    /// Length.
    pub bytes: u64,
    /// Bounds of its receivers, in metres.
    pub bounds_m: [[f32; 3]; 2],
    /// Receivers.
    pub receivers: u32,
    /// Supporting probes.
    pub probes: u32,
    /// Rank.
    pub rank: u32,
    /// Relative truncation error √(Σ_{i>k} s²/Σ s²).
    pub truncation_error: f32,
    /// Relative error of quantisation, ‖decoded − exact‖/‖exact‖ of U·ΣVᵀ.
    pub quantisation_error: f32,
    /// As [`Totals::uncovered_fraction`], of this cluster.
    pub uncovered_fraction: f32,
    /// Prefixes of the chunk that are coarser versions, smallest first.
    pub layers: Vec<Layer>,
}

/// A usable prefix of a cluster chunk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Bytes from the start of the chunk.
    pub bytes: u64,
    /// Finest receiver level in it (0 is finest of all).
    pub level: u32,
    /// Highest band in it.
    pub bands: u32,
    /// Rank in it.
    pub rank: u32,
}

mod hex_key {
    use serde::{Deserialize, Deserializer, Serializer, de};

    pub fn serialize<S: Serializer>(key: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{key:016x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.len() != 16 || !text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f')) {
            return Err(de::Error::custom(format_args!(
                "block key '{text:.20}' is not 16 lower-case hex digits"
            )));
        }
        u64::from_str_radix(&text, 16).map_err(de::Error::custom)
    }
}
