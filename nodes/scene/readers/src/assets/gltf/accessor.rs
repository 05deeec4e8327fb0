//! Accessors: typed numbers out of buffer views, sparse ones among them. Knows nothing of what they mean.
//!
//! Source: glTF 2.0 specification, section 3.6.2; normalised integers as in its table of equations.

use super::container::Document;
use crate::assets::refusal::{Refusal, damaged};
use gltf::json::{
    accessor::{Accessor, ComponentType, Type},
    validation::Checked,
};

/// Most numbers that one accessor may hold.
const MOST_VALUES: usize = 1 << 26;

/// Most numbers of an accessor without data of its own, which are all 0: a small file must not name a large memory.
const MOST_ZEROS: usize = 1 << 22;

/// Numbers of an accessor, `width` to an element.
pub struct Values {
    /// All numbers, element by element.
    pub data: Vec<f64>,
    /// Numbers in an element.
    pub width: usize,
    /// True if they are stored as integers that stand for themselves.
    pub integers: bool,
}

fn size(component: ComponentType) -> usize {
    match component {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::U32 | ComponentType::F32 => 4,
    }
}

/// A number of `bytes`, which are as many as its type has.
fn number(component: ComponentType, bytes: &[u8], normalized: bool) -> f64 {
    let two = || [bytes[0], bytes[1]];
    let four = || [bytes[0], bytes[1], bytes[2], bytes[3]];
    let (value, most) = match component {
        ComponentType::I8 => (f64::from(bytes[0] as i8), 127.0),
        ComponentType::U8 => (f64::from(bytes[0]), 255.0),
        ComponentType::I16 => (f64::from(i16::from_le_bytes(two())), 32767.0),
        ComponentType::U16 => (f64::from(u16::from_le_bytes(two())), 65535.0),
        ComponentType::U32 => (f64::from(u32::from_le_bytes(four())), 4_294_967_295.0),
        ComponentType::F32 => return f64::from(f32::from_le_bytes(four())),
    };
    if normalized { (value / most).max(-1.0) } else { value }
}

struct Layout {
    component: ComponentType,
    width: usize,
    count: usize,
    normalized: bool,
}

fn layout(accessor: &Accessor, place: &str) -> Result<Layout, Refusal> {
    let Checked::Valid(component) = &accessor.component_type else {
        return Err(damaged(place, "a component type that does not exist"));
    };
    let width = match &accessor.type_ {
        Checked::Valid(Type::Scalar) => 1,
        Checked::Valid(Type::Vec2) => 2,
        Checked::Valid(Type::Vec3) => 3,
        Checked::Valid(Type::Vec4) => 4,
        // Columns of floats are not padded.
        Checked::Valid(Type::Mat4) if component.0 == ComponentType::F32 => 16,
        Checked::Valid(_) => return Err(damaged(place, "a matrix where numbers or vectors belong")),
        Checked::Invalid => return Err(damaged(place, "a type that does not exist")),
    };
    let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
    let most = if accessor.buffer_view.is_some() { MOST_VALUES } else { MOST_ZEROS };
    if count.checked_mul(width).is_none_or(|n| n > most) {
        return Err(Refusal::new(
            place,
            format!("{count} elements"),
            format!("split the mesh: {most} numbers are the most"),
        ));
    }
    Ok(Layout { component: component.0, width, count, normalized: accessor.normalized })
}

/// Reads `count` elements at `offset` of a view into `out`.
fn strided(
    document: &Document<'_>,
    view: usize,
    offset: u64,
    layout: &Layout,
    place: &str,
    mut each: impl FnMut(usize, &[u8]),
) -> Result<(), Refusal> {
    let (bytes, stride) = document.view(view)?;
    let element = size(layout.component) * layout.width;
    let stride = stride.unwrap_or(element);
    if stride < element {
        return Err(damaged(place, format!("a stride of {stride} bytes for elements of {element}")));
    }
    if layout.count == 0 {
        return Ok(());
    }
    let offset = usize::try_from(offset).unwrap_or(usize::MAX);
    let end =
        (layout.count - 1).checked_mul(stride).and_then(|n| n.checked_add(element)).and_then(|n| n.checked_add(offset));
    if end.is_none_or(|end| end > bytes.len()) {
        return Err(damaged(
            place,
            format!("{} elements of {element} bytes leave bufferView {view} of {} bytes", layout.count, bytes.len()),
        ));
    }
    for i in 0..layout.count {
        let at = offset + i * stride;
        each(i, &bytes[at..at + element]);
    }
    Ok(())
}

/// How many elements accessor `index` has.
///
/// # Errors
/// If it is not there.
pub fn count(document: &Document<'_>, index: usize) -> Result<usize, Refusal> {
    let accessor = document.root.accessors.get(index);
    let accessor = accessor.ok_or_else(|| damaged(format!("accessor {index}"), "there is no such accessor"))?;
    Ok(usize::try_from(accessor.count.0).unwrap_or(usize::MAX))
}

/// The numbers of accessor `index`; those of a matrix by columns.
///
/// # Errors
/// If it is not there, of no type that fits, or leaves its view.
pub fn values(document: &Document<'_>, index: usize) -> Result<Values, Refusal> {
    let place = format!("accessor {index}");
    let accessor = document.root.accessors.get(index).ok_or_else(|| damaged(&place, "there is no such accessor"))?;
    let layout = layout(accessor, &place)?;
    let mut data = vec![0.0; layout.count * layout.width];
    let width = layout.width;
    let fill = |data: &mut [f64], at: usize, bytes: &[u8]| {
        let bytes = bytes.chunks_exact(size(layout.component));
        for (value, bytes) in data[at * width..(at + 1) * width].iter_mut().zip(bytes) {
            *value = number(layout.component, bytes, layout.normalized);
        }
    };
    if let Some(view) = accessor.buffer_view {
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        strided(document, view.value(), offset, &layout, &place, |i, bytes| fill(&mut data, i, bytes))?;
    }
    if let Some(sparse) = &accessor.sparse {
        let count = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        if count > layout.count {
            return Err(damaged(place, format!("{count} sparse elements of {}", layout.count)));
        }
        let Checked::Valid(component) = &sparse.indices.component_type else {
            return Err(damaged(place, "a type of sparse indices that does not exist"));
        };
        let indices = Layout { component: component.0, width: 1, count, normalized: false };
        let mut targets = Vec::with_capacity(count);
        let at = sparse.indices.byte_offset.0;
        strided(document, sparse.indices.buffer_view.value(), at, &indices, &place, |_, bytes| {
            targets.push(number(component.0, bytes, false) as usize);
        })?;
        if targets.iter().any(|t| *t >= layout.count) {
            return Err(damaged(place, "a sparse index beyond the elements"));
        }
        let values = Layout { count, ..layout };
        let at = sparse.values.byte_offset.0;
        strided(document, sparse.values.buffer_view.value(), at, &values, &place, |i, bytes| {
            fill(&mut data, targets[i], bytes);
        })?;
    }
    let integers = layout.component != ComponentType::F32 && !layout.normalized;
    Ok(Values { data, width, integers })
}

impl Values {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.data.len() / self.width
    }

    /// Its elements as vectors of `N`, the last ones `fill` where it has fewer.
    pub fn vectors<const N: usize>(&self, fill: f64) -> Vec<[f64; N]> {
        self.data.chunks_exact(self.width).map(|e| std::array::from_fn(|i| e.get(i).copied().unwrap_or(fill))).collect()
    }
}
