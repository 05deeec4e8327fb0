//! Reader of PLY meshes: ascii and binary of both endians. Knows nothing of scenes.
//!
//! Source: Turk, *The PLY Polygon File Format*, 1994. Memory goes with the bytes that are there: a count in a header
//! takes none. For this reason the reader is our own; existing crates trust the length of a list.

use crate::assets::{Refusal, damaged};
use std::collections::BTreeMap;
use tauflow_data::mesh::Mesh;

/// A mesh with whatever else its vertices have, three numbers each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Read {
    /// The mesh; without vertex colours.
    pub mesh: Mesh,
    /// Further attributes by Mitsuba's names, such as `vertex_color`.
    pub attributes: BTreeMap<String, Vec<[f32; 3]>>,
    /// Bytes that were read to make it, unpacked.
    pub cost: usize,
    /// What was made for it, if that is worth knowing.
    pub note: Option<String>,
}

impl Read {
    /// Bytes that it takes, about.
    pub fn bytes(&self) -> usize {
        let further: usize = self.attributes.values().map(|rows| size_of_val(rows.as_slice())).sum();
        super::meshes::bytes(&self.mesh) + further
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number of these little-endian bytes.
    fn value(self, b: [u8; 8]) -> f64 {
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

struct Property {
    name: String,
    /// The type of its length, if it is a list.
    list: Option<Number>,
    number: Number,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Ascii,
    Little,
    Big,
}

/// Numbers, one after another.
struct Body<'a> {
    bytes: &'a [u8],
    form: Form,
}

impl Body<'_> {
    fn next(&mut self, number: Number) -> Result<f64, Refusal> {
        let short = || damaged("data", "the file ends before all that its header promises");
        if self.form == Form::Ascii {
            let start = self.bytes.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(short)?;
            let rest = &self.bytes[start..];
            let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            self.bytes = &rest[end..];
            let text = std::str::from_utf8(&rest[..end]).unwrap_or("?");
            return text.parse().map_err(|_| damaged("data", format!("`{text}` is not a number")));
        }
        let size = number.size();
        let (own, rest) = self.bytes.split_at_checked(size).ok_or_else(short)?;
        self.bytes = rest;
        let mut bytes = [0; 8];
        bytes[..size].copy_from_slice(own);
        if self.form == Form::Big {
            bytes[..size].reverse();
        }
        Ok(number.value(bytes))
    }
}

fn header(bytes: &[u8]) -> Result<(Vec<Element>, Body<'_>), Refusal> {
    let mut rest = bytes;
    let mut line = || -> Result<&str, Refusal> {
        let end = rest.iter().take(4096).position(|b| *b == b'\n');
        let end = end.ok_or_else(|| damaged("header", "it has no end"))?;
        let (own, after) = rest.split_at(end);
        rest = &after[1..];
        std::str::from_utf8(own).map(str::trim).map_err(|_| damaged("header", "it is no text"))
    };
    if line()? != "ply" {
        return Err(damaged("header", "it does not begin with `ply`"));
    }
    let mut form = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let text = line()?;
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let odd = || damaged("header", format!("`{text}`"));
        let number = |name: &str| Number::named(name).ok_or_else(odd);
        match words.as_slice() {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", "ascii", _] => form = Some(Form::Ascii),
            ["format", "binary_little_endian", _] => form = Some(Form::Little),
            ["format", "binary_big_endian", _] => form = Some(Form::Big),
            ["element", name, count] if elements.len() < 64 => {
                let count = count.parse().map_err(|_| odd())?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let property = match rest {
                    ["list", length, of, name] => {
                        Property { name: (*name).to_owned(), list: Some(number(length)?), number: number(of)? }
                    }
                    [of, name] => Property { name: (*name).to_owned(), list: None, number: number(of)? },
                    _ => return Err(odd()),
                };
                let element = elements.last_mut().filter(|e| e.properties.len() < 1024).ok_or_else(odd)?;
                element.properties.push(property);
            }
            ["end_header"] => break,
            _ => return Err(odd()),
        }
    }
    let form = form.ok_or_else(|| damaged("header", "it names no format"))?;
    Ok((elements, Body { bytes: rest, form }))
}

/// Where three numbers in a row lie among the properties of a vertex.
fn columns<const N: usize>(element: &Element, names: [&str; N]) -> Option<[usize; N]> {
    let mut found = [0; N];
    for (at, name) in found.iter_mut().zip(names) {
        *at = element.properties.iter().position(|p| p.list.is_none() && p.name == name)?;
    }
    Some(found)
}

fn take<const N: usize>(row: &[f64], columns: [usize; N]) -> [f32; N] {
    columns.map(|c| row[c] as f32)
}

/// Attributes by Mitsuba's names: `r, g, b` is `vertex_color`, and `x_r, x_g, x_b` is `vertex_x_color`.
fn further(element: &Element) -> Vec<(String, [usize; 3])> {
    let mut found = Vec::new();
    for property in &element.properties {
        let Some(stem) = property.name.strip_suffix('r').filter(|stem| stem.is_empty() || stem.ends_with('_')) else {
            continue;
        };
        let names = [format!("{stem}r"), format!("{stem}g"), format!("{stem}b")];
        if let Some(columns) = columns(element, names.each_ref().map(String::as_str)) {
            found.push((format!("vertex_{stem}color"), columns));
        }
    }
    found
}

/// Reads a mesh; faces of more than three vertices become fans.
///
/// # Errors
/// If the file is damaged, or has no vertices or faces.
pub fn read(bytes: &[u8]) -> Result<Read, Refusal> {
    let (elements, mut body) = header(bytes)?;
    let mut out = Read { cost: bytes.len(), ..Read::default() };
    let mesh = &mut out.mesh;
    for element in &elements {
        let least: usize = element.properties.iter().map(|p| p.list.unwrap_or(p.number).size()).sum();
        let least = if body.form == Form::Ascii { 2 * element.properties.len() } else { least };
        // One byte may be left out: the last number of a text needs nothing after it.
        if element.count.checked_mul(least.max(1)).is_none_or(|bytes| bytes > body.bytes.len() + 1) {
            let what = format!("{} elements `{}` in {} bytes", element.count, element.name, body.bytes.len());
            return Err(damaged("header", what));
        }
        let vertex = element.name == "vertex";
        let place = if vertex { columns(element, ["x", "y", "z"]) } else { None };
        let normal = columns(element, ["nx", "ny", "nz"]);
        let uv = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"], ["texture_s", "texture_t"]];
        let uv = uv.into_iter().find_map(|names| columns(element, names));
        let more = if vertex { further(element) } else { Vec::new() };
        let face = |p: &Property| p.list.is_some() && ["vertex_indices", "vertex_index"].contains(&p.name.as_str());
        let corners = element.properties.iter().position(face).filter(|_| element.name == "face");
        if vertex && place.is_none() {
            return Err(damaged("header", "vertices without x, y and z"));
        }
        let (mut row, mut list) = (Vec::new(), Vec::new());
        for _ in 0..element.count {
            row.clear();
            for (index, property) in element.properties.iter().enumerate() {
                let Some(length) = property.list else {
                    row.push(body.next(property.number)?);
                    continue;
                };
                row.push(0.0);
                let length = body.next(length)?;
                if !(length >= 0.0 && length <= body.bytes.len() as f64) {
                    return Err(damaged("data", format!("a list of {length} numbers")));
                }
                list.clear();
                for _ in 0..length as usize {
                    list.push(body.next(property.number)?);
                }
                if Some(index) == corners {
                    // Numbers that are no vertices are found below, when all of them are known.
                    let corner = |v: f64| if v >= 0.0 && v < f64::from(u32::MAX) { v as u32 } else { u32::MAX };
                    let fan = |w: &[f64]| [corner(list[0]), corner(w[0]), corner(w[1])];
                    mesh.triangles.extend(list.get(1..).unwrap_or(&[]).windows(2).map(fan));
                }
            }
            if let Some(place) = place {
                mesh.positions.push(take(&row, place));
                if let Some(normal) = normal {
                    mesh.normals.get_or_insert_default().push(take(&row, normal));
                }
                if let Some(uv) = uv {
                    mesh.uvs.get_or_insert_default().push(take(&row, uv));
                }
                for (name, columns) in &more {
                    out.attributes.entry(name.clone()).or_default().push(take(&row, *columns));
                }
            }
        }
    }
    if mesh.triangles.is_empty() {
        return Err(damaged("faces", "there are none"));
    }
    let count = mesh.positions.len();
    if let Some(bad) = mesh.triangles.iter().flatten().find(|i| **i as usize >= count) {
        return Err(damaged("faces", format!("vertex {bad} of {count} is named")));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "ply\nformat ascii 1.0\ncomment hello\nelement vertex 4\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar q\nproperty float u\nproperty float v\nproperty float c0_r\n\
        property float c0_g\nproperty float c0_b\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0 9 0 0 1 2 3\n1 0 0 9 1 0 1 2 3\n1 1 0 9 1 1 1 2 3\n0 1 0 9 0 1 1 2 .5\n4 0 1 2 3";

    fn binary(big: bool) -> Vec<u8> {
        let form = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut out = format!(
            "ply\nformat {form} 1.0\nelement vertex 3\nproperty float x\nproperty double y\nproperty float z\n\
             property short w\nelement face 1\nproperty list uchar uint vertex_index\nend_header\n"
        )
        .into_bytes();
        let mut put = |bytes: Vec<u8>| {
            let mut bytes = bytes;
            if big {
                bytes.reverse();
            }
            out.extend(bytes);
        };
        for [x, y, z] in [[0.0f32, 0.5, 0.0], [1.0, 0.0, 2.0], [0.0, 3.0, 0.0]] {
            put(x.to_le_bytes().to_vec());
            put(f64::from(y).to_le_bytes().to_vec());
            put(z.to_le_bytes().to_vec());
            put((-7i16).to_le_bytes().to_vec());
        }
        put(vec![3]);
        [0u32, 2, 1].iter().for_each(|i| put(i.to_le_bytes().to_vec()));
        out
    }

    #[test]
    fn texts_and_both_endians_hold_the_same() {
        let text = read(TEXT.as_bytes()).expect("a square");
        assert_eq!(text.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(text.mesh.uvs.as_ref().expect("some")[2], [1.0, 1.0]);
        assert_eq!(text.attributes["vertex_c0_color"][3], [1.0, 2.0, 0.5]);
        let little = read(&binary(false)).expect("a triangle");
        assert_eq!(little.mesh.positions, [[0.0, 0.5, 0.0], [1.0, 0.0, 2.0], [0.0, 3.0, 0.0]]);
        assert_eq!(little.mesh.triangles, [[0, 2, 1]]);
        assert_eq!(read(&binary(true)).expect("the same").mesh, little.mesh);
    }

    #[test]
    fn hostile_files_are_refused_without_taking_memory() {
        for (from, to) in [
            ("vertex 4", "vertex 4000000000"),
            ("face 1", "face 99999999999999999999"),
            ("4 0 1 2 3", "4294967295 0 1 2 3"),
            ("4 0 1 2 3", "4 0 1 2 4"),
            ("4 0 1 2 3", "4 0 1 2"),
            ("property float x", "property wide x"),
            ("element face 1", "element face 0"),
        ] {
            assert!(read(TEXT.replace(from, to).as_bytes()).is_err(), "{to}");
        }
        let whole = binary(false);
        for end in 0..whole.len() {
            assert!(read(&whole[..end]).is_err(), "{end} bytes");
        }
    }
}
