//! Materials of a glTF file in the terms of the scene format. Knows nothing of meshes but which attributes they have.
//!
//! | glTF | here |
//! |---|---|
//! | metallic-roughness | `principled` (base colour, metallic, roughness), two-sided: a path tracer culls no faces |
//! | `KHR_materials_ior`, `_specular` | `specular` = F0 / 0.08, F0 = ((n - 1) / (n + 1))^2 factor |
//! | `KHR_materials_clearcoat` | `clearcoat`, `clearcoat_gloss` = 1 - roughness; its texture blends coated and bare |
//! | `KHR_materials_transmission` with a thickness, closed body | `spec_trans` of `principled` |
//! | attenuation in its volume | base colour times `attenuationColor` ^ (thickness / `attenuationDistance`) |
//! | transmission, thin or open | a blend with `thin_dielectric`, tinted by the base colour |
//! | `MASK`, `BLEND` | `mask` with opacity 0 or 1 by the cut-off, or alpha itself |
//! | `KHR_materials_unlit` | diffuse: a path tracer has no unlit surface |
//! | emission, `_emissive_strength` | an area emitter |
//! | `KHR_materials_pbrSpecularGlossiness` | `principled` without metal; roughness = 1 - glossiness |

use super::{
    container::Document,
    glossiness::glossy,
    images::{Images, Use},
    slots::{Slot, extension, number, triple},
    textures::{Features, Making},
};
use crate::assets::{
    blobs::BlobSet,
    refusal::{Refusal, damaged},
};
use gltf::json::{
    material::{AlphaMode, Material as Source},
    validation::Checked,
};
use serde_json::Value;
use std::{borrow::Cow, collections::BTreeMap};
use tauflow_data::{
    maths,
    records::{AssetMaterial, AssetReport},
    scene::{Bsdf, Rgb, Texture},
};

/// The materials made of one file.
pub struct Materials<'a, 'd> {
    document: &'a Document<'d>,
    images: Images,
    made: BTreeMap<(Option<usize>, Features), usize>,
    /// The materials, in the order in which they were first asked for.
    pub list: Vec<AssetMaterial>,
}

/// The slots of a material, the one that decides the set of texture coordinates first.
fn slots(material: &Source) -> Vec<Slot> {
    let pbr = &material.pbr_metallic_roughness;
    let transmission = extension(material, "KHR_materials_transmission").and_then(|t| t.get("transmissionTexture"));
    let coat = extension(material, "KHR_materials_clearcoat").and_then(|t| t.get("clearcoatTexture"));
    let all = [
        pbr.base_color_texture.as_ref().map(Slot::of),
        material.normal_texture.as_ref().map(Slot::of_normal),
        pbr.metallic_roughness_texture.as_ref().map(Slot::of),
        material.emissive_texture.as_ref().map(Slot::of),
        Slot::of_json(transmission),
        Slot::of_json(coat),
    ];
    all.into_iter().flatten().collect()
}

/// Radiance that an emissive material has at most.
const BRIGHTEST: f64 = 1e6;

fn times(a: Texture, b: Texture) -> Texture {
    Texture::Product { a: Box::new(a), b: Box::new(b) }
}

fn two_sided(inner: Bsdf) -> Bsdf {
    Bsdf::TwoSided { inner: Box::new(inner) }
}

impl Making<'_, '_, '_> {
    /// A value within what the format or the renderer allows; one beyond is set to the nearest that is, and counted.
    fn allowed(&mut self, value: f64, [least, most]: [f64; 2], what: &str) -> f64 {
        let allowed = value.clamp(least, most);
        self.report.repaired(what, u64::from(allowed != value));
        allowed
    }

    /// A factor that the specification keeps within 0 and 1.
    fn factor(&mut self, value: impl Into<f64>) -> f64 {
        self.allowed(value.into(), [0.0, 1.0], "material factors outside of 0 to 1 cut to it")
    }

    /// Opacity, if it is not 1 everywhere.
    fn opacity(&mut self, material: &Source) -> Result<Option<Texture>, Refusal> {
        let pbr = &material.pbr_metallic_roughness;
        let factor = pbr.base_color_factor.0[3];
        let slot = pbr.base_color_texture.as_ref().map(Slot::of);
        match &material.alpha_mode {
            Checked::Valid(AlphaMode::Blend) => {
                let factor = self.factor(factor) as f32;
                let alpha = self.value(slot, Use::Alpha, [factor; 3], None, "opacity")?;
                let colors = Texture::VertexColor { scale: [1.0; 3], channel: Some(3) };
                Ok(Some(if self.features.colors { times(alpha, colors) } else { alpha }))
            }
            Checked::Valid(AlphaMode::Mask) => {
                let cutoff = material.alpha_cutoff.map_or(0.5, |c| c.0);
                if cutoff <= 0.0 {
                    return Ok(None);
                }
                let factor = match self.features.alpha {
                    Some(alpha) => factor * f32::from_bits(alpha),
                    None => {
                        self.report.note("alpha of vertex colours is left out where holes are cut");
                        factor
                    }
                };
                // factor * alpha >= cutoff where alpha >= cutoff / factor.
                let threshold = if factor > 0.0 { cutoff / factor } else { f32::MAX };
                if slot.is_none() {
                    return Ok(Some(Texture::scalar(if threshold <= 1.0 { 1.0 } else { 0.0 })));
                }
                self.texture(slot, Use::Mask(threshold.to_bits()), [1.0; 3], None, "holes")
            }
            _ => Ok(None),
        }
    }

    fn emission(&mut self, material: &Source) -> Result<Option<Texture>, Refusal> {
        let strength =
            extension(material, "KHR_materials_emissive_strength").map_or(1.0, |e| number(e, "emissiveStrength", 1.0));
        let what = "radiances outside of 0 to 1e6 cut to it";
        let factor: Rgb =
            material.emissive_factor.0.map(|v| self.allowed(f64::from(v) * strength, [0.0, BRIGHTEST], what) as f32);
        if factor.iter().all(|v| *v <= 0.0) {
            return Ok(None);
        }
        self.texture(material.emissive_texture.as_ref().map(Slot::of), Use::Color, factor, None, "emission")
    }

    fn make(&mut self, material: &Source) -> Result<AssetMaterial, Refusal> {
        let pbr = &material.pbr_metallic_roughness;
        let base = pbr.base_color_factor.0;
        let slot = pbr.base_color_texture.as_ref().map(Slot::of);
        let scale = [base[0], base[1], base[2]].map(|v| self.factor(v) as f32);
        let mut color = self.value(slot, Use::Color, scale, None, "colour")?;
        if self.features.colors {
            color = times(color, Texture::VertexColor { scale: [1.0; 3], channel: None });
        }
        let opacity = self.opacity(material)?;
        let masked = |bsdf: Bsdf| match &opacity {
            Some(opacity) => Bsdf::Mask { opacity: opacity.clone(), inner: Box::new(bsdf) },
            None => bsdf,
        };
        let diffuse = masked(two_sided(Bsdf::Diffuse { reflectance: color.clone() }));
        let emission = self.emission(material)?;
        if extension(material, "KHR_materials_unlit").is_some() {
            self.report.note("unlit surfaces are shown as diffuse ones");
            return Ok(AssetMaterial { own: diffuse.clone(), diffuse, transmissive: false, emission });
        }
        let (surface, transmissive) = self.surface(material, &color)?;
        let bumps = match &material.normal_texture {
            Some(map) => {
                let found = self.texture(Some(Slot::of_normal(map)), Use::Linear, [1.0; 3], None, "bumps")?;
                found.map(|texture| (texture, map.scale))
            }
            None => None,
        };
        let own = match bumps {
            Some((map, scale)) => Bsdf::NormalMap { map, scale, inner: Box::new(surface) },
            None => surface,
        };
        Ok(AssetMaterial { own: masked(own), diffuse, transmissive, emission })
    }

    /// The transmittance of a volume over its thickness: `attenuationColor` remains after `attenuationDistance`.
    fn attenuation(&mut self, volume: &Value, thickness: f64) -> Result<Rgb, Refusal> {
        let distance = number(volume, "attenuationDistance", f64::INFINITY);
        if !(distance > 0.0 && distance.is_finite()) {
            return Ok([1.0; 3]);
        }
        self.report.note("attenuation in a volume is that over its thickness, unscaled, whatever the way through it");
        let thickness =
            thickness * self.averaged(Slot::of_json(volume.get("thicknessTexture")), Use::Linear, "thickness")?[1];
        // Black has no logarithm: a millionth is left of it.
        let what = "attenuation colours outside of 1e-6 to 1 cut to it";
        let color = triple(volume, "attenuationColor", [1.0; 3]).map(|c| self.allowed(c, [1e-6, 1.0], what));
        if color == [1.0; 3] {
            // Nothing is lost, however thick it is.
            return Ok(color.map(|c| c as f32));
        }
        // The quotient of two finite numbers may be infinite, which times the logarithm of 1 is no number.
        let what = "thicknesses of more than 1000 attenuation distances cut to it";
        let thickness = self.allowed(thickness / distance, [0.0, 1e3], what);
        Ok(color.map(|c| maths::exp(maths::log(c) * thickness) as f32))
    }

    /// The surface under normal map and opacity, and whether light passes through it.
    fn surface(&mut self, material: &Source, color: &Texture) -> Result<(Bsdf, bool), Refusal> {
        let pbr = &material.pbr_metallic_roughness;
        let roughness_slot = || pbr.metallic_roughness_texture.as_ref().map(Slot::of);
        let factors = [self.factor(pbr.metallic_factor.0), self.factor(pbr.roughness_factor.0)].map(|v| v as f32);
        let metallic = self.value(roughness_slot(), Use::Linear, [factors[0]; 3], Some(2), "metal and roughness")?;
        let roughness = self.value(roughness_slot(), Use::Linear, [factors[1]; 3], Some(1), "metal and roughness")?;
        let ior = extension(material, "KHR_materials_ior").map_or(1.5, |e| number(e, "ior", 1.5));
        let ior = self.allowed(ior, [1.0, 4.0], "indices of refraction outside of 1 to 4 cut to it");
        let mut f0 = ((ior - 1.0) / (ior + 1.0)) * ((ior - 1.0) / (ior + 1.0));
        if let Some(e) = extension(material, "KHR_materials_specular") {
            let tint = triple(e, "specularColorFactor", [1.0; 3])
                .map(|v| self.allowed(v, [0.0, f64::MAX], "negative specular colours set to 0"));
            let colors = self.averaged(Slot::of_json(e.get("specularColorTexture")), Use::Color, "specular colour")?;
            let share = self.averaged(Slot::of_json(e.get("specularTexture")), Use::Alpha, "specular reflection")?[0];
            let tint = [0, 1, 2].map(|c| tint[c] * colors[c]);
            f0 *= self.factor(number(e, "specularFactor", 1.0)) * share * (tint[0] + tint[1] + tint[2]) / 3.0;
            if tint[0] != tint[1] || tint[1] != tint[2] {
                self.report.note("specular tints are averaged");
            }
        }
        let (mut clearcoat, mut gloss) = (0.0, 1.0);
        // Where a texture says it there is the coat, which is a blend of the coated surface and the bare one.
        let mut coated = None;
        if let Some(e) = extension(material, "KHR_materials_clearcoat") {
            clearcoat = self.factor(number(e, "clearcoatFactor", 0.0));
            let rough = Slot::of_json(e.get("clearcoatRoughnessTexture"));
            let rough = self.averaged(rough, Use::Linear, "clearcoat roughness")?[1];
            gloss = 1.0 - self.factor(number(e, "clearcoatRoughnessFactor", 0.0)) * rough;
            let slot = Slot::of_json(e.get("clearcoatTexture"));
            if clearcoat > 0.0 && slot.is_some() {
                coated = self.texture(slot, Use::Linear, [1.0; 3], Some(0), "clearcoat")?;
                clearcoat = if coated.is_some() { clearcoat } else { 0.0 };
            }
            if e.get("clearcoatNormalTexture").is_some() {
                self.report.note("bumps of clearcoats are left out");
            }
        }
        for name in ["sheen", "iridescence", "anisotropy", "dispersion"] {
            if extension(material, &format!("KHR_materials_{name}")).is_some() {
                self.report.note(format!("{name} is left out"));
            }
        }
        let specular = f0 / 0.08;
        if specular > 1.0 {
            self.report.note("surfaces that reflect more than 8% head-on reflect 8%: an index of refraction of 1.79");
        }
        let covered = |base_color: &Texture, spec_trans: &Texture, clearcoat: f64| Bsdf::Principled {
            base_color: base_color.clone(),
            metallic: metallic.clone(),
            roughness: roughness.clone(),
            specular: specular.min(1.0) as f32,
            spec_trans: spec_trans.clone(),
            clearcoat: clearcoat as f32,
            clearcoat_gloss: gloss as f32,
        };
        let principled = |color: &Texture, share: &Texture, sides: fn(Bsdf) -> Bsdf| {
            let with = sides(covered(color, share, clearcoat));
            match &coated {
                Some(weight) => {
                    let without = sides(covered(color, share, 0.0));
                    Bsdf::Blend { weight: weight.clone(), a: Box::new(without), b: Box::new(with) }
                }
                None => with,
            }
        };
        let opaque = || principled(color, &Texture::scalar(0.0), two_sided);
        let Some(e) = extension(material, "KHR_materials_transmission") else { return Ok((opaque(), false)) };
        let factor = self.factor(number(e, "transmissionFactor", 0.0));
        if factor <= 0.0 {
            return Ok((opaque(), false));
        }
        let slot = Slot::of_json(e.get("transmissionTexture"));
        let share = self.texture(slot, Use::Linear, [factor as f32; 3], Some(0), "transmission")?;
        let Some(share) = share else { return Ok((opaque(), false)) };
        let volume = extension(material, "KHR_materials_volume");
        let thickness = volume.map_or(0.0, |v| number(v, "thicknessFactor", 0.0));
        if let Some(volume) = volume.filter(|_| thickness > 0.0 && self.features.closed) {
            // Light is tinted where it crosses the surface, by the square root of this at each of two crossings.
            let tint = self.attenuation(volume, thickness)?;
            let base = if tint == [1.0; 3] { color.clone() } else { times(color.clone(), Texture::rgb(tint)) };
            return Ok((principled(&base, &share, |one| one), true));
        }
        self.report.note("transmission through thin or open surfaces is smooth, whatever their roughness");
        // An index of 1 reflects nothing, one of 1.01 two hundred-thousandths.
        let ior = self.allowed(ior, [1.01, 4.0], "indices of refraction of thin or open surfaces below 1.01 set to it");
        let pane = Bsdf::ThinDielectric {
            int_ior: ior as f32,
            ext_ior: 1.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: color.clone(),
        };
        Ok((Bsdf::Blend { weight: share, a: Box::new(opaque()), b: Box::new(pane) }, true))
    }
}

impl<'a, 'd> Materials<'a, 'd> {
    /// None yet; images will be reduced to `most` texels a side.
    pub fn new(document: &'a Document<'d>, most: usize) -> Self {
        Self { document, images: Images::new(most, document.bytes()), made: BTreeMap::new(), list: Vec::new() }
    }

    fn source(&self, number: Option<usize>) -> Result<Option<Cow<'a, Source>>, Refusal> {
        let Some(number) = number else { return Ok(None) };
        let found = self.document.root.materials.get(number);
        let found = found.ok_or_else(|| damaged(format!("material {number}"), "there is no such material"))?;
        Ok(Some(glossy(found).map_or(Cow::Borrowed(found), Cow::Owned)))
    }

    /// The sets of texture coordinates that a material reads, the most important first, and whether it reads tangents.
    ///
    /// # Errors
    /// If there is no such material.
    pub fn reads(&self, number: Option<usize>) -> Result<(Vec<u32>, bool), Refusal> {
        let Some(source) = self.source(number)? else { return Ok((Vec::new(), false)) };
        let mut sets: Vec<u32> = Vec::new();
        for slot in slots(&source) {
            if !sets.contains(&slot.set) {
                sets.push(slot.set);
            }
        }
        Ok((sets, source.normal_texture.is_some()))
    }

    /// Whether a material shows both of its sides; if it does not exist, it shows one.
    pub fn is_double_sided(&self, number: Option<usize>) -> bool {
        number.and_then(|number| self.document.root.materials.get(number)).is_some_and(|material| material.double_sided)
    }

    /// The index of a material for meshes with such features; `None` is the default material.
    ///
    /// # Errors
    /// If there is no such material, or an image of it cannot be read.
    pub fn get(
        &mut self,
        number: Option<usize>,
        features: Features,
        blobs: &mut BlobSet,
        report: &mut AssetReport,
    ) -> Result<usize, Refusal> {
        let source = number.and_then(|number| self.document.root.materials.get(number));
        let cuts = source.is_some_and(|source| matches!(source.alpha_mode, Checked::Valid(AlphaMode::Mask)));
        let alpha = if cuts { features.alpha } else { Some(1.0f32.to_bits()) };
        let features = Features { alpha, ..features };
        let key = (number, features.clone());
        if let Some(made) = self.made.get(&key) {
            return Ok(*made);
        }
        let mut source = self.source(number)?.unwrap_or_default().into_owned();
        let document = self.document;
        if let Some(old) = extension(&source, "KHR_materials_pbrSpecularGlossiness")
            && triple(old, "specularFactor", [1.0; 3]).into_iter().sum::<f64>() > 3.0 * 0.04
        {
            report.note("specular-glossiness materials that reflect more than 4% head-on reflect 4%");
        }
        let mut making = Making { document, images: &mut self.images, blobs, report, features };
        making.average_gloss(&mut source)?;
        let material = making.make(&source)?;
        let index = self.list.iter().position(|m| *m == material).unwrap_or(self.list.len());
        if index == self.list.len() {
            self.list.push(material);
        }
        self.made.insert(key, index);
        Ok(index)
    }
}
