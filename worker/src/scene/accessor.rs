//! Reading accessors: strided, sparse, normalised and quantised, with every range checked once on opening.
//!
//! The `gltf` crate's iterators panic on views that are too short and do not read KHR_mesh_quantization, so this
//! reader is ours.

use gltf::json::accessor::{ComponentType, Type, sparse};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root};

use super::buffers::{Buffers, slice};
use super::document;
use super::error::{ImportError, Result};
use super::limits::{self, Budget, within};

/// An accessor whose every element is known to lie inside its buffers.
pub(super) struct Reader<'a> {
    /// Bytes from the first element on; `None` when all elements are zero but for the sparse ones.
    dense: Option<&'a [u8]>,
    stride: usize,
    layout: Layout,
    count: usize,
    sparse: Option<Sparse<'a>>,
}

/// Layout of one element.
#[derive(Clone, Copy)]
struct Layout {
    component: ComponentType,
    component_count: usize,
    is_normalized: bool,
}

/// Elements that replace dense ones: indices in strictly rising order, and their packed values.
struct Sparse<'a> {
    indices: &'a [u8],
    index_type: ComponentType,
    values: &'a [u8],
    count: usize,
}

/// Allowed use of an accessor, and its user.
pub(super) struct Wanted<'w> {
    /// Quantity read, for messages.
    pub(super) place: &'w dyn Fn() -> String,
    /// Element types that fit.
    pub(super) types: &'w [Type],
    /// Elements needed at least; the rest is never read.
    pub(super) min_count: usize,
    /// Read integers as fractions even when the file forgot to say so.
    pub(super) is_always_normalized: bool,
}

impl<'a> Reader<'a> {
    /// Opens an accessor for `wanted`, checking type, count and all ranges.
    pub(super) fn open(
        root: &'a Root,
        buffers: &'a Buffers<'a>,
        sparse_budget: &mut Budget,
        index: Index<Accessor>,
        wanted: &Wanted<'_>,
    ) -> Result<Self> {
        let accessor = document::get(root, index, "accessor", wanted.place)?;
        let place = || format!("{} (accessor {})", (wanted.place)(), index.value());
        let fail = |problem: &str| ImportError::Accessor { place: place(), problem: problem.to_owned() };
        let (Checked::Valid(component), Checked::Valid(kind)) = (accessor.component_type, accessor.type_)
        else {
            return Err(fail("its type is not one of glTF's"));
        };
        if !wanted.types.contains(&kind) {
            return Err(fail(&format!("it has elements of type {kind:?}, which do not fit here")));
        }
        let count = usize::try_from(accessor.count.0).map_err(|_| fail("its count is too big"))?;
        if count < wanted.min_count {
            return Err(fail(&format!("it has {count} elements where {} are needed", wanted.min_count)));
        }
        let layout = Layout {
            component: component.0,
            component_count: kind.multiplicity(),
            is_normalized: accessor.normalized || wanted.is_always_normalized,
        };
        let mut reader = Self { dense: None, stride: layout.element_bytes(), layout, count, sparse: None };
        match buffers.unpacked(index) {
            Some(bytes) => reader.dense = Some(reader.spanned(bytes, 0, &place)?),
            None => reader.open_dense(root, buffers, accessor, &place)?,
        }
        if let Some(sparse) = &accessor.sparse {
            sparse_budget.spend(sparse.count.0)?;
            reader.sparse = Some(Sparse::open(buffers, sparse, &reader, &place)?);
        }
        Ok(reader)
    }

    fn open_dense(
        &mut self,
        root: &Root,
        buffers: &'a Buffers<'a>,
        accessor: &Accessor,
        place: &dyn Fn() -> String,
    ) -> Result<()> {
        let Some(view_index) = accessor.buffer_view else {
            return within(limits::ZERO_ELEMENTS, accessor.count.0, buffers.limits().zero_elements);
        };
        let view = document::get(root, view_index, "buffer view", place)?;
        let bytes = buffers.view(view_index, place)?;
        // Some exporters write a stride of 0 where they mean "packed".
        self.stride = view.byte_stride.filter(|stride| stride.0 != 0).map_or(self.stride, |stride| stride.0);
        self.dense = Some(self.spanned(bytes, accessor.byte_offset.unwrap_or_default().0, place)?);
        Ok(())
    }

    /// The bytes of all elements, or who has too few.
    fn spanned(&self, bytes: &'a [u8], offset: u64, place: &dyn Fn() -> String) -> Result<&'a [u8]> {
        let found = self.span_bytes().and_then(|span| slice(bytes, offset, span));
        found.ok_or_else(|| ImportError::Accessor {
            place: place(),
            problem: format!(
                "its {} elements from byte {offset} do not fit into its view of {} bytes",
                self.count,
                bytes.len()
            ),
        })
    }

    /// Bytes from the start of the first element to the end of the last.
    fn span_bytes(&self) -> Option<u64> {
        let Some(gaps) = self.count.checked_sub(1) else { return Some(0) };
        (gaps as u64).checked_mul(self.stride as u64)?.checked_add(self.layout.element_bytes() as u64)
    }

    /// Count of elements.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Bytes of an element.
    pub(super) fn element_bytes(&self) -> usize {
        self.layout.element_bytes()
    }

    /// Appends the bytes of all elements, each `stride` after the one before it; those between are 0.
    pub(super) fn pack(&self, stride: usize, bytes: &mut Vec<u8>) {
        let start = bytes.len();
        bytes.resize(start + self.count * stride, 0);
        for (index, packed) in bytes[start..].chunks_exact_mut(stride.max(1)).enumerate() {
            if let Some(element) = self.element(index) {
                packed[..element.len()].copy_from_slice(element);
            }
        }
    }

    /// Element `index` as floats, normalised if the accessor is; components that it lacks are `missing`.
    ///
    /// `index` is below [`Self::count`].
    pub(super) fn floats<const N: usize>(&self, index: usize, missing: f32) -> [f32; N] {
        let mut element = [missing; N];
        let Some(bytes) = self.element(index) else {
            element[..self.layout.component_count.min(N)].fill(0.0);
            return element;
        };
        let components = bytes.chunks_exact(self.layout.component.size());
        for (target, component) in element.iter_mut().zip(components.take(self.layout.component_count)) {
            *target = self.layout.float(component);
        }
        element
    }

    /// Element `index` as an unsigned integer, for index lists; `index` is below [`Self::count`].
    pub(super) fn unsigned(&self, index: usize) -> u32 {
        self.element(index).map_or(0, |bytes| unsigned(self.layout.component, bytes))
    }

    /// Whether elements are unsigned integers.
    pub(super) fn is_unsigned(&self) -> bool {
        is_unsigned(self.layout.component)
    }

    fn element(&self, index: usize) -> Option<&[u8]> {
        if let Some(replaced) = self.sparse.as_ref().and_then(|sparse| sparse.find(index, self.layout)) {
            return Some(replaced);
        }
        let start = index * self.stride;
        self.dense.map(|bytes| &bytes[start..start + self.layout.element_bytes()])
    }
}

impl Layout {
    fn element_bytes(self) -> usize {
        self.component.size() * self.component_count
    }

    /// One component; normalised integers by glTF 2.0 §3.11, the others as they are (KHR_mesh_quantization).
    fn float(self, bytes: &[u8]) -> f32 {
        let scaled = |value: f32, max: f32| if self.is_normalized { (value / max).max(-1.0) } else { value };
        match (self.component, bytes) {
            (ComponentType::I8, &[a]) => scaled(f32::from(i8::from_le_bytes([a])), 127.0),
            (ComponentType::U8, &[a]) => scaled(f32::from(a), 255.0),
            (ComponentType::I16, &[a, b]) => scaled(f32::from(i16::from_le_bytes([a, b])), 32_767.0),
            (ComponentType::U16, &[a, b]) => scaled(f32::from(u16::from_le_bytes([a, b])), 65_535.0),
            (ComponentType::U32, &[a, b, c, d]) => {
                let value = u32::from_le_bytes([a, b, c, d]) as f64;
                (if self.is_normalized { value / f64::from(u32::MAX) } else { value }) as f32
            }
            (ComponentType::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            _ => unreachable!("components are cut to their type's size"),
        }
    }
}

impl<'a> Sparse<'a> {
    fn open(
        buffers: &'a Buffers<'a>,
        stated: &sparse::Sparse,
        reader: &Reader<'_>,
        place: &dyn Fn() -> String,
    ) -> Result<Self> {
        let fail = |problem: &str| ImportError::Accessor { place: place(), problem: problem.to_owned() };
        let Checked::Valid(index_type) = stated.indices.component_type else {
            return Err(fail("its sparse indices are not unsigned integers"));
        };
        let part = |view, offset: u64, element_bytes: usize| {
            let bytes = buffers.view(view, place)?;
            let length = stated.count.0.checked_mul(element_bytes as u64);
            let found = length.and_then(|length| slice(bytes, offset, length));
            found.ok_or_else(|| fail("its sparse elements do not fit into their view"))
        };
        let (indices, values) = (&stated.indices, &stated.values);
        let sparse = Self {
            indices: part(indices.buffer_view, indices.byte_offset.0, index_type.0.size())?,
            index_type: index_type.0,
            values: part(values.buffer_view, values.byte_offset.0, reader.layout.element_bytes())?,
            count: usize::try_from(stated.count.0).map_err(|_| fail("its sparse count is too big"))?,
        };
        let is_rising = (1..sparse.count).all(|slot| sparse.index(slot - 1) < sparse.index(slot));
        let is_in_range = sparse.count == 0 || (sparse.index(sparse.count - 1) as usize) < reader.count;
        if is_rising && is_in_range {
            Ok(sparse)
        } else {
            Err(fail("its sparse indices do not rise within range"))
        }
    }

    fn index(&self, slot: usize) -> u32 {
        let size = self.index_type.size();
        unsigned(self.index_type, &self.indices[slot * size..(slot + 1) * size])
    }

    fn find(&self, index: usize, layout: Layout) -> Option<&[u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = (low + high) / 2;
            if (self.index(middle) as usize) < index { low = middle + 1 } else { high = middle }
        }
        let is_replaced = low < self.count && self.index(low) as usize == index;
        let bytes = layout.element_bytes();
        is_replaced.then(|| &self.values[low * bytes..(low + 1) * bytes])
    }
}

fn is_unsigned(component: ComponentType) -> bool {
    matches!(component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32)
}

/// Little-endian unsigned integer; 0 for component types that are none, which callers have refused.
fn unsigned(component: ComponentType, bytes: &[u8]) -> u32 {
    match (component, bytes) {
        (ComponentType::U8, &[a, ..]) => u32::from(a),
        (ComponentType::U16, &[a, b, ..]) => u32::from(u16::from_le_bytes([a, b])),
        (ComponentType::U32, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]),
        _ => 0,
    }
}
