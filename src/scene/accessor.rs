//! Buffers, buffer views and accessors. All ranges are checked once, before any element is read.

use std::cell::Cell;
use std::collections::HashMap;

use super::container::{Bytes, Resources};
use super::json::Json;
use super::limits::MAX_CORNERS;
use crate::Result;

/// Number of elements that an accessor without data may have in any file. A larger number must not exceed the bytes of
/// the largest buffer: other attributes of the same vertices are stored there, and nothing else in the file bounds it.
/// So many elements take 256 KiB at most.
const ZERO_FILLED_IN_ANY_FILE: usize = 1 << 12;

/// A buffer view: a byte range of a buffer.
struct View<'a> {
    /// `None` if the buffer has no data in this file. An extension may supply it.
    bytes: Option<&'a [u8]>,
    length: usize,
    stride: Option<usize>,
}

/// Component type (glTF 3.6.2.2).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    /// That of an accessor.
    pub fn of(accessor: &Json) -> Result<Self> {
        let code = accessor.require("componentType")?;
        Component::from_code(code.whole()?).ok_or_else(|| code.error("unknown component type"))
    }

    pub fn from_code(code: usize) -> Option<Self> {
        Some(match code {
            5120 => Component::I8,
            5121 => Component::U8,
            5122 => Component::I16,
            5123 => Component::U16,
            5125 => Component::U32,
            5126 => Component::F32,
            _ => return None,
        })
    }

    pub fn size(self) -> usize {
        match self {
            Component::I8 | Component::U8 => 1,
            Component::I16 | Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    fn unsigned(self, bytes: &[u8]) -> u32 {
        match self {
            Component::U8 => u32::from(bytes[0]),
            Component::U16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            _ => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    fn float(self, bytes: &[u8], normalised: bool) -> f32 {
        let (value, largest) = match self {
            Component::I8 => (f32::from(bytes[0] as i8), 127.0),
            Component::U8 => (f32::from(bytes[0]), 255.0),
            Component::I16 => (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Component::U16 => (f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Component::U32 => return self.unsigned(bytes) as f32,
            Component::F32 => return f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        };
        if normalised { (value / largest).max(-1.0) } else { value }
    }
}

/// Evenly spaced elements in a byte range that holds all of them.
#[derive(Clone, Copy)]
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Elements<'a> {
    fn get(&self, index: usize) -> &'a [u8] {
        &self.bytes[index * self.stride..]
    }
}

/// Overrides of single elements (glTF 3.6.2.3).
struct Sparse<'a> {
    count: usize,
    /// Increasing. They are not copied, because many accessors may share them.
    indices: Elements<'a>,
    index_type: Component,
    values: Elements<'a>,
}

impl<'a> Sparse<'a> {
    /// The bytes that replace element `index`, if it is replaced.
    fn get(&self, index: usize) -> Option<&'a [u8]> {
        let at = |k: usize| self.index_type.unsigned(self.indices.get(k)) as usize;
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            if at(middle) < index { low = middle + 1 } else { high = middle }
        }
        (low < self.count && at(low) == index).then(|| self.values.get(low))
    }
}

/// A checked accessor.
pub(super) struct Accessor<'a> {
    /// Number of elements, at least 1.
    pub count: usize,
    /// Component type.
    pub component: Component,
    /// Components of an element: 1 to 4 for scalars and vectors, more for matrices.
    pub width: usize,
    /// Integers represent [0, 1] or [-1, 1].
    pub normalised: bool,
    /// `None` if all elements are zero before [`Accessor::sparse`] is applied.
    elements: Option<Elements<'a>>,
    sparse: Option<Sparse<'a>>,
    /// The reason why a legal accessor cannot be read.
    unreadable: Option<&'static str>,
    json: Json<'a>,
}

impl Accessor<'_> {
    /// An error at this accessor.
    pub fn error(&self, problem: impl std::fmt::Display) -> crate::Error {
        self.json.error(problem)
    }

    /// The bytes from the start of element `index`. `None` if all of its bytes are zero.
    fn element(&self, index: usize) -> Option<&[u8]> {
        let replaced = self.sparse.as_ref().and_then(|sparse| sparse.get(index));
        replaced.or_else(|| self.elements.map(|elements| elements.get(index)))
    }

    fn check_readable(&self) -> Result<()> {
        self.unreadable.map_or(Ok(()), |reason| Err(self.error(reason)))
    }

    /// The elements with the indices `which`, or all of them, as floats. `fill` replaces components that an element
    /// lacks, and components beyond `N` are dropped. The indices must be less than [`Accessor::count`].
    pub fn floats<const N: usize>(&self, fill: f32, which: Option<&[u32]>) -> Result<Vec<[f32; N]>> {
        self.check_readable()?;
        let (size, width) = (self.component.size(), self.width.min(N));
        let read = |index: usize| {
            let mut value = [fill; N];
            let bytes = self.element(index);
            for (c, value) in value[..width].iter_mut().enumerate() {
                *value = bytes.map_or(0.0, |bytes| self.component.float(&bytes[c * size..], self.normalised));
            }
            value
        };
        Ok(match which {
            Some(which) => which.iter().map(|&index| read(index as usize)).collect(),
            None => (0..self.count).map(read).collect(),
        })
    }

    /// The components of `count` elements from element `first`, which must exist.
    pub fn components(&self, first: usize, count: usize) -> Result<Vec<f64>> {
        self.check_readable()?;
        let size = self.component.size();
        let read = |index: usize| {
            let bytes = self.element(index);
            let component = move |c: usize| {
                bytes.map_or(0.0, |bytes| f64::from(self.component.float(&bytes[c * size..], self.normalised)))
            };
            (0..self.width).map(component)
        };
        Ok((first..first + count).flat_map(read).collect())
    }

    /// Whether the file has no data for it, so that all of its elements are zero.
    pub fn is_zero_filled(&self) -> bool {
        self.elements.is_none() && self.sparse.is_none() && self.unreadable.is_none()
    }

    /// All elements as vertex indices.
    pub fn indices(&self) -> Result<Vec<u32>> {
        let is_index = self.width == 1 && matches!(self.component, Component::U8 | Component::U16 | Component::U32);
        if !is_index || self.normalised {
            return Err(self.error("indices must be plain unsigned scalars"));
        }
        self.check_readable()?;
        let read = |index| self.element(index).map_or(0, |bytes| self.component.unsigned(bytes));
        Ok((0..self.count).map(read).collect())
    }
}

/// A buffer.
pub(super) struct Buffer<'a> {
    length: usize,
    /// At least `length` bytes. `None` if the file has no data for the buffer; an extension may supply it.
    bytes: Option<Bytes<'a>>,
}

impl Buffer<'_> {
    /// Its data, if the file has any.
    pub fn bytes(&self) -> Option<&[u8]> {
        self.bytes.as_ref().map(|bytes| &bytes[..self.length])
    }
}

/// Reads the buffers of a document.
pub(super) fn read_buffers<'a>(
    root: &Json<'a>,
    bin: Option<&'a [u8]>,
    resources: &mut Resources,
) -> Result<Vec<Buffer<'a>>> {
    let mut buffers = Vec::new();
    for (i, buffer) in root.list("buffers")?.iter().enumerate() {
        let length = buffer.require("byteLength")?;
        let length = match length.whole()? {
            0 => return Err(length.error("must be at least 1")),
            n => n,
        };
        let bytes = match buffer.get("uri")? {
            Some(uri) => Some(resources.resolve(&uri)?),
            None if i == 0 => bin.map(Bytes::Borrowed),
            None => None,
        };
        if let Some(bytes) = bytes.as_ref().filter(|bytes| bytes.len() < length) {
            return Err(buffer.error(format!("{length} bytes are declared, but there are {}", bytes.len())));
        }
        buffers.push(Buffer { length, bytes });
    }
    Ok(buffers)
}

/// All buffer views, checked, with their bytes.
pub(super) struct Views<'a> {
    views: Vec<View<'a>>,
    /// Size of the largest buffer in bytes.
    largest_buffer: usize,
    /// Number of elements that sparse accessors have replaced so far. They may share their indices, so the size of the
    /// file does not bound it.
    replaced: Cell<usize>,
}

impl<'a> Views<'a> {
    /// Checks every buffer view. `decoded` has the bytes of those that are compressed.
    pub fn read(root: &Json<'a>, buffers: &'a [Buffer<'a>], decoded: &'a [Option<Vec<u8>>]) -> Result<Self> {
        let views = root
            .list("bufferViews")?
            .iter()
            .zip(decoded)
            .map(|(view, decoded)| {
                let Buffer { length: size, bytes } =
                    &buffers[view.require("buffer")?.index(buffers.len(), "buffer")?];
                let offset = view.get("byteOffset")?.map_or(Ok(0), |offset| offset.whole())?;
                let length = view.require("byteLength")?.whole()?;
                let end = offset.checked_add(length).filter(|end| end <= size && length > 0);
                let end = end.ok_or_else(|| {
                    view.error(format!("{length} bytes at {offset} do not fit the {size} bytes of the buffer"))
                })?;
                let stride = view.get("byteStride")?.map(|stride| match stride.whole()? {
                    n @ 4..=252 if n % 4 == 0 => Ok(n),
                    n => Err(stride.error(format!("{n} is not a multiple of 4 from 4 to 252"))),
                });
                let bytes = decoded.as_deref().or(bytes.as_ref().map(|bytes| &bytes[offset..end]));
                Ok(View { bytes, length, stride: stride.transpose()? })
            })
            .collect::<Result<_>>()?;
        let stored = buffers.iter().filter_map(|buffer| buffer.bytes.as_ref().map(|bytes| bytes.len()));
        Ok(Views { views, largest_buffer: stored.max().unwrap_or(0), replaced: Cell::new(0) })
    }

    /// The bytes of the view that `index` names.
    pub fn bytes(&self, index: &Json) -> Result<&'a [u8]> {
        let view = &self.views[index.index(self.views.len(), "buffer view")?];
        view.bytes.ok_or_else(|| index.error("its buffer has no data in this file"))
    }

    /// The elements of `holder`, which is an accessor or the indices or values of its sparse part. `None` if the buffer
    /// has no data.
    fn elements(&self, holder: &Json, count: usize, size: usize, component: Component) -> Result<Option<Elements<'a>>> {
        let index = holder.require("bufferView")?;
        let view = &self.views[index.index(self.views.len(), "buffer view")?];
        let offset = holder.get("byteOffset")?.map_or(Ok(0), |offset| offset.whole())?;
        if offset % component.size() != 0 {
            return Err(holder
                .error(format!("byte offset {offset} is not a multiple of the component size, {}", component.size())));
        }
        let stride = view.stride.unwrap_or(size);
        if stride < size {
            return Err(holder.error(format!("byte stride {stride} is less than the element size of {size} bytes")));
        }
        let end = (count - 1).checked_mul(stride).and_then(|n| n.checked_add(size)).and_then(|n| n.checked_add(offset));
        if end.is_none_or(|end| end > view.length) {
            let problem =
                format!("{count} elements at {offset} do not fit the {} bytes of the buffer view", view.length);
            return Err(holder.error(problem));
        }
        Ok(view.bytes.map(|bytes| Elements { bytes: &bytes[offset..], stride }))
    }

    /// Checks every accessor. `decoded` has the elements of those, by their index, that a compressed mesh supplies.
    pub fn accessors(&self, root: &Json<'a>, decoded: &'a HashMap<usize, Vec<u8>>) -> Result<Vec<Accessor<'a>>> {
        let accessors = root.list("accessors")?.into_iter().enumerate();
        accessors.map(|(i, json)| self.accessor(json, decoded.get(&i))).collect()
    }

    fn accessor(&self, json: Json<'a>, decoded: Option<&'a Vec<u8>>) -> Result<Accessor<'a>> {
        let component = Component::of(&json)?;
        let count = json.require("count")?;
        let count = match count.whole()? {
            0 => return Err(count.error("must be at least 1")),
            n => n,
        };
        let normalised = json.get("normalized")?.map_or(Ok(false), |n| n.boolean())?;
        // Columns of a matrix start at multiples of 4 bytes (glTF 3.6.2.4).
        let matrix = |n: usize| (n * n, n * (n * component.size()).next_multiple_of(4));
        let vector = |n: usize| (n, n * component.size());
        let shape = match json.require("type")?.string()? {
            "SCALAR" => Some(vector(1)),
            "VEC2" => Some(vector(2)),
            "VEC3" => Some(vector(3)),
            "VEC4" => Some(vector(4)),
            "MAT2" => Some(matrix(2)),
            "MAT3" => Some(matrix(3)),
            "MAT4" => Some(matrix(4)),
            _ => None,
        };
        let mut accessor =
            Accessor { count, component, width: 0, normalised, elements: None, sparse: None, unreadable: None, json };
        let Some((width, size)) = shape else {
            accessor.unreadable = Some("unknown type");
            return Ok(accessor);
        };
        accessor.width = width;
        const NO_DATA: &str = "its buffer has no data in this file";
        if let Some(bytes) = decoded {
            accessor.elements = Some(Elements { bytes, stride: size });
        } else if accessor.json.get("bufferView")?.is_some() {
            accessor.elements = self.elements(&accessor.json, count, size, component)?;
            accessor.unreadable = accessor.elements.is_none().then_some(NO_DATA);
        } else if count > ZERO_FILLED_IN_ANY_FILE.max(self.largest_buffer) {
            let limit = ZERO_FILLED_IN_ANY_FILE.max(self.largest_buffer);
            return Err(accessor
                .error(format!("{count} elements without data: the maximum for a file of this size is {limit}")));
        }
        if let Some(sparse) = accessor.json.get("sparse")? {
            accessor.sparse = self.sparse(&sparse, count, size, component)?;
            accessor.unreadable = accessor.unreadable.or(accessor.sparse.is_none().then_some(NO_DATA));
        }
        Ok(accessor)
    }

    fn sparse(&self, json: &Json, total: usize, size: usize, component: Component) -> Result<Option<Sparse<'a>>> {
        let count = json.require("count")?;
        let count = match count.whole()? {
            n if n > 0 && n <= total => n,
            n => return Err(count.error(format!("must be from 1 to {total}, the number of elements, not {n}"))),
        };
        let (index_json, values) = (json.require("indices")?, json.require("values")?);
        let code = index_json.require("componentType")?;
        let index_type = Component::from_code(code.whole()?)
            .filter(|c| matches!(c, Component::U8 | Component::U16 | Component::U32))
            .ok_or_else(|| code.error("indices must be unsigned integers"))?;
        let values = self.elements(&values, count, size, component)?;
        let Some(indices) = self.elements(&index_json, count, index_type.size(), index_type)? else { return Ok(None) };
        self.replaced.set(self.replaced.get() + count);
        if self.replaced.get() > MAX_CORNERS {
            return Err(json.error(format!("the accessors replace more than {MAX_CORNERS} elements")));
        }
        let at = |i: usize| index_type.unsigned(indices.get(i));
        if let Some(i) = (1..count).find(|&i| at(i) <= at(i - 1)) {
            return Err(index_json.error(format!("index {i} does not increase")));
        }
        if at(count - 1) as usize >= total {
            return Err(index_json.error(format!("index {} of {total} elements does not exist", at(count - 1))));
        }
        Ok(values.map(|values| Sparse { count, indices, index_type, values }))
    }
}
