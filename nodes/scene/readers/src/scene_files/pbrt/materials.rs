//! pbrt's materials and textures.

use super::{Directive, Param, PbrtReader, Surface, Values};
use crate::scene_files::{
    build::{Bound, Channels, scaled},
    problems::Place,
    spectra,
};
use tauflow_data::scene::{Bsdf, DELTA_ALPHA, Distribution, Texture};

/// Deepest nesting of materials and textures through names.
const DEEPEST: usize = 32;

/// Most materials and textures in one material, and in all.
const MOST_VISITS: [usize; 2] = [1 << 12, 1 << 17];

/// Index of refraction of pbrt's glasses at 587.6 nm, and Abbe's number of its dispersion.
const GLASSES: [(&str, f64, f64); 7] = [
    ("glass-BK7", 1.5168, 64.17),
    ("glass-BAF10", 1.670_03, 47.11),
    ("glass-FK51A", 1.486_56, 84.47),
    ("glass-LASF9", 1.850_25, 32.17),
    ("glass-F5", 1.672_7, 32.21),
    ("glass-F10", 1.728_25, 28.41),
    ("glass-F11", 1.784_72, 25.76),
];

/// A surface that nothing meets.
pub(super) fn nothing() -> Bsdf {
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
    Bsdf::Mask { opacity: Texture::scalar(0.0), inner }
}

fn two_sided(inner: Bsdf) -> Bsdf {
    Bsdf::TwoSided { inner: Box::new(inner) }
}

impl<'t> PbrtReader<'t, '_, '_> {
    /// The index of the material of the shapes that follow, under an opacity.
    pub(super) fn material(&mut self, alpha: Option<&'t Param>) -> Option<usize> {
        let own = match self.state.material {
            Surface::Default => None,
            Surface::Own(directive) => Some(directive),
            Surface::Named(name, at) => Some(self.named(name, at)?),
        };
        let number = |of: Option<*const Directive>| of.map_or(0, |p| p as usize);
        // Directives do not move while they are read: where they lie tells them apart.
        let key = (number(own.map(std::ptr::from_ref)), alpha.map_or(0, |p| std::ptr::from_ref(p) as usize));
        if let Some(made) = self.made.get(&key) {
            return *made;
        }
        self.visits[0] = 0;
        let bsdf = match own {
            Some(directive) => self.bsdf(directive),
            None => Some(two_sided(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) })),
        };
        let opacity = alpha.map(|param| self.texture_of(param, true));
        let made = match (bsdf, opacity) {
            (Some(bsdf), None) => Some(self.build.material(bsdf)),
            (Some(bsdf), Some(Some(opacity))) => {
                Some(self.build.material(Bsdf::Mask { opacity, inner: Box::new(bsdf) }))
            }
            _ => None,
        };
        self.made.insert(key, made);
        made
    }

    fn named(&mut self, name: &str, at: &Place) -> Option<&'t Directive> {
        let found = self.materials.get(name).copied();
        if found.is_none() {
            self.build.problems.error(at, format!("there is no material `{name}`"), "define it before");
        }
        found
    }

    /// Goes one level deeper; false if it is too deep, or if there was too much of it.
    fn enter(&mut self) -> bool {
        self.depth += 1;
        self.visits = self.visits.map(|n| n + 1);
        self.depth <= DEEPEST && (0..2).all(|i| self.visits[i] <= MOST_VISITS[i])
    }

    fn bsdf(&mut self, directive: &'t Directive) -> Option<Bsdf> {
        let made = if !self.enter() {
            self.build.problems.error(&directive.at, "materials in materials without end", "take one out");
            None
        } else {
            self.of_sort(directive)
        };
        self.depth -= 1;
        made
    }

    fn of_sort(&mut self, directive: &'t Directive) -> Option<Bsdf> {
        let named = directive.name == "MakeNamedMaterial";
        let sort = if named { self.text(directive, "type").unwrap_or("") } else { self.name(directive) };
        let made = match sort {
            "diffuse" => {
                let reflectance = self.share(directive, "reflectance", 0.5)?;
                Some(two_sided(Bsdf::Diffuse { reflectance }))
            }
            "conductor" => self.conductor(directive),
            "dielectric" => {
                let (int_ior, alphas) = (self.index(directive), self.alphas(directive, ""));
                let white = Texture::scalar(1.0);
                Some(rough(alphas, |alpha| Bsdf::Dielectric {
                    int_ior,
                    ext_ior: 1.0,
                    alpha,
                    specular_reflectance: white.clone(),
                    specular_transmittance: white,
                }))
            }
            "thindielectric" => {
                let (int_ior, white) = (self.index(directive), Texture::scalar(1.0));
                Some(Bsdf::ThinDielectric {
                    int_ior,
                    ext_ior: 1.0,
                    specular_reflectance: white.clone(),
                    specular_transmittance: white,
                })
            }
            "coateddiffuse" => {
                let what = "a coat of layers, by Mitsuba's `plastic` (in our test, the share of light that it reflects \
                            differs by up to 2.6% where it is smooth, and by up to 0.7% from an alpha of 0.1 on)";
                self.build.problems.approximated(&directive.at, what, "use `diffuse` or `conductor`");
                let diffuse_reflectance = self.share(directive, "reflectance", 0.5)?;
                let (int_ior, [u, v]) = (self.index(directive), self.alphas(directive, ""));
                if u != v {
                    let what = "a coat whose roughness depends on the direction";
                    self.build.problems.approximated(&directive.at, what, "use one `roughness`");
                }
                let alpha = if u == v { u } else { (u * v).sqrt() };
                self.pass_over(directive, &["thickness", "maxdepth", "nsamples", "g"]);
                let inner = Box::new(Bsdf::Plastic { diffuse_reflectance, int_ior, ext_ior: 1.0, alpha });
                // Light that goes back and forth below the coat takes on the colour of the base.
                let distribution = Distribution::Ggx;
                let coated = Bsdf::Finish { distribution, alpha: None, alpha_v: None, nonlinear: true, inner };
                Some(two_sided(coated))
            }
            "mix" => self.mix(directive),
            "interface" | "none" | "" => Some(nothing()),
            _ => {
                let what = format!("the material `{sort}` is not supported");
                self.build.problems.error(&directive.at, what, "use `diffuse`, `conductor` or `dielectric`");
                directive.params.iter().for_each(|p| p.used.set(true));
                return None;
            }
        };
        let bent = match self.text(directive, "normalmap") {
            Some(path) => self.bent(directive, path, made),
            None => made,
        };
        self.finish(directive);
        bent
    }

    fn bent(&mut self, directive: &'t Directive, path: &'t str, inner: Option<Bsdf>) -> Option<Bsdf> {
        let what = "a normal map, whose normals that turn away from the viewer are black here (in our test, 2.3% of \
                    the mean and up to 71% in a bin)";
        self.build.problems.approximated(&directive.at, what, "take `normalmap` out");
        let image = self.build.picture(path, true, Channels::Colors, Bound::Share, &directive.at)?;
        let uv = [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]];
        let map = Texture::Bitmap { image, uv, scale: [1.0; 3], channel: None, clamp: false };
        Some(match inner? {
            Bsdf::TwoSided { inner } => two_sided(Bsdf::NormalMap { map, scale: 1.0, inner }),
            other => Bsdf::NormalMap { map, scale: 1.0, inner: Box::new(other) },
        })
    }

    fn share(&mut self, directive: &'t Directive, name: &str, default: f32) -> Option<Texture> {
        match self.find(directive, name) {
            Some(param) => self.texture_of(param, false),
            None => Some(Texture::scalar(default)),
        }
    }

    fn index(&mut self, directive: &'t Directive) -> f32 {
        let Some(param) = self.find(directive, "eta") else { return 1.5 };
        let found = match (&param.values, param.sort.as_str()) {
            (Values::Numbers(values), "float") if values.len() == 1 => Some(values[0]),
            (Values::Texts(values), "spectrum") if values.len() == 1 => {
                let glass = GLASSES.iter().find(|g| g.0 == values[0]);
                if let Some((name, index, abbe)) = glass {
                    let remedy = "write one index, such as `\"float eta\" 1.5`";
                    let what = format!(
                        "`{name}` without its dispersion: its index is {index} here, and varies by {:.1}% from blue \
                         (486 nm) to red (656 nm)",
                        100.0 * (index - 1.0) / abbe / index
                    );
                    self.build.problems.approximated(&param.at, what, remedy);
                }
                glass.map(|glass| glass.1)
            }
            _ => None,
        };
        if found.is_none_or(|v| v <= 0.0) {
            self.wrong(param, "index of refraction that is supported here");
        }
        let index = found.filter(|v| *v > 0.0).unwrap_or(1.5) as f32;
        self.build.check_index(index, 1.0, &param.at);
        index
    }

    /// GGX's alpha of pbrt's roughnesses along u and v.
    fn alphas(&mut self, directive: &'t Directive, prefix: &str) -> [f32; 2] {
        let remap = self.flag(directive, "remaproughness", true);
        let all = self.roughness(directive, &format!("{prefix}roughness"));
        ["u", "v"].map(|axis| {
            let own = self.roughness(directive, &format!("{prefix}{axis}roughness"));
            let roughness = own.or(all).unwrap_or(0.0).max(0.0);
            self.build.check_alpha(if remap { roughness.sqrt() } else { roughness }, &directive.at)
        })
    }

    fn roughness(&mut self, directive: &'t Directive, name: &str) -> Option<f64> {
        let param = self.find(directive, name)?;
        if let Texture::Constant { value } = self.texture_of(param, true)? {
            return Some(f64::from(value[0]));
        }
        self.wrong(param, "constant, and textures are not supported here");
        None
    }

    fn conductor(&mut self, directive: &'t Directive) -> Option<Bsdf> {
        let alphas = self.alphas(directive, "");
        if let Some(param) = self.find(directive, "reflectance") {
            let color = match self.texture_of(param, false)? {
                Texture::Constant { value } => value.map(|v| f64::from(v).min(0.9999)),
                _ => {
                    self.wrong(param, "constant, and textures are not supported here");
                    return None;
                }
            };
            let k = color.map(|r| (2.0 * r.sqrt() / (1.0 - r).sqrt()) as f32);
            return Some(metal([1.0; 3], k, alphas));
        }
        let mut index = |name: &str, which: usize| -> Option<[f32; 3]> {
            let copper = || spectra::metal("Cu").map(|m| m[which]);
            let Some(param) = self.find(directive, name) else { return copper() };
            if let Values::Texts(values) = &param.values {
                let metal = values.first().and_then(|v| v.strip_prefix("metal-")?.strip_suffix(&format!("-{name}")));
                let found = metal.and_then(spectra::metal).map(|m| m[which]);
                if found.is_none() {
                    self.wrong(param, "metal that is supported here (Ag, Al, Au, Cu, MgO, TiO2)");
                }
                return found;
            }
            self.color(param, false).map(|c| c.map(|v| v.max(0.0) as f32))
        };
        let (eta, k) = (index("eta", 0), index("k", 1));
        Some(metal(eta?, k?, alphas))
    }

    fn mix(&mut self, directive: &'t Directive) -> Option<Bsdf> {
        let param = self.find(directive, "materials");
        let weight = match self.find(directive, "amount") {
            Some(param) => self.texture_of(param, true),
            None => Some(Texture::scalar(0.5)),
        };
        let names = match param.map(|p| &p.values) {
            Some(Values::Texts(names)) if names.len() == 2 => names,
            _ => {
                self.build.problems.error(&directive.at, "a mix of other than two materials", "name two");
                return None;
            }
        };
        let mut one = |name: &'t str| {
            let directive = self.named(name, &directive.at)?;
            self.bsdf(directive)
        };
        let (a, b) = (one(&names[0]), one(&names[1]));
        Some(self.build.blend(weight?, a?, b?, &directive.at))
    }

    /// The texture that a parameter is or names: of numbers, or of colours from 0 to 1.
    pub(super) fn texture_of(&mut self, param: &'t Param, number: bool) -> Option<Texture> {
        if param.sort != "texture" {
            let value = self.color(param, false)?;
            return Some(Texture::rgb(if number {
                value.map(|v| v as f32)
            } else {
                self.build.share(value, &param.name, &param.at)
            }));
        }
        let Values::Texts(names) = &param.values else {
            self.wrong(param, "name of a texture");
            return None;
        };
        let name = names.first().map_or("", String::as_str);
        let Some(directive) = self.textures.get(&(name, number)).copied() else {
            let sort = if number { "float" } else { "spectrum" };
            let what = format!("there is no {sort} texture `{name}`");
            self.build.problems.error(&param.at, what, "define it before");
            return None;
        };
        let made = if !self.enter() {
            self.build.problems.error(&param.at, "textures in textures without end", "take one out");
            None
        } else {
            self.texture(directive, number)
        };
        self.depth -= 1;
        made
    }

    fn texture(&mut self, directive: &'t Directive, number: bool) -> Option<Texture> {
        let part = |this: &mut Self, name: &str, default: f32| match this.find(directive, name) {
            Some(param) => this.texture_of(param, number),
            None => Some(Texture::scalar(default)),
        };
        let made = match directive.texts[2].as_str() {
            "constant" => part(self, "value", 1.0),
            "imagemap" => self.image(directive, number),
            "scale" => {
                let (inner, by) = (part(self, "tex", 1.0)?, self.find(directive, "scale"));
                let by = match by {
                    Some(param) => self.texture_of(param, true),
                    None => Some(Texture::scalar(1.0)),
                };
                match (inner, by?) {
                    (inner, Texture::Constant { value }) => Some(scaled(inner, value)),
                    (Texture::Constant { value }, by) => Some(scaled(by, value)),
                    (a, b) => Some(Texture::Product { a: Box::new(a), b: Box::new(b) }),
                }
            }
            "mix" => {
                let (a, b) = (part(self, "tex1", 0.0)?, part(self, "tex2", 1.0)?);
                let amount = match self.find(directive, "amount") {
                    Some(param) => self.texture_of(param, true)?,
                    None => Texture::scalar(0.5),
                };
                match (a, b, amount) {
                    (
                        Texture::Constant { value: a },
                        Texture::Constant { value: b },
                        Texture::Constant { value: t },
                    ) => Some(Texture::rgb([0, 1, 2].map(|c: usize| a[c] + (b[c] - a[c]) * t[c]))),
                    _ => {
                        let what = "a mix of textures that are not constant is not supported";
                        self.build.problems.error(&directive.at, what, "bake it into a picture");
                        None
                    }
                }
            }
            "checkerboard" => {
                let colors = (part(self, "tex1", 1.0)?, part(self, "tex2", 0.0)?);
                let [a, b] = self.uv(directive);
                if self.number(directive, "dimension").unwrap_or(2.0) != 2.0 || a[2] != 0.0 || b[2] != 0.0 {
                    let what = "a checkerboard that is moved or solid is not supported";
                    self.build.problems.error(&directive.at, what, "scale it alone");
                }
                match colors {
                    (Texture::Constant { value: color0 }, Texture::Constant { value: color1 }) => {
                        Some(Texture::Checkerboard { color0, color1, scale: [a[0], b[1]] })
                    }
                    _ => {
                        let what = "a checkerboard of textures is not supported";
                        self.build.problems.error(&directive.at, what, "use constant colours");
                        None
                    }
                }
            }
            class => {
                let what = format!("the texture `{class}` is not supported");
                self.build.problems.error(&directive.at, what, "bake it into a picture");
                directive.params.iter().for_each(|p| p.used.set(true));
                return None;
            }
        };
        self.finish(directive);
        made
    }

    /// The map of texture coordinates, v upwards.
    fn uv(&mut self, directive: &'t Directive) -> [[f64; 3]; 2] {
        if self.text(directive, "mapping").unwrap_or("uv") != "uv" {
            let what = "a mapping other than `uv` is not supported";
            self.build.problems.error(&directive.at, what, "give the mesh texture coordinates");
        }
        let mut of = |name: &str, default: f64| self.number(directive, name).unwrap_or(default);
        [[of("uscale", 1.0), 0.0, of("udelta", 0.0)], [0.0, of("vscale", 1.0), of("vdelta", 0.0)]]
    }

    fn image(&mut self, directive: &'t Directive, number: bool) -> Option<Texture> {
        let [u, v] = self.uv(directive);
        let clamp = match self.text(directive, "wrap").unwrap_or("repeat") {
            "repeat" => false,
            "clamp" => true,
            wrap => {
                let what = format!("the wrap mode `{wrap}` is not supported");
                self.build.problems.error(&directive.at, what, "use `repeat` or `clamp`");
                false
            }
        };
        let raw = match self.text(directive, "encoding").unwrap_or("sRGB") {
            "sRGB" => false,
            "linear" => true,
            other => {
                let what = format!("the encoding `{other}` is not supported");
                self.build.problems.error(&directive.at, what, "use `sRGB` or `linear`");
                false
            }
        };
        match self.text(directive, "filter").unwrap_or("bilinear") {
            "point" => {
                self.build.problems.error(&directive.at, "the filter `point` is not supported", "use `bilinear`");
            }
            "bilinear" => {}
            _ => self.build.problems.note(&directive.at, "pictures are looked up bilinearly, without smaller copies"),
        }
        if self.flag(directive, "invert", false) {
            self.build.problems.error(&directive.at, "`invert` is not supported", "invert the picture");
        }
        self.pass_over(directive, &["maxanisotropy"]);
        let scale = self.number(directive, "scale").unwrap_or(1.0) as f32;
        let Some(path) = self.text(directive, "filename") else {
            self.build.problems.error(&directive.at, "an image map without `filename`", "name a picture");
            return None;
        };
        let channels = if number { Channels::Number } else { Channels::Colors };
        let image = self.build.picture(path, raw, channels, Bound::Share, &directive.at)?;
        // Row 0 of the picture is at v = 1 there.
        let uv = [u, [0.0, -v[1], 1.0 - v[2]]];
        Some(Texture::Bitmap { image, uv, scale: [scale; 3], channel: None, clamp })
    }
}

fn metal(eta: [f32; 3], k: [f32; 3], alphas: [f32; 2]) -> Bsdf {
    two_sided(rough(alphas, |alpha| Bsdf::Conductor { eta, k, alpha, specular_reflectance: Texture::scalar(1.0) }))
}

/// A metal or glass of these roughnesses along u and v.
fn rough([u, v]: [f32; 2], of: impl FnOnce(f32) -> Bsdf) -> Bsdf {
    // pbrt takes for smooth what is smoother than this along both.
    if u == v || u.max(v) < DELTA_ALPHA {
        return of(u);
    }
    let (alpha, alpha_v) = (Some(Texture::scalar(u)), Some(Texture::scalar(v)));
    Bsdf::Finish { distribution: Distribution::Ggx, alpha, alpha_v, nonlinear: false, inner: Box::new(of(1.0)) }
}

/// Whether a material looks anything up by texture coordinates.
pub(super) fn reads_uv(bsdf: &Bsdf) -> bool {
    fn mapped(texture: &Texture) -> bool {
        match texture {
            Texture::Constant { .. } | Texture::VertexColor { .. } => false,
            Texture::Checkerboard { .. } | Texture::Bitmap { .. } => true,
            Texture::Product { a, b } => mapped(a) || mapped(b),
        }
    }
    match bsdf {
        Bsdf::Diffuse { reflectance: t } | Bsdf::Plastic { diffuse_reflectance: t, .. } => mapped(t),
        Bsdf::Mask { opacity: t, inner } => mapped(t) || reads_uv(inner),
        Bsdf::Blend { weight: t, a, b } => mapped(t) || reads_uv(a) || reads_uv(b),
        Bsdf::NormalMap { .. } | Bsdf::Relief { .. } | Bsdf::Finish { alpha_v: Some(_), .. } => true,
        Bsdf::Finish { alpha, inner, .. } => alpha.as_ref().is_some_and(mapped) || reads_uv(inner),
        Bsdf::TwoSided { inner } => reads_uv(inner),
        Bsdf::Conductor { .. } | Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. } | Bsdf::Principled { .. } => {
            false
        }
    }
}
