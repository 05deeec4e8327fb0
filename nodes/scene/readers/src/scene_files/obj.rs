//! Reader of Wavefront OBJ: all groups and objects of a file as one mesh. Materials are the scene's, and not read.
//!
//! As in Mitsuba 3, corners with the same numbers share a vertex over the whole file, and polygons become fans. Names
//! and comments may be in any encoding. Knows nothing of scenes.
//!
//! Source: Wavefront Technologies, *Advanced Visualizer Manual*, appendix B1, *Object Files*.

use super::{
    meshes::{MOST, checked, smooth},
    ply::Read,
};
use crate::assets::{Refusal, damaged};
use std::collections::{BTreeMap, HashMap};
use tauflow_data::{mesh::Mesh, scene::IDENTITY};

/// The number of what a corner does not name.
const NONE: u32 = u32::MAX;

/// Numbers of position, texture coordinates and normal of a corner, from 0.
type Corner = [u32; 3];

/// A file as far as it was read.
#[derive(Default)]
struct Reader {
    positions: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    /// Each corner once, with the line that names it first: the vertices of the mesh.
    corners: Vec<(Corner, usize)>,
    /// Their numbers. Only looked up, so that its order does not matter.
    numbers: HashMap<Corner, u32>,
    triangles: Vec<[u32; 3]>,
    /// The corners of the face at hand.
    face: Vec<Corner>,
}

/// Reads a file: all of its objects as one mesh.
///
/// Missing texture coordinates are (0, 0) if some corners have them. Missing normals are generated if some corners have
/// them, which is noted.
///
/// # Errors
/// If a line is damaged, the mesh is too large, or there are no faces.
pub fn read(bytes: &[u8]) -> Result<Read, Refusal> {
    let mut reader = Reader::default();
    let mut lines = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).split(|b| *b == b'\n').map(plain).zip(1..);
    let mut joined = Vec::new();
    while let Some((line, number)) = lines.next() {
        let name = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        // The end of a line may be part of a name that is not read, such as that of a folder.
        if !matches!(name, b"v" | b"vt" | b"vn" | b"f") {
            continue;
        }
        let mut whole = line;
        if line.ends_with(b"\\") {
            joined.clear();
            let mut next = Some(line);
            while let Some(line) = next {
                let more = line.strip_suffix(b"\\");
                joined.extend_from_slice(more.unwrap_or(line));
                joined.push(b' ');
                next = more.and_then(|_| lines.next()).map(|(line, _)| line);
            }
            whole = &joined;
        }
        reader.statement(name, &whole[name.len()..], number)?;
    }
    reader.finish(bytes.len())
}

/// A line without its comment, and without blanks about it.
fn plain(line: &[u8]) -> &[u8] {
    let begins = |at: &usize| line[*at] == b'#' && (*at == 0 || line[*at - 1].is_ascii_whitespace());
    let end = (0..line.len()).find(begins).unwrap_or(line.len());
    line[..end].trim_ascii()
}

/// Text of a file in a message.
fn told(bytes: &[u8]) -> String {
    format!("`{}`", String::from_utf8_lossy(&bytes[..bytes.len().min(64)]))
}

fn parsed<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

impl Reader {
    fn statement(&mut self, name: &[u8], rest: &[u8], line: usize) -> Result<(), Refusal> {
        let words = rest.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        match name {
            // Colours of vertices and weights may follow, and are not read.
            b"v" => self.positions.push(numbers(words, 3, line)?),
            b"vn" => self.normals.push(numbers(words, 3, line)?),
            b"vt" => self.uvs.push(numbers(words, 1, line)?),
            _ => {
                self.face.clear();
                for word in words {
                    let corner = self.corner(word, line)?;
                    self.face.push(corner);
                    // One line may be all of a large file.
                    if self.face.len() > MOST {
                        break;
                    }
                }
                self.fan(line);
            }
        }
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len(), self.corners.len(), self.face.len()];
        if counts.iter().any(|count| *count > MOST) || self.triangles.len() > 4 * MOST {
            let what = format!("more than {MOST} vertices or {} triangles", 4 * MOST);
            return Err(Refusal::new(format!("line {line}"), what, "split it into meshes of fewer than 2^24 vertices"));
        }
        Ok(())
    }

    /// A corner of a face: `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&self, word: &[u8], line: usize) -> Result<Corner, Refusal> {
        let wrong = || damaged(format!("line {line}"), format!("{} is no corner of a face", told(word)));
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corner = [NONE; 3];
        for (which, part) in word.split(|b| *b == b'/').enumerate() {
            let count = *counts.get(which).ok_or_else(wrong)?;
            let number: i64 = if part.is_empty() && which > 0 { 0 } else { parsed(part).ok_or_else(wrong)? };
            // Positive numbers count from 1, negative ones from the latest backwards. As in Mitsuba, 0 names none.
            let number = match number {
                0 if which > 0 => continue,
                0 => return Err(wrong()),
                1.. => number - 1,
                _ => count as i64 + number,
            };
            corner[which] = u32::try_from(number).ok().filter(|number| *number != NONE).ok_or_else(wrong)?;
        }
        Ok(corner)
    }

    /// Adds the triangles of the face at hand.
    fn fan(&mut self, line: usize) {
        if self.face.len() < 3 {
            return;
        }
        let mut ends = [0; 2];
        for (at, corner) in self.face.iter().enumerate() {
            let vertex = *self.numbers.entry(*corner).or_insert_with(|| {
                self.corners.push((*corner, line));
                (self.corners.len() - 1) as u32
            });
            match at {
                0 | 1 => ends[at] = vertex,
                _ => {
                    self.triangles.push([ends[0], ends[1], vertex]);
                    ends[1] = vertex;
                }
            }
        }
    }

    /// The mesh, once all lines were read: faces may name what follows them.
    fn finish(self, cost: usize) -> Result<Read, Refusal> {
        if self.triangles.is_empty() {
            return Err(damaged("faces", "there are none"));
        }
        let names = ["vertex", "texture coordinate", "normal"];
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        for (corner, line) in &self.corners {
            for ((number, count), name) in corner.iter().zip(counts).zip(names) {
                if *number != NONE && *number as usize >= count {
                    let what = format!("{name} {} of {count} is named", u64::from(*number) + 1);
                    return Err(damaged(format!("line {line}"), what));
                }
            }
        }
        let corners = || self.corners.iter().map(|(corner, _)| corner);
        let mut mesh = Mesh {
            positions: corners().map(|corner| self.positions[corner[0] as usize]).collect(),
            triangles: self.triangles,
            ..Mesh::default()
        };
        if corners().any(|corner| corner[1] != NONE) {
            let uv = |corner: &Corner| self.uvs.get(corner[1] as usize).copied().unwrap_or_default();
            mesh.uvs = Some(corners().map(uv).collect());
        }
        let without = corners().filter(|corner| corner[2] == NONE).count();
        let mut note = None;
        if without < self.corners.len() {
            if without > 0 {
                smooth(&mut mesh, &IDENTITY);
                note =
                    Some(format!("{without} vertices without a normal, beside others that have one: it is generated"));
            }
            let made = mesh.normals.take().unwrap_or_else(|| vec![[0.0; 3]; self.corners.len()]);
            let own =
                |(corner, made): (&Corner, [f32; 3])| self.normals.get(corner[2] as usize).copied().unwrap_or(made);
            mesh.normals = Some(corners().zip(made).map(own).collect());
        }
        checked(Read { mesh, attributes: BTreeMap::new(), cost, note })
    }
}

/// The numbers of a statement, of which there must be so many; 0 for those that lack.
fn numbers<'a, const N: usize>(
    mut words: impl Iterator<Item = &'a [u8]>,
    least: usize,
    line: usize,
) -> Result<[f32; N], Refusal> {
    let mut out = [0.0; N];
    for (at, value) in out.iter_mut().enumerate() {
        match words.next() {
            Some(word) => {
                let wrong = || damaged(format!("line {line}"), format!("{} is no number", told(word)));
                *value = parsed(word).ok_or_else(wrong)?;
            }
            None if at < least => {
                return Err(damaged(format!("line {line}"), format!("it has fewer than {least} numbers")));
            }
            None => break,
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_are_read_with_polygons_and_shared_corners() {
        let text = "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
                    o a\nusemtl red\nf 1/1/1 2/1/1 3/2/1 4/1/1\no b\nf -4/1/1 -3/1/1 -2/2/1\n";
        let mesh = read(text.as_bytes()).expect("two objects").mesh;
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(mesh.uvs.as_ref().map(Vec::len), Some(4));
        assert!(mesh.normals.expect("given").iter().all(|n| *n == [0.0, 0.0, 1.0]));
    }

    #[test]
    fn a_group_without_coordinates_or_normals_leaves_those_of_the_others() {
        let corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.5 0.25\nvn 0 1 0\n";
        let read = read(format!("{corners}g a\nf 1/1/1 2/1/1 3/1/1\ng b\nf 1 3 4\n").as_bytes()).expect("two groups");
        assert_eq!(read.mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(read.mesh.uvs.expect("of the first")[2..4], [[0.5, 0.25], [0.0; 2]]);
        assert_eq!(read.mesh.normals.expect("of the first")[2..4], [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        assert!(read.note.expect("told").contains("3 vertices without a normal"));
        // Those that no corner names are none.
        let read = super::read(format!("{corners}f 1 2 3\n").as_bytes()).expect("a triangle");
        assert_eq!((read.mesh.uvs, read.mesh.normals, read.note), (None, None, None));
    }

    #[test]
    fn groups_share_vertices() {
        let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\ng a\nf 1 2 3\ng b\nf 1 3 4\n";
        let mesh = read(text.as_bytes()).expect("a roof").mesh;
        assert_eq!((mesh.positions.len(), mesh.triangles), (4, vec![[0, 1, 2], [0, 2, 3]]));
    }

    #[test]
    fn comments_names_and_continued_lines_are_as_other_programs_write_them() {
        let text: &[u8] =
            b"\xef\xbb\xbf# gr\xf6\xdfe, in C:\\models\\\r\nmtllib C:\\models\\\r\ng T\xfcr\\\nv 0 0 0 1 0.5 0.5\r\n\
            \tv 1 0 0 # the second\nv\t1 1 0\n\nvt 0.5\nf 1/1 \\\r\n  2/1/ \\\n 3/1/0 # done\ns off\nl 1 2\nf 1 2\n";
        let mesh = read(text).expect("a triangle").mesh;
        assert_eq!((mesh.positions[1], mesh.triangles), ([1.0, 0.0, 0.0], vec![[0, 1, 2]]));
        assert_eq!((mesh.uvs, mesh.normals), (Some(vec![[0.5, 0.0]; 3]), None));
    }

    #[test]
    fn damaged_files_are_refused_with_the_line() {
        for (text, told) in [
            ("", "faces: there are none"),
            ("v 0 0 0\n", "faces: there are none"),
            ("v 0 0 0\n\nf 1 2 3\n", "line 3: vertex 2 of 1 is named"),
            ("v 0 0 0\nf 1/1 1 1\n", "line 2: texture coordinate 1 of 0"),
            ("v 0 0 0\nf 1//4294967295 1 1\n", "line 2: normal 4294967295 of 0"),
            ("v 0 0\nf 1 1 1\n", "line 1: it has fewer than 3 numbers"),
            ("v 0 \\\n0\nf 1 1 1\n", "line 1: it has fewer than 3 numbers"),
            ("v 0 0 0 \\", "faces: there are none"),
            ("v 0 0 1.#IND\n", "line 1: `1.#IND` is no number"),
            ("f 1 2 x\n", "line 1: `x` is no corner"),
            ("f 1 2 3#\n", "line 1: `3#` is no corner"),
            ("v 0 0 0\nf 1 1 0\n", "line 2: `0` is no corner"),
            ("v 0 0 0\nf 1 1 -2\n", "line 2: `-2` is no corner"),
            ("v 0 0 0\nf 1/1/1/1 1 1\n", "line 2: `1/1/1/1` is no corner"),
            ("v 0 0 0\nf 1 1 4294967296\n", "line 2: `4294967296` is no corner"),
            ("v 0 0 0\nf 1 1 99999999999999999999\n", "is no corner"),
            ("v 0 0 0\nf 1 1 -9223372036854775808\n", "is no corner"),
        ] {
            let error = read(text.as_bytes()).expect_err(text).to_string();
            assert!(error.contains(told), "{text:?}: {error}");
        }
        let line = b"1 ".repeat(1 << 10);
        let mut text = b"v 0 0 0\nf ".to_vec();
        (0..1 << 14).for_each(|_| text.extend(&line));
        let error = read(&text).expect_err("too many triangles").to_string();
        assert!(error.contains("line 2: more than 16777215 vertices"), "{error}");
    }

    #[test]
    fn no_cut_or_changed_file_makes_a_panic() {
        let text = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 1\nvn 0 0 1\nf 1/1/1 -2//1 \\\n 3\n";
        for at in 0..text.len() {
            let _ = read(&text[..at]);
            for with in *b"#-9/\\\n \xff" {
                let mut changed = text.to_vec();
                changed[at] = with;
                let _ = read(&changed);
            }
        }
    }
}
