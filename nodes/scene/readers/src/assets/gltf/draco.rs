//! Meshes compressed by `KHR_draco_mesh_compression`, through the crate `draco-core`. Knows nothing of materials.

use super::accessor::Values;
use crate::assets::refusal::{Refusal, damaged};
use draco_core::{DecoderBuffer, Mesh, MeshDecoder};
use serde_json::Value;

/// A decompressed primitive.
pub struct Decoded {
    mesh: Mesh,
    /// The attributes' identifiers by semantic.
    attributes: Value,
    /// Vertex indices, three to a triangle.
    pub indices: Vec<u32>,
}

/// Decompresses the bytes of a primitive's buffer view.
///
/// # Errors
/// If they are no Draco stream.
pub fn decode(bytes: &[u8], extension: &Value, place: &str) -> Result<Decoded, Refusal> {
    let mut mesh = Mesh::new();
    MeshDecoder::new()
        .decode(&mut DecoderBuffer::new(bytes), &mut mesh)
        .map_err(|e| damaged(place, format!("Draco: {e}")))?;
    let indices = mesh.faces().iter().flat_map(|face| face.iter().map(|point| point.0)).collect();
    Ok(Decoded { mesh, attributes: extension.get("attributes").cloned().unwrap_or(Value::Null), indices })
}

impl Decoded {
    /// The numbers of an attribute, if it is there.
    pub fn attribute(&self, semantic: &str) -> Option<Values> {
        let id = u32::try_from(self.attributes.get(semantic)?.as_u64()?).ok()?;
        let attribute = self.mesh.attribute_by_unique_id(id)?;
        let width = usize::from(attribute.num_components());
        if !(1..=4).contains(&width) {
            return None;
        }
        let data = attribute.read_f32s(self.mesh.num_points(), width).into_iter().map(f64::from).collect();
        Some(Values { data, width, integers: false })
    }
}
