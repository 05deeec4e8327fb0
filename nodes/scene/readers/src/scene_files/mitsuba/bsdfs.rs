//! Mitsuba's BSDFs. Knows no shape.

use super::{DEEPEST, MOST_VISITS, Material, MitsubaReader, Plugin, Property, Value, textures::Role};
use crate::scene_files::{build::holds, spectra};
use tauflow_data::scene::{Bsdf, DELTA_ALPHA, Distribution, ReliefForm, Texture};

/// The default indices of refraction of Mitsuba's plugins.
const BK7: f64 = 1.5046;
const AIR: f64 = 1.000_277;
const POLYPROPYLENE: f64 = 1.49;

/// A surface that nothing meets.
fn nothing() -> Bsdf {
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
    Bsdf::Mask { opacity: Texture::scalar(0.0), inner }
}

/// Microfacets that are not GGX of one roughness.
#[derive(Default)]
struct Facets {
    beckmann: bool,
    alpha: Option<Texture>,
    alpha_v: Option<Texture>,
}

impl Facets {
    /// A BSDF with these facets.
    fn around(self, inner: Bsdf, nonlinear: bool) -> Bsdf {
        if !self.beckmann && self.alpha.is_none() && !nonlinear {
            return inner;
        }
        let distribution = if self.beckmann { Distribution::Beckmann } else { Distribution::Ggx };
        let Self { alpha, alpha_v, .. } = self;
        Bsdf::Finish { distribution, alpha, alpha_v, nonlinear, inner: Box::new(inner) }
    }
}

impl<'t> MitsubaReader<'t, '_, '_> {
    /// The material of a BSDF by its plugin's number.
    pub(super) fn material(&mut self, number: usize) -> Option<Material> {
        if let Some(made) = self.materials.get(&number) {
            return made.clone();
        }
        (self.reads, self.visits[0]) = ([None, None], 0);
        let bsdf = self.bsdf(&self.tree.plugins[number]);
        let reads = std::mem::take(&mut self.reads);
        let made = bsdf.map(|bsdf| Material { index: self.build.material(bsdf), reads });
        self.materials.insert(number, made.clone());
        made
    }

    fn bsdf(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        self.depth += 1;
        let of = [0, 2];
        of.iter().for_each(|i| self.visits[*i] += 1);
        let made = if self.depth > DEEPEST || of.iter().any(|i: &usize| self.visits[*i] > MOST_VISITS[*i]) {
            self.build.problems.error(&plugin.at, "BSDFs in BSDFs without end", "take one out");
            None
        } else {
            self.of_sort(plugin)
        };
        self.depth -= 1;
        made
    }

    fn of_sort(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let made = match plugin.sort.as_str() {
            "diffuse" => {
                self.texture_or(plugin, "reflectance", Role::Share, 0.5).map(|r| Bsdf::Diffuse { reflectance: r })
            }
            "conductor" | "roughconductor" => self.conductor(plugin),
            "dielectric" | "roughdielectric" => self.dielectric(plugin),
            "thindielectric" => {
                let [int_ior, ext_ior] = self.indices(plugin, BK7);
                self.specular(plugin).map(|[specular_reflectance, specular_transmittance]| Bsdf::ThinDielectric {
                    int_ior,
                    ext_ior,
                    specular_reflectance,
                    specular_transmittance,
                })
            }
            "plastic" | "roughplastic" => self.plastic(plugin),
            "principled" => self.principled(plugin),
            "mask" => {
                let opacity = self.texture_or(plugin, "opacity", Role::Number, 0.5);
                let [inner] = self.nested(plugin)?;
                Some(Bsdf::Mask { opacity: opacity?, inner: Box::new(inner) })
            }
            "blendbsdf" => {
                let weight = self.texture_or(plugin, "weight", Role::Number, 0.5);
                let [a, b] = self.nested(plugin)?;
                Some(self.build.blend(weight?, a, b, &plugin.at))
            }
            "normalmap" => self.normal_map(plugin),
            "bumpmap" => self.bump_map(plugin),
            "twosided" => {
                let [inner] = self.nested(plugin)?;
                if holds(&inner, |b| matches!(b, Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. })) {
                    self.build.problems.error(&plugin.at, "`twosided` about what lets light through", "take it out");
                }
                Some(Bsdf::TwoSided { inner: Box::new(inner) })
            }
            "null" => Some(nothing()),
            _ => {
                self.unsupported(plugin, "use `principled` or another one that is");
                return None;
            }
        };
        self.finish(plugin);
        made
    }

    /// Exactly so many BSDFs inside.
    fn nested<const N: usize>(&mut self, plugin: &'t Plugin) -> Option<[Bsdf; N]> {
        let inside = self.inside(plugin, "bsdf");
        if inside.len() != N {
            let what = format!("`{}` with {} BSDFs inside is not supported", plugin.sort, inside.len());
            self.build.problems.error(&plugin.at, what, &format!("put {N} into it"));
            return None;
        }
        let made: Vec<Bsdf> = inside.into_iter().filter_map(|(_, inner)| self.bsdf(inner)).collect();
        made.try_into().ok()
    }

    fn index(&mut self, plugin: &'t Plugin, name: &str, default: f64) -> f32 {
        let Some(property) = self.find(plugin, name) else { return default as f32 };
        let found = match &property.value {
            Value::Number(value) => Some(*value),
            Value::Text(text) => spectra::index(&text.to_ascii_lowercase()),
            _ => None,
        };
        if found.is_none_or(|v| v <= 0.0) {
            self.wrong(property, "index of refraction or name of a material");
        }
        found.unwrap_or(default) as f32
    }

    /// The indices inside and outside.
    fn indices(&mut self, plugin: &'t Plugin, inside: f64) -> [f32; 2] {
        let found = [self.index(plugin, "int_ior", inside), self.index(plugin, "ext_ior", AIR)];
        self.build.check_index(found[0], found[1], &plugin.at);
        found
    }

    fn specular(&mut self, plugin: &'t Plugin) -> Option<[Texture; 2]> {
        let reflectance = self.texture_or(plugin, "specular_reflectance", Role::Share, 1.0);
        let transmittance = self.texture_or(plugin, "specular_transmittance", Role::Share, 1.0);
        Some([reflectance?, transmittance?])
    }

    // All that a plugin may have is read before anything that is wrong ends its reading: what is unread is told as
    // unsupported.

    /// The roughness of a rough plugin, and its facets if they are not GGX's of that roughness; 0 of a smooth plugin.
    fn facets(&mut self, plugin: &'t Plugin) -> Option<(f32, Facets)> {
        if !plugin.sort.starts_with("rough") {
            return Some((0.0, Facets::default()));
        }
        let along = match (self.find(plugin, "alpha_u"), self.find(plugin, "alpha_v")) {
            (Some(u), Some(v)) => match (self.roughness(u), self.roughness(v)) {
                (Some(u), Some(v)) if u == v => Some((u, None)),
                (u, v) => u.zip(v).map(|(u, v)| (u, Some(v))),
            },
            (None, None) => match self.find(plugin, "alpha") {
                Some(property) => self.roughness(property).map(|alpha| (alpha, None)),
                None => Some((Texture::scalar(0.1), None)),
            },
            _ => {
                self.build.problems.error(&plugin.at, "one of `alpha_u` and `alpha_v`", "give both, or `alpha`");
                None
            }
        };
        let beckmann = match self.text(plugin, "distribution").unwrap_or("beckmann") {
            "beckmann" => true,
            "ggx" => false,
            other => {
                let what = format!("the distribution `{other}` is not supported");
                self.build.problems.error(&plugin.at, what, "use `beckmann` or `ggx`");
                false
            }
        };
        self.pass_over(plugin, &["sample_visible"]);
        let (alpha, across) = along?;
        for texture in [&alpha].into_iter().chain(&across) {
            if let Texture::Constant { value } = texture {
                self.build.check_alpha(f64::from(value[0]), &plugin.at);
            }
        }
        Some(match (alpha, across) {
            (Texture::Constant { value: [alpha, ..] }, None) => {
                // What is smooth has no facets.
                (alpha, Facets { beckmann: beckmann && alpha >= DELTA_ALPHA, ..Facets::default() })
            }
            (alpha, alpha_v) => (1.0, Facets { beckmann, alpha: Some(alpha), alpha_v }),
        })
    }

    /// A roughness by a number or a texture.
    fn roughness(&mut self, property: &'t Property) -> Option<Texture> {
        match property.value {
            // What is beyond 1 is told with the plugin.
            Value::Number(value) => Some(Texture::scalar(value as f32)),
            _ => self.texture(property, Role::Number),
        }
    }

    fn conductor(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let facets = self.facets(plugin);
        let specular_reflectance = self.texture_or(plugin, "specular_reflectance", Role::Share, 1.0);
        let mut complex = [None, None];
        for (value, name) in complex.iter_mut().zip(["eta", "k"]) {
            let Some(property) = self.find(plugin, name) else { continue };
            match self.color(property, false) {
                Some(color) if color.iter().all(|v| *v >= 0.0) => *value = Some(color.map(|v| v as f32)),
                _ => self.wrong(property, "constant index"),
            }
        }
        let name = self.text(plugin, "material");
        let [eta, k] = match (complex, name) {
            ([None, None], None | Some("none")) => [[0.0; 3], [1.0; 3]],
            ([None, None], Some(name)) => {
                let found = spectra::metal(name);
                if found.is_none() {
                    let what = format!("there is no material `{name}`");
                    self.build.problems.error(&plugin.at, what, "name one of Mitsuba's, or give `eta` and `k`");
                }
                found?
            }
            ([Some(eta), Some(k)], None) => [eta, k],
            _ => {
                self.build.problems.error(&plugin.at, "`eta`, `k` and `material`", "give both indices, or a material");
                return None;
            }
        };
        let ((alpha, facets), specular_reflectance) = (facets?, specular_reflectance?);
        Some(facets.around(Bsdf::Conductor { eta, k, alpha, specular_reflectance }, false))
    }

    fn dielectric(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let facets = self.facets(plugin);
        let [int_ior, ext_ior] = self.indices(plugin, BK7);
        let [specular_reflectance, specular_transmittance] = self.specular(plugin)?;
        let (alpha, facets) = facets?;
        let made = Bsdf::Dielectric { int_ior, ext_ior, alpha, specular_reflectance, specular_transmittance };
        Some(facets.around(made, false))
    }

    fn plastic(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let facets = self.facets(plugin);
        let [int_ior, ext_ior] = self.indices(plugin, POLYPROPYLENE);
        let diffuse_reflectance = self.texture_or(plugin, "diffuse_reflectance", Role::Share, 0.5);
        let nonlinear = self.flag(plugin, "nonlinear", false);
        let coat = self.texture_or(plugin, "specular_reflectance", Role::Share, 1.0);
        let (alpha, facets) = facets?;
        if facets.alpha.is_some() {
            let what = "a plastic whose `alpha` is a texture or depends on the direction";
            self.build.problems.error(&plugin.at, what, "use one number");
            return None;
        }
        if coat? != Texture::scalar(1.0) {
            let what = "`specular_reflectance` of a plastic is not supported";
            self.build.problems.error(&plugin.at, what, "take it out");
        }
        let diffuse_reflectance = diffuse_reflectance?;
        Some(facets.around(Bsdf::Plastic { diffuse_reflectance, int_ior, ext_ior, alpha }, nonlinear))
    }

    fn principled(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let base_color = self.texture_or(plugin, "base_color", Role::Share, 0.5);
        let metallic = self.texture_or(plugin, "metallic", Role::Number, 0.0);
        let roughness = self.texture_or(plugin, "roughness", Role::Number, 0.5);
        let spec_trans = self.texture_or(plugin, "spec_trans", Role::Number, 0.0);
        let specular = match (self.number(plugin, "specular"), self.number(plugin, "eta")) {
            (None, Some(eta)) => ((eta - 1.0) / (eta + 1.0)) * ((eta - 1.0) / (eta + 1.0)) / 0.08,
            (specular, None) => specular.unwrap_or(0.5),
            (Some(_), Some(_)) => {
                self.build.problems.error(&plugin.at, "`specular` and `eta`", "give one of them");
                0.5
            }
        };
        let mut constant = |name: &str, default: f64| match self.texture_or(plugin, name, Role::Number, default as f32)
        {
            Some(Texture::Constant { value }) => value[0],
            // It was told what is wrong with it.
            None => 0.0,
            Some(_) => {
                let what = format!("`{name}` by a texture is not supported");
                self.build.problems.error(&plugin.at, what, "use one number");
                0.0
            }
        };
        let (clearcoat, clearcoat_gloss) = (constant("clearcoat", 0.0), constant("clearcoat_gloss", 0.0));
        let absent = ["anisotropic", "spec_tint", "sheen", "sheen_tint", "flatness"];
        let absent: Vec<&str> = absent.into_iter().filter(|name| constant(name, 0.0) != 0.0).collect();
        for name in absent {
            let what = format!("`{name}` of `principled` is not supported");
            self.build.problems.error(&plugin.at, what, "set it to 0");
        }
        if !(0.0..=1.0).contains(&specular) {
            let what = format!("a specular level of {specular}");
            self.build.problems.error(&plugin.at, what, "use 0 to 1, or an index of refraction up to 1.79");
        }
        let sampling = ["diffuse_reflectance_sampling_rate", "main_specular_sampling_rate", "clearcoat_sampling_rate"];
        self.pass_over(plugin, &sampling);
        Some(Bsdf::Principled {
            base_color: base_color?,
            metallic: metallic?,
            roughness: roughness?,
            specular: specular as f32,
            spec_trans: spec_trans?,
            clearcoat,
            clearcoat_gloss,
        })
    }

    fn normal_map(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let inner = self.nested(plugin);
        let property = self.find(plugin, "normalmap");
        if property.is_none() {
            self.build.problems.error(&plugin.at, "a normal map without `normalmap`", "name a texture so");
        }
        let map = property.and_then(|property| self.texture(property, Role::Normals));
        let [flip, shadowing] = self.relief_options(plugin);
        let (map, [inner]) = (map?, inner?);
        self.check_relief(plugin, &inner);
        let inner = Box::new(inner);
        Some(match (flip, shadowing) {
            (false, false) => Bsdf::NormalMap { map, scale: 1.0, inner },
            _ => Bsdf::Relief { form: ReliefForm::Normals, map, scale: 1.0, flip, shadowing, inner },
        })
    }

    fn bump_map(&mut self, plugin: &'t Plugin) -> Option<Bsdf> {
        let inner = self.nested(plugin);
        // The texture may have any name.
        let is_texture = |plugin: &Plugin| plugin.tag == "texture" || plugin.tag == "spectrum";
        let mut found = Vec::new();
        for property in &plugin.properties {
            if matches!(property.value, Value::Plugin(_) | Value::Reference(_))
                && self.resolved(property).is_some_and(is_texture)
            {
                property.used.set(true);
                found.push(property);
            }
        }
        let scale = self.number(plugin, "scale").unwrap_or(1.0) as f32;
        let [flip, shadowing] = self.relief_options(plugin);
        let [property] = found.as_slice() else {
            let what = format!("a bump map with {} textures", found.len());
            self.build.problems.error(&plugin.at, what, "put one into it");
            return None;
        };
        let (map, [inner]) = (self.texture(property, Role::Heights)?, inner?);
        if !matches!(map, Texture::Bitmap { .. } | Texture::Constant { .. }) {
            self.build.problems.error(&property.at, "a bump map that is no picture", "use a `bitmap`");
            return None;
        }
        self.check_relief(plugin, &inner);
        Some(Bsdf::Relief { form: ReliefForm::Heights, map, scale, flip, shadowing, inner: Box::new(inner) })
    }

    /// Whether mapped normals are turned towards the viewer, and whether they dim light at grazing incidence.
    fn relief_options(&mut self, plugin: &'t Plugin) -> [bool; 2] {
        [self.flag(plugin, "flip_invalid_normals", true), self.flag(plugin, "use_shadowing_function", true)]
    }

    /// Tells of a map inside a map.
    fn check_relief(&mut self, plugin: &'t Plugin, inner: &Bsdf) {
        if holds(inner, |bsdf| matches!(bsdf, Bsdf::NormalMap { .. } | Bsdf::Relief { .. })) {
            let what = "a normal or bump map inside another one is not supported";
            self.build.problems.error(&plugin.at, what, "keep one of them");
        }
        if holds(inner, |bsdf| matches!(bsdf, Bsdf::Finish { alpha_v: Some(_), .. })) {
            let what = "the direction of anisotropic roughness under a normal or bump map, which Mitsuba 3.9 takes \
                        from another frame (4% of the mean in our test, up to 60% in a bin)";
            self.build.problems.approximated(&plugin.at, what, "use one `alpha`");
        }
    }
}
