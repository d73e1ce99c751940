//! Buffer views compressed by meshoptimizer: EXT_meshopt_compression and KHR_meshopt_compression.
//!
//! The codecs are meshoptimizer's own. They are made for bytes that nobody trusts; every size is checked here before room
//! is made for it.

use std::collections::{BTreeMap, BTreeSet};

use gltf::json::mesh::{MorphTarget, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root};
use meshopt as codec;
use serde::Deserialize;

use super::Opening;
use super::buffers::Buffers;
use super::error::{ImportError, Result};
use super::limits::Budget;

/// The extensions: one format, of which the second has more filters.
pub(super) const EXTENSIONS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Most decoded bytes for one compressed byte, by the densest form that a block of vertices can have.
const EXPANSION_MAX: u64 = 1024;

/// The extension of a view.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compression {
    buffer: u32,
    #[serde(default)]
    byte_offset: u64,
    byte_length: u64,
    byte_stride: u64,
    count: u64,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// Decodes every compressed view that a mesh, a skin or an image reads, and an animation that is to be played; gives their
/// bytes by index.
pub(super) fn decode_views(
    root: &Root,
    buffers: &Buffers<'_>,
    opening: Opening,
    budget: &mut Budget,
) -> Result<BTreeMap<usize, Vec<u8>>> {
    let mut decoded = BTreeMap::new();
    if !root.buffer_views.iter().any(|view| extension(view).is_some()) {
        return Ok(decoded);
    }
    for index in views_read(root, opening) {
        let Some(stated) = root.buffer_views.get(index).and_then(extension) else { continue };
        if buffers.has_bytes(root.buffer_views[index].buffer) {
            // The view is there uncompressed too.
            continue;
        }
        let place = || format!("buffer view {index}");
        let fail = |problem: String| ImportError::Compressed { place: place(), problem };
        let view = Compression::deserialize(stated).map_err(|error| fail(error.to_string()))?;
        view.check().map_err(|problem| fail(problem.to_owned()))?;
        let size = view.count.saturating_mul(view.byte_stride);
        budget.spend(size)?;
        let range = (view.byte_offset, view.byte_length);
        let bytes = buffers.range(Index::new(view.buffer), range, &place)?;
        if size / EXPANSION_MAX > bytes.len() as u64 {
            return Err(fail(format!("{} bytes cannot hold its {} elements", bytes.len(), view.count)));
        }
        decoded.insert(index, view.decode(bytes).map_err(|error| fail(error.to_string()))?);
    }
    Ok(decoded)
}

fn extension(view: &gltf::json::buffer::View) -> Option<&serde_json::Value> {
    let others = &view.extensions.as_ref()?.others;
    EXTENSIONS.iter().find_map(|name| others.get(*name))
}

/// Views of the accessors that an import reads, and of images; those of animations where they are to be played.
fn views_read(root: &Root, opening: Opening) -> BTreeSet<usize> {
    let mut read = accessors_read(root);
    if opening == Opening::Moving {
        let samplers = root.animations.iter().flat_map(|animation| &animation.samplers);
        read.extend(samplers.flat_map(|sampler| [sampler.input, sampler.output]).map(|index| index.value()));
    }
    let accessors: Vec<&Accessor> =
        read.into_iter().filter_map(|accessor| root.accessors.get(accessor)).collect();
    let dense = accessors.iter().filter_map(|accessor| accessor.buffer_view);
    let sparse = accessors.iter().filter_map(|accessor| accessor.sparse.as_ref());
    let sparse = sparse.flat_map(|sparse| [sparse.indices.buffer_view, sparse.values.buffer_view]);
    let images = root.images.iter().filter_map(|image| image.buffer_view);
    dense.chain(sparse).chain(images).map(|view| view.value()).collect()
}

fn accessors_read(root: &Root) -> BTreeSet<usize> {
    let is_read = |semantic: &Checked<Semantic>| match semantic {
        Checked::Valid(semantic) => matches!(
            semantic,
            Semantic::Positions
                | Semantic::Normals
                | Semantic::TexCoords(0 | 1)
                | Semantic::Colors(0)
                | Semantic::Joints(_)
                | Semantic::Weights(_)
        ),
        Checked::Invalid => false,
    };
    let mut read = BTreeSet::new();
    for primitive in root.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let attributes = primitive.attributes.iter().filter(|(semantic, _)| is_read(semantic));
        let targets = primitive.targets.iter().flatten();
        let moved = targets.flat_map(|target: &MorphTarget| [target.positions, target.normals]);
        let all = attributes.map(|(_, accessor)| *accessor).chain(primitive.indices).chain(moved.flatten());
        read.extend(all.map(|accessor| accessor.value()));
    }
    let matrices = root.skins.iter().filter_map(|skin| skin.inverse_bind_matrices);
    read.extend(matrices.map(|accessor| accessor.value()));
    read
}

impl Compression {
    /// The sizes that the extension allows.
    fn check(&self) -> Result<(), &'static str> {
        let (stride, filter) = (self.byte_stride, self.filter);
        let stride_fits = match self.mode {
            Mode::Attributes => stride.is_multiple_of(4) && (4..=256).contains(&stride),
            Mode::Triangles | Mode::Indices => matches!(stride, 2 | 4),
        };
        let filter_fits = match filter {
            Filter::None => true,
            _ if self.mode != Mode::Attributes => false,
            Filter::Octahedral | Filter::Color => matches!(stride, 4 | 8),
            Filter::Quaternion => stride == 8,
            Filter::Exponential => true,
        };
        if !stride_fits || !filter_fits {
            return Err("its stride, mode and filter do not fit each other");
        }
        if self.mode == Mode::Triangles && !self.count.is_multiple_of(3) {
            return Err("its triangles are not whole");
        }
        Ok(())
    }

    /// The decoded view; sizes are checked.
    fn decode(&self, bytes: &[u8]) -> codec::Result<Vec<u8>> {
        let count = self.count as usize;
        let wide = |indices: Vec<u32>| bytemuck::pod_collect_to_vec(&indices);
        let narrow = |indices: Vec<u16>| bytemuck::pod_collect_to_vec(&indices);
        match (self.mode, self.byte_stride) {
            (Mode::Triangles, 2) => codec::decode_index_buffer(bytes, count).map(narrow),
            (Mode::Triangles, _) => codec::decode_index_buffer(bytes, count).map(wide),
            (Mode::Indices, 2) => codec::decode_index_sequence(bytes, count).map(narrow),
            (Mode::Indices, _) => codec::decode_index_sequence(bytes, count).map(wide),
            (Mode::Attributes, stride) => {
                let elements = decode_elements(bytes, count, stride)?;
                Ok(filtered(elements, self.filter, stride))
            }
        }
    }
}

/// Bytes of one element; lists of more than 32 bytes have no default of their own.
#[derive(Clone)]
struct Element<const N: usize>([u8; N]);

impl<const N: usize> Default for Element<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn decode_sized<const N: usize>(bytes: &[u8], count: usize) -> codec::Result<Vec<u8>> {
    let elements: Vec<Element<N>> = codec::decode_vertex_buffer(bytes, count)?;
    Ok(elements.iter().flat_map(|element| element.0).collect())
}

/// Decodes elements of `stride` bytes: the codec takes the size as a type's.
fn decode_elements(bytes: &[u8], count: usize, stride: u64) -> codec::Result<Vec<u8>> {
    macro_rules! by_stride {
        ($($size:literal)*) => {
            match stride {
                $($size => decode_sized::<$size>(bytes, count),)*
                _ => unreachable!("the stride was checked"),
            }
        };
    }
    by_stride!(4 8 12 16 20 24 28 32 36 40 44 48 52 56 60 64 68 72 76 80 84 88 92 96 100 104 108 112 116 120 124 128
        132 136 140 144 148 152 156 160 164 168 172 176 180 184 188 192 196 200 204 208 212 216 220 224 228 232 236 240
        244 248 252 256)
}

/// Undoes the filter that made elements compress better.
fn filtered(bytes: Vec<u8>, filter: Filter, stride: u64) -> Vec<u8> {
    /// Applies a filter to the bytes as a list of elements.
    fn apply<T: bytemuck::Pod>(bytes: &[u8], filter: impl FnOnce(&mut [T])) -> Vec<u8> {
        let mut elements: Vec<T> = bytemuck::pod_collect_to_vec(bytes);
        filter(&mut elements);
        bytemuck::pod_collect_to_vec(&elements)
    }
    match (filter, stride) {
        (Filter::None, _) => bytes,
        (Filter::Octahedral, 4) => apply(&bytes, codec::decode_filter_oct::<i8>),
        (Filter::Octahedral, _) => apply(&bytes, codec::decode_filter_oct::<i16>),
        (Filter::Quaternion, _) => apply(&bytes, codec::decode_filter_quat),
        // Each number stands alone.
        (Filter::Exponential, _) => apply(&bytes, codec::decode_filter_exp::<1>),
        (Filter::Color, 4) => apply(&bytes, codec::decode_filter_color::<u8>),
        (Filter::Color, _) => apply(&bytes, codec::decode_filter_color::<u16>),
    }
}
