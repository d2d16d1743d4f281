//! Meshes as Wavefront OBJ: the lines `v` and `f`. Common parsers of OBJ report no line numbers.

use super::mesh::{Mesh, coordinates};
use super::{Map, Placement};
use crate::error::{Error, Result};

pub(super) fn map(bytes: &[u8], placement: &Placement) -> Result<Map> {
    read(bytes)?.map(placement)
}

/// Reads vertices and faces. Groups, normals, colours, textures, lines and points are skipped.
fn read(bytes: &[u8]) -> Result<Mesh> {
    let text = String::from_utf8_lossy(bytes);
    let mut mesh = Mesh::default();
    let mut faces: Vec<(usize, Vec<i64>, usize)> = Vec::new();
    // A line that ends in a backslash continues on the next line.
    let mut pending: Option<(usize, String)> = None;
    for (line, number) in text.lines().chain([""]).zip(1..) {
        let line = line.split('#').next().unwrap_or_default().trim_end();
        let (part, continues) = line.strip_suffix('\\').map_or((line, false), |part| (part, true));
        let (number, statement) =
            pending.take().map_or_else(|| (number, part.to_owned()), |(first, text)| (first, format!("{text} {part}")));
        if continues {
            pending = Some((number, statement));
            continue;
        }
        let mut words = statement.split_whitespace();
        let place = || format!("line {number}");
        match words.next() {
            Some("v") => mesh.vertices.push(coordinates(&place(), &words.collect::<Vec<_>>())?),
            Some("f") => {
                let corner = |word: &str| {
                    let index = word.split('/').next().unwrap_or_default();
                    index.parse::<i64>().map_err(|_| Error::invalid(place(), format!("vertex `{}`", word.escape_debug()), "a whole number"))
                };
                faces.push((number, words.map(corner).collect::<Result<_>>()?, mesh.vertices.len()));
            }
            _ => {}
        }
    }
    // A face may come before its vertices.
    let count = mesh.vertices.len();
    for (number, corners, before) in faces {
        let vertex = |corner: &i64| {
            // Negative indices count from the last vertex before the face.
            let index = if *corner < 0 { before as i64 + corner } else { corner - 1 };
            usize::try_from(index).ok().filter(|index| *index < count).ok_or_else(|| {
                Error::invalid(format!("line {number}"), format!("vertex {corner}"), format!("1 to {count}, or -1 to -{before}"))
            })
        };
        let corners = corners.iter().map(vertex).collect::<Result<Vec<_>>>()?;
        mesh.add_face(&format!("line {number}"), &corners)?;
    }
    Ok(mesh)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Square of 2 m that rises by a quarter of x, with normals, textures, a negative index and a continued line.
    pub const SLOPE: &str = "# slope\no ground\nv 0 0 0\nv 2 0 0.5 1 0 0\nvt 0 0\nvn 0 0 1\nv 2 2 0.5\nv 0 2 0\nusemtl grass\n\
                             f 1/1/1 2//1 \\\n  -2/1 4\nl 1 2\n";

    #[test]
    fn faces_are_fans_of_triangles() {
        let mesh = read(SLOPE.as_bytes()).unwrap();
        assert_eq!(mesh.vertices, [[0., 0., 0.], [2., 0., 0.5], [2., 2., 0.5], [0., 2., 0.]]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        // A face before its vertices, with Windows line ends.
        let early = read(b"f 1 2 3\r\nv 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\n").unwrap();
        assert_eq!(early.triangles, [[0, 1, 2]]);
    }

    #[test]
    fn errors_name_the_line_and_the_limit() {
        let cases = [
            ("v 0 0\n", "line 1: 2 coordinates, but it must be at least 3"),
            ("v 0 0 0\nv 0 x 0\n", "line 2: coordinate `x`, but it must be a finite number"),
            ("v 0 0 inf\n", "line 1: coordinate `inf`"),
            ("v 0 0 0\nv 1 0 0\n\nf 1 2 3\nv 0 0 0 \nf 1 2 9\n", "line 6: vertex 9, but it must be 1 to 3, or -1 to -3"),
            ("v 0 0 0\nf -2 1 1\n", "line 2: vertex -2, but it must be 1 to 1, or -1 to -1"),
            ("v 0 0 0\nf 0 1 1\n", "line 2: vertex 0"),
            ("v 0 0 0\nf 1 1/2 a/3\n", "line 2: vertex `a/3`, but it must be a whole number"),
            ("v 0 0 0\nf 1 1\n", "line 2: 2 vertices, but it must be at least 3"),
            ("v 0 0 0\n", "mesh: 1 vertices without faces"),
        ];
        for (text, part) in cases {
            let error = map(text.as_bytes(), &Placement::default()).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.starts_with(part), "{text}: {error}");
        }
    }
}
