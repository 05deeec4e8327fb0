//! Texture slots of materials: which image, which coordinates, which part of it. Knows nothing of shading.
//!
//! Sources: glTF 2.0, section 3.8; `KHR_texture_transform`, where a positive rotation turns coordinates
//! counter-clockwise as seen with v downwards: u' = cos su u + sin sv v, v' = -sin su u + cos sv v.

use super::container::Document;
use crate::assets::refusal::{Refusal, damaged};
use gltf::json::{
    material::{Material as Source, NormalTexture},
    texture::{Info, WrappingMode},
    validation::Checked,
};
use serde_json::Value;
use tauflow_data::{maths, records::AssetReport};

/// The extension `name` of a material.
pub fn extension<'m>(material: &'m Source, name: &str) -> Option<&'m Value> {
    material.extensions.as_ref()?.others.get(name)
}

/// A texture as a material names it.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// Index of the texture.
    pub texture: usize,
    /// Set of texture coordinates.
    pub set: u32,
    /// Map of the coordinates, rows of a 2x3 matrix.
    pub uv: [[f64; 3]; 2],
}

/// Coordinates as they are.
const SAME: [[f64; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

fn numbers<const N: usize>(value: Option<&Value>, default: [f64; N]) -> [f64; N] {
    let list = value.and_then(Value::as_array);
    std::array::from_fn(|i| {
        let number = list.and_then(|list| list.get(i)).and_then(Value::as_f64);
        number.filter(|n| n.is_finite()).unwrap_or(default[i])
    })
}

/// A finite number of a JSON object, or a default.
pub fn number(object: &Value, name: &str, default: f64) -> f64 {
    object.get(name).and_then(Value::as_f64).filter(|n| n.is_finite()).unwrap_or(default)
}

/// Three finite numbers of a JSON object, or a default.
pub fn triple(object: &Value, name: &str, default: [f64; 3]) -> [f64; 3] {
    numbers(object.get(name), default)
}

impl Slot {
    fn new(texture: usize, set: u32, transform: Option<&Value>) -> Self {
        let mut slot = Self { texture, set, uv: SAME };
        if let Some(transform) = transform {
            let [left, top] = numbers(transform.get("offset"), [0.0, 0.0]);
            let [width, height] = numbers(transform.get("scale"), [1.0, 1.0]);
            let angle = number(transform, "rotation", 0.0);
            let (s, c) = (maths::sin(angle), maths::cos(angle));
            slot.uv = [[c * width, s * height, left], [-s * width, c * height, top]];
            if let Some(set) = transform.get("texCoord").and_then(Value::as_u64) {
                slot.set = u32::try_from(set).unwrap_or(u32::MAX);
            }
        }
        slot
    }

    /// Of an ordinary slot.
    pub fn of(info: &Info) -> Self {
        let transform = info.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform"));
        Self::new(info.index.value(), info.tex_coord, transform)
    }

    /// Of a normal map.
    pub fn of_normal(info: &NormalTexture) -> Self {
        let transform = info.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform"));
        Self::new(info.index.value(), info.tex_coord, transform)
    }

    /// Of a slot in an extension's JSON.
    pub fn of_json(info: Option<&Value>) -> Option<Self> {
        let info = info?;
        let texture = usize::try_from(info.get("index")?.as_u64()?).ok()?;
        let set = info.get("texCoord").and_then(Value::as_u64).and_then(|s| u32::try_from(s).ok()).unwrap_or(0);
        let transform = info.get("extensions").and_then(|e| e.get("KHR_texture_transform"));
        Some(Self::new(texture, set, transform))
    }

    /// The image that the texture shows, and whether it ends at its border instead of repeating.
    ///
    /// # Errors
    /// If the texture, its image or its sampler is not there, or only of a format that is not read.
    pub fn image(&self, document: &Document<'_>, report: &mut AssetReport) -> Result<(usize, bool), Refusal> {
        let place = format!("texture {}", self.texture);
        let root = &document.root;
        let texture = root.textures.get(self.texture).ok_or_else(|| damaged(&place, "there is no such texture"))?;
        let other = |name: &str| {
            let source = texture.extensions.as_ref()?.others.get(name)?.get("source")?.as_u64()?;
            usize::try_from(source).ok()
        };
        let own = texture.source.value();
        let image = if own < root.images.len() {
            own
        } else if let Some(webp) = other("EXT_texture_webp") {
            webp
        } else if other("KHR_texture_basisu").is_some() {
            return Err(Refusal::new(place, "KTX2 textures are not read", "convert them to PNG, JPEG or WebP"));
        } else {
            return Err(damaged(place, "it names no image that is there"));
        };
        let Some(sampler) = texture.sampler else { return Ok((image, false)) };
        let sampler = root
            .samplers
            .get(sampler.value())
            .ok_or_else(|| damaged(&place, "it names a sampler that is not there"))?;
        let wraps = [&sampler.wrap_s, &sampler.wrap_t];
        if wraps.iter().any(|w| matches!(w, Checked::Valid(WrappingMode::MirroredRepeat))) {
            report.note("mirrored textures are repeated plainly");
        }
        let clamps = |w: &Checked<WrappingMode>| matches!(w, Checked::Valid(WrappingMode::ClampToEdge));
        if clamps(wraps[0]) != clamps(wraps[1]) {
            report.note("textures clamped along one axis are repeated along both");
        }
        Ok((image, wraps.into_iter().all(clamps)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_positive_rotation_is_counter_clockwise_with_v_downwards() {
        // A transform of the Khronos file TextureTransformMultiTest, whose check mark is in the upper right corner.
        let info = serde_json::json!({ "index": 3, "texCoord": 0, "extensions": { "KHR_texture_transform":
            { "offset": [0.705, 0.285], "rotation": core::f64::consts::FRAC_PI_2, "scale": [0.35, 0.35],
              "texCoord": 1 } } });
        let slot = Slot::of_json(Some(&info)).expect("a slot");
        assert_eq!((slot.texture, slot.set), (3, 1));
        let [u, v] = slot.uv.map(|row| row[0] * 0.5 + row[1] * 0.5 + row[2]);
        assert!((u - 0.88).abs() < 1e-9 && (v - 0.11).abs() < 1e-9, "{u} {v}");
        assert_eq!(Slot::of_json(Some(&serde_json::json!({ "texCoord": 0 }))), None);
    }
}
