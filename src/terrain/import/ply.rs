//! Meshes as PLY, as text or binary: elements `vertex` with x, y, z and `face` with a list of vertices. Other elements and properties are
//! skipped.

use super::mesh::{Mesh, finite};
use super::{Map, Placement};
use crate::error::{Error, Result};

pub(super) fn map(bytes: &[u8], placement: &Placement) -> Result<Map> {
    read(bytes)?.map(placement)
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Option<Kind> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }
}

/// Property of an element; a list has the type of its length.
struct Property {
    name: String,
    length: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// Numbers of the body.
enum Body<'a> {
    Text(std::str::SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], big_endian: bool },
}

impl Body<'_> {
    /// Next number; `None` at the end of the file, and for text that is not a number.
    fn next(&mut self, kind: Kind) -> Option<f64> {
        let (bytes, big_endian) = match self {
            Body::Text(words) => return words.next()?.parse().ok(),
            Body::Binary { bytes, big_endian } => (bytes, *big_endian),
        };
        fn take<const N: usize>(bytes: &mut &[u8], big_endian: bool) -> Option<[u8; N]> {
            let (first, rest) = bytes.split_first_chunk::<N>()?;
            *bytes = rest;
            let mut first = *first;
            if big_endian {
                first.reverse();
            }
            Some(first)
        }
        Some(match kind {
            Kind::I8 => i8::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::U8 => u8::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::I16 => i16::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::U16 => u16::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::I32 => i32::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::U32 => u32::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::F32 => f32::from_le_bytes(take(bytes, big_endian)?).into(),
            Kind::F64 => f64::from_le_bytes(take(bytes, big_endian)?),
        })
    }
}

/// Format and elements of the header, and the length of the header in bytes.
fn header(bytes: &[u8]) -> Result<(String, Vec<Element>, usize)> {
    let (mut format, mut elements) = (String::new(), Vec::<Element>::new());
    let mut end = 0;
    for (number, line) in (1..).zip(bytes.split_inclusive(|b| *b == b'\n')) {
        end += line.len();
        let text = String::from_utf8_lossy(line);
        let refuse = |limit: &str| {
            Err(Error::invalid(
                format!("line {number}"),
                format!("`{}`", text.trim().chars().take(80).collect::<String>().escape_debug()),
                limit,
            ))
        };
        let words: Vec<&str> = text.split_whitespace().collect();
        match (number, words.as_slice()) {
            (1, ["ply"]) => {}
            (1, _) => return refuse("`ply`"),
            (_, ["format", name @ ("ascii" | "binary_little_endian" | "binary_big_endian"), "1.0"]) => format = (*name).into(),
            (_, ["format", ..]) => return refuse("format ascii, binary_little_endian or binary_big_endian 1.0"),
            (_, ["element", name, count]) => match count.parse() {
                Ok(count) => elements.push(Element { name: (*name).into(), count, properties: Vec::new() }),
                Err(_) => return refuse("an element with a whole number"),
            },
            (_, ["property", types @ .., name]) => {
                let kinds: Option<Vec<Kind>> = types.iter().filter(|word| **word != "list").map(|word| Kind::named(word)).collect();
                let (length, kind) = match (types.first(), kinds.as_deref()) {
                    (Some(&"list"), Some(&[length, kind])) if !matches!(length, Kind::F32 | Kind::F64) => (Some(length), kind),
                    (Some(first), Some(&[kind])) if *first != "list" => (None, kind),
                    _ => return refuse("a property with a known type, or a list with the types of its length and its items"),
                };
                let Some(element) = elements.last_mut() else { return refuse("after an element") };
                element.properties.push(Property { name: (*name).into(), length, kind });
            }
            (_, ["end_header"]) if format.is_empty() => return refuse("after a line `format`"),
            (_, ["end_header"]) => return Ok((format, elements, end)),
            (_, [] | ["comment" | "obj_info", ..]) => {}
            _ => return refuse("a line of a PLY header"),
        }
    }
    Err(Error::invalid("header", "no line `end_header`", "that of a PLY file"))
}

/// Reads vertices and faces.
fn read(bytes: &[u8]) -> Result<Mesh> {
    let (format, elements, start) = header(bytes)?;
    let rest = &bytes[start..];
    let mut body = match format.as_str() {
        "ascii" => {
            let text = std::str::from_utf8(rest).map_err(|e| Error::Format { message: format!("text after the header: {e}") })?;
            Body::Text(text.split_ascii_whitespace())
        }
        name => Body::Binary { bytes: rest, big_endian: name == "binary_big_endian" },
    };
    let mut mesh = Mesh::default();
    let mut faces: Vec<Vec<f64>> = Vec::new();
    for Element { name, count, properties } in &elements {
        let (is_vertex, is_face) = (name == "vertex", name == "face");
        let scalar = |axis: &str| properties.iter().any(|p| p.name == axis && p.length.is_none());
        if is_vertex && !["x", "y", "z"].into_iter().all(scalar) {
            return Err(Error::invalid("element vertex", "without x, y and z", "given with the properties x, y and z"));
        }
        let corners = |p: &Property| p.length.is_some() && ["vertex_indices", "vertex_index"].contains(&p.name.as_str());
        if is_face && !properties.iter().any(corners) {
            return Err(Error::invalid(
                "element face",
                "without a list of vertices",
                "given with a list `vertex_indices` or `vertex_index`",
            ));
        }
        if properties.is_empty() {
            continue;
        }
        for index in 0..*count {
            let mut point = [0.; 3];
            for property in properties {
                let place = || format!("{name} {index}, property {}", property.name.escape_debug());
                let missing =
                    || Error::invalid(place(), "the end of the file or no value", format!("a number: the header states {count} elements"));
                let Some(length) = property.length else {
                    let value = body.next(property.kind).ok_or_else(missing)?;
                    if let (true, Some(axis)) = (is_vertex, ["x", "y", "z"].iter().position(|axis| *axis == property.name)) {
                        point[axis] = finite(&place(), Some(value), value)?;
                    }
                    continue;
                };
                let length = body.next(length).ok_or_else(missing)?;
                let keeps = is_face && corners(property);
                let mut face = Vec::new();
                if !(length >= 0. && length.fract() == 0.) {
                    return Err(Error::invalid(place(), format!("a list of {length} items"), "a list of 0 or more items"));
                }
                for _ in 0..length as u64 {
                    let item = body.next(property.kind).ok_or_else(missing)?;
                    if keeps {
                        face.push(item);
                    }
                }
                if keeps {
                    faces.push(face);
                }
            }
            if is_vertex {
                mesh.vertices.push(point);
            }
        }
    }
    let count = mesh.vertices.len();
    for (number, face) in faces.iter().enumerate() {
        let place = format!("face {number}");
        let vertex = |index: &f64| {
            let known = *index >= 0. && *index < count as f64 && index.fract() == 0.;
            known
                .then_some(*index as usize)
                .ok_or_else(|| Error::invalid(&place, format!("vertex {index}"), format!("0 to {}", count.saturating_sub(1))))
        };
        let corners = face.iter().map(vertex).collect::<Result<Vec<_>>>()?;
        mesh.add_face(&place, &corners)?;
    }
    Ok(mesh)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Square of 2 m that rises by a quarter of x, with colours, a camera and edges.
    pub const TEXT: &str = "ply\nformat ascii 1.0\ncomment slope\nelement camera 1\nproperty float fov\nelement vertex 4\nproperty float x\n\
                            property uchar red\nproperty double y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\n\
                            property list uchar float texcoord\nend_header\n90\n0 255 0 0\n2 0 0 0.5\n2 0 2 0.5\n0 0 2 0\n\
                            3 0 1 2 2 0.5 0.5\n3 0 2 3 0\n";

    /// [`TEXT`] with binary numbers.
    pub fn binary(big_endian: bool) -> Vec<u8> {
        let order = if big_endian { "binary_big_endian" } else { "binary_little_endian" };
        let (header, _) = TEXT.split_once("90").unwrap();
        let mut bytes = header.replace("ascii", order).into_bytes();
        let mut put = |number: &[u8]| {
            let mut number = number.to_vec();
            if big_endian {
                number.reverse();
            }
            bytes.extend(number);
        };
        put(&90f32.to_le_bytes());
        for (x, red, y, z) in [(0f32, 255u8, 0f64, 0f32), (2., 0, 0., 0.5), (2., 0, 2., 0.5), (0., 0, 2., 0.)] {
            put(&x.to_le_bytes());
            put(&[red]);
            put(&y.to_le_bytes());
            put(&z.to_le_bytes());
        }
        for (corners, texture) in [([0i32, 1, 2], vec![0.5f32, 0.5]), ([0, 2, 3], vec![])] {
            put(&[3]);
            corners.iter().for_each(|corner| put(&corner.to_le_bytes()));
            put(&[texture.len() as u8]);
            texture.iter().for_each(|v| put(&v.to_le_bytes()));
        }
        bytes
    }

    #[test]
    fn text_and_both_byte_orders_are_one_mesh() {
        let mesh = read(TEXT.as_bytes()).unwrap();
        assert_eq!(mesh.vertices, [[0., 0., 0.], [2., 0., 0.5], [2., 2., 0.5], [0., 2., 0.]]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(read(&binary(false)).unwrap(), mesh);
        assert_eq!(read(&binary(true)).unwrap(), mesh);
        assert_eq!(read(TEXT.replace('\n', "\r\n").as_bytes()).unwrap(), mesh);
    }

    #[test]
    fn errors_name_the_element_and_the_limit() {
        let cases = [
            ("ply", "plain", "line 1: `plain`, but it must be `ply`"),
            ("ascii 1.0", "ascii 2.0", "line 2: `format ascii 2.0`, but it must be format ascii"),
            ("format ascii 1.0", "comment none", "line 14: `end_header`, but it must be after a line `format`"),
            ("vertex 4", "vertex four", "line 6: `element vertex four`"),
            ("float x", "quad x", "line 7: `property quad x`, but it must be a property with a known type"),
            ("list uchar int", "list float int", "line 12: `property list float int vertex_indices`"),
            ("double y", "double why", "element vertex: without x, y and z"),
            ("vertex_indices", "corners", "element face: without a list of vertices"),
            ("2 0 2 0.5", "2 0 nan 0.5", "vertex 2, property y: coordinate `NaN`"),
            ("2 0 2 0.5", "2 0 two 0.5", "vertex 2, property y: the end of the file or no value"),
            (
                "face 2",
                "face 3",
                "face 2, property vertex_indices: the end of the file or no value, but it must be a number: the header states 3",
            ),
            ("3 0 1 2 2", "3 0 1 4 2", "face 0: vertex 4, but it must be 0 to 3"),
            ("3 0 1 2 2", "3 0 1 -1 2", "face 0: vertex -1, but it must be 0 to 3"),
            ("3 0 2 3", "2 0 2", "face 1: 2 vertices, but it must be at least 3"),
            ("3 0 2 3", "-3 0 2 3", "face 1, property vertex_indices: a list of -3 items"),
            ("end_header", "end", "line 14: `end`, but it must be a line of a PLY header"),
        ];
        for (from, to, part) in cases {
            assert!(TEXT.contains(from));
            let error = read(TEXT.replacen(from, to, 1).as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.starts_with(part), "{to}: {error}");
        }
        let cut = &binary(false)[..binary(false).len() - 4];
        assert!(read(cut).unwrap_err().to_string().starts_with("face 1, property vertex_indices: the end of the file"));
    }
}
