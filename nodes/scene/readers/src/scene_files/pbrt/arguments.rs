//! Parameters of directives by name and type.

use super::{Directive, Param, PbrtReader, Values};
use crate::scene_files::spectra;
use tauflow_data::geom::{Vec3, dot};

impl<'t> PbrtReader<'t, '_, '_> {
    /// A parameter by name, which counts as read from now on.
    pub(super) fn find(&self, directive: &'t Directive, name: &str) -> Option<&'t Param> {
        let found = directive.param(name).or_else(|| self.attribute(directive, name))?;
        found.used.set(true);
        Some(found)
    }

    /// A parameter that `Attribute` gives to a directive.
    fn attribute(&self, directive: &'t Directive, name: &str) -> Option<&'t Param> {
        let given = self.given.get(&(std::ptr::from_ref(directive) as usize))?;
        let target = match directive.name.as_str() {
            "Shape" => "shape",
            "LightSource" | "AreaLightSource" => "light",
            "Material" | "MakeNamedMaterial" => "material",
            "Texture" => "texture",
            _ => return None,
        };
        let fits = |of: &&&Directive| of.texts.first().is_some_and(|text| text == target);
        given.iter().rev().filter(fits).find_map(|of| of.param(name))
    }

    pub(super) fn wrong(&mut self, param: &Param, wanted: &str) {
        let what = format!("`{} {}` is no {wanted}", param.sort, param.name);
        self.build.problems.error(&param.at, what, "see pbrt-v4's documentation of its file format");
    }

    pub(super) fn number(&mut self, directive: &'t Directive, name: &str) -> Option<f64> {
        let param = self.find(directive, name)?;
        if let (Values::Numbers(values), "float" | "integer") = (&param.values, param.sort.as_str())
            && let [value] = values.as_slice()
        {
            return Some(*value);
        }
        self.wrong(param, "number");
        None
    }

    pub(super) fn flag(&mut self, directive: &'t Directive, name: &str, default: bool) -> bool {
        let Some(param) = self.find(directive, name) else { return default };
        if let Values::Bools(values) = &param.values
            && let [value] = values.as_slice()
        {
            return *value;
        }
        self.wrong(param, "boolean");
        default
    }

    pub(super) fn text(&mut self, directive: &'t Directive, name: &str) -> Option<&'t str> {
        let param = self.find(directive, name)?;
        if let Values::Texts(values) = &param.values
            && let [value] = values.as_slice()
        {
            return Some(value);
        }
        self.wrong(param, "text");
        None
    }

    pub(super) fn point(&mut self, directive: &'t Directive, name: &str) -> Option<Vec3> {
        let param = self.find(directive, name)?;
        if let Values::Numbers(values) = &param.values
            && let [x, y, z] = values.as_slice()
        {
            return Some([*x, *y, *z]);
        }
        self.wrong(param, "point");
        None
    }

    /// Rows of `N` numbers.
    pub(super) fn rows<const N: usize>(&mut self, directive: &'t Directive, name: &str) -> Option<Vec<[f32; N]>> {
        let param = self.find(directive, name)?;
        if let Values::Numbers(values) = &param.values
            && values.len().is_multiple_of(N)
        {
            let row = |c: &[f64]| std::array::from_fn(|i| c[i] as f32);
            return Some(values.chunks_exact(N).map(row).collect());
        }
        self.wrong(param, &format!("list of {N} numbers each"));
        None
    }

    /// The indices of a mesh.
    pub(super) fn indices<const N: usize>(&mut self, directive: &'t Directive, name: &str) -> Option<Vec<[u32; N]>> {
        let param = self.find(directive, name)?;
        if let Values::Numbers(values) = &param.values
            && values.len().is_multiple_of(N)
            && values.iter().all(|v| *v >= 0.0 && *v < f64::from(u32::MAX) && v.fract() == 0.0)
        {
            let row = |c: &[f64]| std::array::from_fn(|i| c[i] as u32);
            return Some(values.chunks_exact(N).map(row).collect());
        }
        self.wrong(param, &format!("list of {N} indices each"));
        None
    }

    /// Parameters that change how an image is found, not which.
    pub(super) fn pass_over(&self, directive: &'t Directive, names: &[&str]) {
        names.iter().for_each(|name| {
            self.find(directive, name);
        });
    }

    /// Names what of a directive nothing read.
    pub(super) fn finish(&mut self, directive: &'t Directive) {
        if directive.told.replace(true) {
            return;
        }
        let sort = directive.texts.last().map_or(String::new(), |t| format!(" `{t}`"));
        for param in directive.params.iter().filter(|p| !p.used.get()) {
            let what = format!("the parameter `{}` of {}{sort} is not supported", param.name, directive.name);
            self.build.problems.error(&param.at, what, "take it out");
            // An attribute may give it to another directive.
            param.used.set(true);
        }
    }

    /// A constant spectrum as linear RGB. Spectra of light have luminance 1, as pbrt's have.
    pub(super) fn color(&mut self, param: &'t Param, light: bool) -> Option<[f64; 3]> {
        let even = |rgb: [f64; 3]| rgb.map(|v| v / spectra::luminance(rgb));
        let found = match (&param.values, param.sort.as_str()) {
            (Values::Numbers(v), "rgb" | "color") if v.len() == 3 => {
                let value = [v[0], v[1], v[2]];
                Some(match self.converted.get(&(std::ptr::from_ref(param) as usize)) {
                    Some(map) => map.map(|row| dot(row, value)),
                    None => value,
                })
            }
            (Values::Numbers(v), "float") if v.len() == 1 => Some([v[0]; 3]),
            (Values::Numbers(v), "blackbody") if v.len() == 1 && v[0] > 0.0 => {
                let value = spectra::blackbody(v[0]);
                (spectra::luminance(value) > 0.0).then(|| even(value))
            }
            (Values::Numbers(v), "spectrum") if v.len() >= 4 && v.len() % 2 == 0 => {
                let points: Vec<(f64, f64)> = v.chunks_exact(2).map(|p| (p[0], p[1])).collect();
                let rising = points.windows(2).all(|w| w[0].0 < w[1].0);
                match (rising, light) {
                    (false, _) => None,
                    (true, true) => {
                        Some(spectra::tabulated(&points)).filter(|c| spectra::luminance(*c) > 0.0).map(even)
                    }
                    (true, false) => {
                        // In pbrt, a spectrum of 1 is white.
                        let white = spectra::luminance(spectra::under_daylight(&[(300.0, 1.0), (900.0, 1.0)]));
                        Some(spectra::under_daylight(&points).map(|v| v / white))
                    }
                }
            }
            (Values::Texts(v), "spectrum") if v.len() == 1 && light && v[0] == "stdillum-D65" => Some([1.0; 3]),
            _ => None,
        };
        if found.is_none() {
            self.wrong(param, "spectrum that is supported here");
        }
        found
    }
}
