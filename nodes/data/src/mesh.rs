//! Triangle meshes and bitmaps, as scenes and assets refer to them by digest.

use crate::{DataError, Image, TensorFile};

/// A triangle mesh blob: safetensors with `positions` [V, 3], `indices` [T, 3] (exact in f32 below 2^24, else split by
/// the maker), and optionally `normals` [V, 3], `uvs` [V, 2], `colors` [V, 4], `tangents` [V, 4].
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Vertex normals, or none for flat shading.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Texture coordinates, v downwards (row 0 of the image at v = 0).
    pub uvs: Option<Vec<[f32; 2]>>,
    /// Vertex colours, linear RGBA.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Tangents and handedness.
    pub tangents: Option<Vec<[f32; 4]>>,
}

fn rows<const N: usize>(file: &TensorFile, name: &str) -> Result<Option<Vec<[f32; N]>>, DataError> {
    let Some(tensor) = file.tensors.get(name) else { return Ok(None) };
    if tensor.shape.len() != 2 || tensor.shape[1] != N {
        return Err(DataError::Format(format!("mesh tensor `{name}` has shape {:?}, expected [*, {N}]", tensor.shape)));
    }
    Ok(Some(tensor.data.chunks_exact(N).map(|c| c.try_into().expect("chunks of N")).collect()))
}

impl Mesh {
    /// Its blob.
    ///
    /// # Errors
    /// If it has 2^24 vertices or more.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DataError> {
        if self.positions.len() >= 1 << 24 {
            return Err(DataError::Format(format!(
                "a mesh with {} vertices; split it into meshes with fewer than 2^24",
                self.positions.len()
            )));
        }
        let mut file = TensorFile::default()
            .with("positions", &[self.positions.len(), 3], self.positions.concat())
            .with("indices", &[self.triangles.len(), 3], self.triangles.iter().flatten().map(|i| *i as f32).collect());
        if let Some(normals) = &self.normals {
            file = file.with("normals", &[normals.len(), 3], normals.concat());
        }
        if let Some(uvs) = &self.uvs {
            file = file.with("uvs", &[uvs.len(), 2], uvs.concat());
        }
        if let Some(colors) = &self.colors {
            file = file.with("colors", &[colors.len(), 4], colors.concat());
        }
        if let Some(tangents) = &self.tangents {
            file = file.with("tangents", &[tangents.len(), 4], tangents.concat());
        }
        file.to_bytes()
    }

    /// The number of triangles in a blob, from its header alone.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn triangles_in(bytes: &[u8]) -> Result<usize, DataError> {
        let shape = TensorFile::shape_in(bytes, "indices")?;
        let missing = || DataError::Format("the mesh has no tensor `indices`".to_owned());
        shape.and_then(|shape| shape.first().copied()).ok_or_else(missing)
    }

    /// Reads a blob, and checks that indices and attribute lengths fit.
    ///
    /// # Errors
    /// If it is damaged or inconsistent.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let file = TensorFile::from_bytes(bytes)?;
        let missing = |name: &str| DataError::Format(format!("the mesh has no tensor `{name}`"));
        let positions = rows::<3>(&file, "positions")?.ok_or_else(|| missing("positions"))?;
        let indices = rows::<3>(&file, "indices")?.ok_or_else(|| missing("indices"))?;
        let count = positions.len();
        let mut triangles = Vec::with_capacity(indices.len());
        for triangle in indices {
            if triangle.iter().any(|i| !(*i >= 0.0 && i.fract() == 0.0 && (*i as usize) < count)) {
                return Err(DataError::Format(format!("a triangle names vertices {triangle:?} of the mesh's {count}")));
            }
            triangles.push(triangle.map(|i| i as u32));
        }
        let mesh = Self {
            triangles,
            normals: rows(&file, "normals")?,
            uvs: rows(&file, "uvs")?,
            colors: rows(&file, "colors")?,
            tangents: rows(&file, "tangents")?,
            positions,
        };
        let fits = |len: Option<usize>| len.is_none_or(|len| len == count);
        if !(fits(mesh.normals.as_ref().map(Vec::len))
            && fits(mesh.uvs.as_ref().map(Vec::len))
            && fits(mesh.colors.as_ref().map(Vec::len))
            && fits(mesh.tangents.as_ref().map(Vec::len)))
        {
            return Err(DataError::Format(format!(
                "the mesh has {count} positions but another number of an attribute"
            )));
        }
        Ok(mesh)
    }
}

/// A bitmap blob: an [`Image`] of 1, 3 or 4 channels, linear, finite and not negative; row 0 on top. Bytes and f16 are
/// read, too, as [`Image::to_small_bytes`] writes them.
pub type Bitmap = Image;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_round_trip_and_are_checked() {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            uvs: Some(vec![[0.0, 1.0]; 3]),
            colors: None,
            tangents: None,
        };
        let bytes = mesh.to_bytes().expect("small");
        assert_eq!(Mesh::from_bytes(&bytes).expect("own bytes"), mesh);
        assert_eq!(Mesh::triangles_in(&bytes).expect("own bytes"), 1);
        assert!(Mesh::triangles_in(&bytes[..20]).is_err());
        let beyond = Mesh { triangles: vec![[0, 1, 3]], ..mesh.clone() };
        assert!(Mesh::from_bytes(&beyond.to_bytes().expect("small")).is_err());
        let halves = TensorFile::default().with("positions", &[3, 3], mesh.positions.concat()).with(
            "indices",
            &[1, 3],
            vec![0.0, 1.5, 2.0],
        );
        let told = Mesh::from_bytes(&halves.to_bytes().expect("small")).expect_err("half a vertex").to_string();
        assert!(told.contains("1.5"), "{told}");
        let short = Mesh { uvs: Some(vec![[0.0; 2]; 2]), ..mesh };
        assert!(Mesh::from_bytes(&short.to_bytes().expect("small")).is_err());
    }
}
