//! The parts of a binary glTF file that may be damaged or hostile: the container, the JSON, the items of accessors and
//! the bytes of views, each checked against the file. Knows nothing of what the parts mean.
//!
//! The crate `gltf` (1.4.1) has the container, the JSON's types and the reader of an accessor's items. `Root::get`
//! returns `None` for an index out of range, so every lookup here uses it. Three parts of the crate are not used,
//! because a damaged file makes them panic: `Document` unwraps each index, the validation indexes with POSITION's
//! accessor before it has checked that there is one, and `accessor::Iter` computes an accessor's extent unchecked. The
//! checks of [`GltfFile::items`] replace them.

use gltf::Glb;
use gltf::accessor::util::{Item, ItemIter};
use gltf::accessor::{DataType, Dimensions};
use gltf::json::accessor::{Accessor, GenericComponentType};
use gltf::json::buffer::View;
use gltf::json::validation::Checked;
use gltf::json::{Index, Root};

/// The extension by which coordinates may be whole numbers.
pub const QUANTIZATION: &str = "KHR_mesh_quantization";

/// A binary glTF file whose JSON was read.
pub struct GltfFile<'a> {
    root: Root,
    glb: Glb<'a>,
}

impl<'a> GltfFile<'a> {
    /// Reads the container and the JSON.
    ///
    /// # Errors
    /// If they are damaged, or the file requires an extension; so for all that follow, in words.
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        Self::parse_with(bytes, &[])
    }

    /// The same, of a file that may require the extensions that are `known`.
    pub fn parse_with(bytes: &'a [u8], known: &[&str]) -> Result<Self, String> {
        let glb = container(bytes)?;
        let root = Root::from_slice(&glb.json);
        let root = root.map_err(|e| format!("the glTF JSON cannot be read: {e}"))?;
        let mut required = root.extensions_required.iter();
        if let Some(name) = required.find(|name| !known.contains(&name.as_str())) {
            let name: String = name.chars().take(60).collect();
            return Err(format!(
                "the file requires the glTF extension {name}, which scand does not support"
            ));
        }
        Ok(Self { root, glb })
    }

    /// The JSON.
    pub fn root(&self) -> &Root {
        &self.root
    }

    /// The JSON as it stands in the file.
    pub fn json(&self) -> &[u8] {
        &self.glb.json
    }

    /// The binary chunk; empty if there is none.
    pub fn binary(&self) -> &[u8] {
        self.glb.bin.as_deref().unwrap_or_default()
    }

    /// All numbers of an accessor of scalars, which are of any type that an index or a value of a model may have.
    pub fn numbers(&self, index: Index<Accessor>) -> Result<Vec<f64>, String> {
        fn gather<T: Into<f64>>(items: impl Iterator<Item = T>) -> Vec<f64> {
            items.map(Into::into).collect()
        }
        let one = Dimensions::Scalar;
        match self.root.get(index).and_then(component) {
            Some(kind @ DataType::U8) => self.items::<u8>(index, kind, one).map(gather),
            Some(kind @ DataType::U16) => self.items::<u16>(index, kind, one).map(gather),
            Some(kind @ DataType::U32) => self.items::<u32>(index, kind, one).map(gather),
            // Whatever else it is, or if it is not there, is refused by name.
            _ => self.items::<f32>(index, DataType::F32, one).map(gather),
        }
    }

    /// All points of an accessor: floats, or whole numbers as [`QUANTIZATION`] allows them.
    pub fn points(&self, index: Index<Accessor>) -> Result<Vec<[f32; 3]>, String> {
        fn gather<T: Into<f32>>(points: impl Iterator<Item = [T; 3]>) -> Vec<[f32; 3]> {
            points.map(|point| point.map(Into::into)).collect()
        }
        let three = Dimensions::Vec3;
        match self.root.get(index).and_then(component) {
            Some(kind @ DataType::I8) => self.items::<[i8; 3]>(index, kind, three).map(gather),
            Some(kind @ DataType::U8) => self.items::<[u8; 3]>(index, kind, three).map(gather),
            Some(kind @ DataType::I16) => self.items::<[i16; 3]>(index, kind, three).map(gather),
            Some(kind @ DataType::U16) => self.items::<[u16; 3]>(index, kind, three).map(gather),
            _ => self
                .items::<[f32; 3]>(index, DataType::F32, three)
                .map(gather),
        }
    }

    /// An accessor's items, `kind` and `shape` of which are those of `T`; all of them lie within the file.
    pub fn items<T: Item>(
        &self,
        index: Index<Accessor>,
        kind: DataType,
        shape: Dimensions,
    ) -> Result<impl Iterator<Item = T> + use<'_, 'a, T>, String> {
        let explain = |what: &str| format!("accessor {} {what}", index.value());
        let accessor = self.root.get(index);
        let accessor = accessor.ok_or_else(|| explain("is not there"))?;
        if component(accessor) != Some(kind) {
            return Err(explain(
                "has a component type that scand does not support there",
            ));
        }
        if accessor.type_ != Checked::Valid(shape) {
            let width = shape.multiplicity();
            return Err(explain(&format!(
                "does not have vectors of {width} components"
            )));
        }
        if accessor.sparse.is_some() || accessor.normalized {
            return Err(explain(
                "is sparse or normalised, which scand does not support",
            ));
        }
        let (bytes, stride) = self
            .view(accessor)
            .ok_or_else(|| explain("lies outside the file"))?;
        let size = size_of::<T>();
        let stride = stride.unwrap_or(size);
        if stride < size {
            return Err(explain(&format!(
                "has a stride of {stride} bytes for {size}"
            )));
        }
        // The last element may end where the view does.
        let room = (bytes.len() + stride).saturating_sub(size) / stride;
        let count = accessor.count.0;
        if count > room as u64 {
            return Err(explain(&format!(
                "says it has {count} elements, but has room for only {room}"
            )));
        }
        Ok(ItemIter::new(bytes, stride).take(count as usize))
    }

    /// An accessor's bytes, up to the end of its view, and the view's stride.
    fn view(&self, accessor: &Accessor) -> Option<(&[u8], Option<usize>)> {
        let index = accessor.buffer_view?;
        let stride = self.root.get(index)?.byte_stride.map(|stride| stride.0);
        let offset = usize::try_from(accessor.byte_offset.unwrap_or_default().0).ok()?;
        Some((self.view_bytes(index)?.get(offset..)?, stride))
    }

    /// The bytes of a view; `None` if it lies outside the file.
    pub fn view_bytes(&self, index: Index<View>) -> Option<&[u8]> {
        let view = self.root.get(index)?;
        let start = usize::try_from(view.byte_offset.unwrap_or_default().0).ok()?;
        let end = start.checked_add(usize::try_from(view.byte_length.0).ok()?)?;
        (view.buffer.value() == 0).then_some(self.binary().get(start..end)?)
    }
}

/// The chunks. The crate subtracts the header's length from the file's length as the header gives it, unchecked.
fn container(bytes: &[u8]) -> Result<Glb<'_>, String> {
    const HEADER_BYTES: u32 = 12;
    let length = bytes.get(8..12).and_then(|b| b.try_into().ok());
    if length.is_some_and(|length| u32::from_le_bytes(length) < HEADER_BYTES) {
        return Err("the GLB header gives a length that is shorter than itself".to_owned());
    }
    Glb::from_slice(bytes).map_err(|e| format!("the GLB file cannot be read: {e}"))
}

/// What an accessor's components are; `None` if the specification knows no such kind.
fn component(accessor: &Accessor) -> Option<DataType> {
    match accessor.component_type {
        Checked::Valid(GenericComponentType(kind)) => Some(kind),
        Checked::Invalid => None,
    }
}
