//! `KHR_materials_pbrSpecularGlossiness` in terms of the core: a surface without metal. Knows nothing of meshes.

use super::{
    images::Use,
    slots::{Slot, extension, number, triple},
    textures::Making,
};
use crate::assets::refusal::Refusal;
use gltf::json::material::Material as Source;
use serde_json::Value;

/// A material of `KHR_materials_pbrSpecularGlossiness` in terms of the core: its slots and factors moved over.
pub fn glossy(material: &Source) -> Option<Source> {
    let old = extension(material, "KHR_materials_pbrSpecularGlossiness")?;
    let mut new = material.clone();
    let pbr = &mut new.pbr_metallic_roughness;
    let [r, g, b] = triple(old, "diffuseFactor", [1.0; 3]);
    let alpha = old.get("diffuseFactor").and_then(|f| f.get(3)).and_then(Value::as_f64).unwrap_or(1.0);
    pbr.base_color_factor.0 = [r, g, b, alpha].map(|v| v as f32);
    pbr.base_color_texture = old.get("diffuseTexture").and_then(|t| serde_json::from_value(t.clone()).ok());
    pbr.metallic_roughness_texture = None;
    pbr.metallic_factor.0 = 0.0;
    pbr.roughness_factor.0 = (1.0 - number(old, "glossinessFactor", 1.0)) as f32;
    let specular = triple(old, "specularFactor", [1.0; 3]).into_iter().sum::<f64>() / 3.0;
    // `specularFactor` there is F0 itself, here it scales that of the index of refraction 1.5.
    let scaled = serde_json::json!({ "specularFactor": (specular / 0.04).min(1.0) });
    new.extensions.get_or_insert_default().others.insert("KHR_materials_specular".to_owned(), scaled);
    Some(new)
}

impl Making<'_, '_, '_> {
    /// Puts the averages of a texture of `KHR_materials_pbrSpecularGlossiness` into the factors made of it.
    ///
    /// # Errors
    /// If its image cannot be read.
    pub fn average_gloss(&mut self, material: &mut Source) -> Result<(), Refusal> {
        let Some(old) = extension(material, "KHR_materials_pbrSpecularGlossiness").cloned() else { return Ok(()) };
        let Some(slot) = Slot::of_json(old.get("specularGlossinessTexture")) else { return Ok(()) };
        let gloss = self.averaged(Some(slot.clone()), Use::Alpha, "specular colour and gloss")?[0];
        let colors = self.average(&slot, Use::Color)?.map(f64::from);
        material.pbr_metallic_roughness.roughness_factor.0 =
            (1.0 - number(&old, "glossinessFactor", 1.0) * gloss) as f32;
        let factors = triple(&old, "specularFactor", [1.0; 3]);
        let specular = (0..3).map(|c| factors[c] * colors[c]).sum::<f64>() / 3.0;
        let scaled = serde_json::json!({ "specularFactor": (specular / 0.04).min(1.0) });
        material.extensions.get_or_insert_default().others.insert("KHR_materials_specular".to_owned(), scaled);
        Ok(())
    }
}
