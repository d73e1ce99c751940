//! Meshes compressed by Draco: KHR_draco_mesh_compression, decoded to the accessors that primitives name.

use std::collections::BTreeMap;

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute, PointIndex};
use gltf::json::accessor::ComponentType;
use gltf::json::buffer::View;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root};
use serde::Deserialize;

use super::buffers::Buffers;
use super::document::{self, primitive_place};
use super::error::{ImportError, Result};
use super::limits::Budget;

/// The extension's name.
pub(super) const EXTENSION: &str = "KHR_draco_mesh_compression";

/// Room for attributes that the bytes hold beside those that the primitive names, in bytes.
const SLACK_BYTES: u64 = 1 << 20;

/// The extension of a primitive: where its bytes are, and which of their attributes is which of the primitive's.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compression {
    buffer_view: u32,
    attributes: BTreeMap<String, u32>,
}

/// Accessors decoded so far, each with the view that it came from.
type Decoded = BTreeMap<usize, (u32, Vec<u8>)>;

/// Decodes all compressed primitives; gives the packed elements of their accessors by index.
pub(super) fn decode_primitives(
    root: &Root,
    buffers: &Buffers<'_>,
    budget: &mut Budget,
) -> Result<BTreeMap<usize, Vec<u8>>> {
    let mut decoded = Decoded::new();
    for (mesh_index, mesh) in root.meshes.iter().enumerate() {
        for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
            let place = || primitive_place(root, mesh_index, primitive_index);
            let others = primitive.extensions.as_ref().map(|extensions| &extensions.others);
            let Some(stated) = others.and_then(|others| others.get(EXTENSION)) else { continue };
            if has_fallback(root, primitive) {
                continue;
            }
            let fail = |problem: String| ImportError::Compressed { place: place(), problem };
            let stated = Compression::deserialize(stated).map_err(|error| fail(error.to_string()))?;
            Source { root, buffers, primitive, stated, place: &place }.decode(budget, &mut decoded)?;
        }
    }
    Ok(decoded.into_iter().map(|(accessor, (_, bytes))| (accessor, bytes)).collect())
}

/// The primitive's vertices are there uncompressed too.
fn has_fallback(root: &Root, primitive: &Primitive) -> bool {
    let has_bytes = |accessor: Index<Accessor>| {
        root.get(accessor).is_some_and(|found| found.buffer_view.is_some() || found.sparse.is_some())
    };
    let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
    positions.copied().is_some_and(has_bytes) && primitive.indices.is_none_or(has_bytes)
}

/// A compressed primitive being read.
struct Source<'s> {
    root: &'s Root,
    buffers: &'s Buffers<'s>,
    primitive: &'s Primitive,
    stated: Compression,
    place: &'s dyn Fn() -> String,
}

impl Source<'_> {
    fn fail(&self, problem: impl Into<String>) -> ImportError {
        ImportError::Compressed { place: (self.place)(), problem: problem.into() }
    }

    /// Adds the primitive's accessors to `decoded`, unless another primitive of the same bytes has.
    fn decode(&self, budget: &mut Budget, decoded: &mut Decoded) -> Result<()> {
        let indices = self.primitive.indices.ok_or_else(|| self.fail("it has no list of indices"))?;
        if !matches!(self.primitive.mode, Checked::Valid(Mode::Triangles)) {
            return Err(self.fail("it is not a list of triangles"));
        }
        let attributes = self.attributes();
        let accessors = || attributes.iter().map(|(accessor, _)| *accessor).chain([indices]);
        let view = self.stated.buffer_view;
        if accessors().all(|accessor| decoded.get(&accessor.value()).is_some_and(|known| known.0 == view)) {
            return Ok(());
        }
        if accessors().any(|accessor| decoded.contains_key(&accessor.value())) {
            return Err(self.fail("it shares an accessor with a mesh of other bytes"));
        }
        let mesh = self.mesh(indices, &attributes, budget)?;
        let faces = self.faces(&mesh, self.accessor(indices)?)?;
        decoded.insert(indices.value(), (view, faces));
        for &(accessor, id) in &attributes {
            decoded.insert(accessor.value(), (view, self.elements(&mesh, self.accessor(accessor)?, id)?));
        }
        Ok(())
    }

    /// The compressed attributes that the primitive names: accessor, and the attribute's id within the bytes.
    fn attributes(&self) -> Vec<(Index<Accessor>, u32)> {
        let id_of = |name: String| self.stated.attributes.get(&name).copied();
        let attributes = self.primitive.attributes.iter();
        attributes
            .filter_map(|(semantic, &accessor)| Some((accessor, id_of(semantic.to_string())?)))
            .collect()
    }

    fn accessor(&self, index: Index<Accessor>) -> Result<&Accessor> {
        document::get(self.root, index, "accessor", self.place)
    }

    /// Decodes the mesh within the sizes that its accessors state.
    fn mesh(
        &self,
        indices: Index<Accessor>,
        attributes: &[(Index<Accessor>, u32)],
        budget: &mut Budget,
    ) -> Result<Mesh> {
        let faces = self.accessor(indices)?.count.0 / 3;
        let (mut points, mut bytes) = (0, 0_u64);
        for &(accessor, _) in attributes {
            let accessor = self.accessor(accessor)?;
            points = accessor.count.0.max(points);
            bytes = bytes.saturating_add(accessor.count.0.saturating_mul(element_bytes(accessor)));
        }
        budget.spend(bytes.saturating_add(faces.saturating_mul(12)))?;
        // Attributes that the primitive does not name are decoded too: tangents, further colours.
        let room = bytes.saturating_mul(2).saturating_add(SLACK_BYTES);
        let limits = DecodeLimits::default().with_max_points(points).with_max_faces(faces);
        let view = self.buffers.view(Index::<View>::new(self.stated.buffer_view), self.place)?;
        let mut mesh = Mesh::new();
        let mut buffer = DecoderBuffer::new(view).with_limits(limits.with_max_decoded_bytes(room));
        MeshDecoder::new().decode(&mut buffer, &mut mesh).map_err(|error| self.fail(error.to_string()))?;
        Ok(mesh)
    }

    /// The faces as a list of indices of the accessor's type.
    fn faces(&self, mesh: &Mesh, accessor: &Accessor) -> Result<Vec<u8>> {
        let component = component_of(accessor).filter(|component| *component != ComponentType::F32);
        let size = component.ok_or_else(|| self.fail("its indices are not unsigned integers"))?.size();
        let mut bytes = Vec::with_capacity(mesh.num_faces() * 3 * size);
        for corner in mesh.faces().iter().flatten() {
            let index = corner.0.to_le_bytes();
            let (stored, rest) = index.split_at(size);
            if rest.iter().any(|byte| *byte != 0) {
                return Err(self.fail(format!("index {} does not fit its type", corner.0)));
            }
            bytes.extend_from_slice(stored);
        }
        Ok(bytes)
    }

    /// An attribute's values, one for each point, packed.
    fn elements(&self, mesh: &Mesh, accessor: &Accessor, id: u32) -> Result<Vec<u8>> {
        let attribute = mesh.attribute_by_unique_id(id);
        let attribute = attribute.ok_or_else(|| self.fail(format!("it has no attribute {id}")))?;
        let size = usize::from(attribute.num_components()) * attribute.data_type().byte_length();
        if type_of(attribute) != component_of(accessor) || size as u64 != element_bytes(accessor) {
            return Err(self.fail(format!("attribute {id} is of another type than its accessor")));
        }
        let stride = attribute.byte_stride().max(0) as usize;
        let mut bytes = Vec::with_capacity(mesh.num_points() * size);
        for point in 0..mesh.num_points() {
            let start = (attribute.mapped_index(PointIndex(point as u32)).0 as usize).saturating_mul(stride);
            let element = attribute.buffer().data().get(start..start.saturating_add(size));
            bytes
                .extend_from_slice(element.ok_or_else(|| self.fail(format!("attribute {id} is too short")))?);
        }
        Ok(bytes)
    }
}

fn component_of(accessor: &Accessor) -> Option<ComponentType> {
    match accessor.component_type {
        Checked::Valid(component) => Some(component.0),
        Checked::Invalid => None,
    }
}

/// glTF's name of an attribute's type, if it has one.
fn type_of(attribute: &PointAttribute) -> Option<ComponentType> {
    match attribute.data_type() {
        DataType::Int8 => Some(ComponentType::I8),
        DataType::Uint8 => Some(ComponentType::U8),
        DataType::Int16 => Some(ComponentType::I16),
        DataType::Uint16 => Some(ComponentType::U16),
        DataType::Uint32 => Some(ComponentType::U32),
        DataType::Float32 => Some(ComponentType::F32),
        _ => None,
    }
}

fn element_bytes(accessor: &Accessor) -> u64 {
    match (component_of(accessor), accessor.type_) {
        (Some(component), Checked::Valid(kind)) => (component.size() * kind.multiplicity()) as u64,
        _ => 0,
    }
}
