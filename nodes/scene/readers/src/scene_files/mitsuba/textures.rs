//! Mitsuba's textures. Knows no surface.

use super::{DEEPEST, MitsubaReader, Plugin, Property, Value};
use crate::scene_files::build::{Bound, Channels};
use tauflow_data::scene::Texture;

/// The use of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Colours from 0 to 1.
    Share,
    /// One number from 0 to 1.
    Number,
    /// Radiance.
    Light,
    /// A normal map.
    Normals,
    /// Heights of a bump map.
    Heights,
}

impl<'t> MitsubaReader<'t, '_, '_> {
    /// The texture of a parameter, or a constant without it.
    pub(super) fn texture_or(&mut self, plugin: &'t Plugin, name: &str, role: Role, default: f32) -> Option<Texture> {
        match self.find(plugin, name) {
            Some(property) => self.texture(property, role),
            None => Some(Texture::scalar(default)),
        }
    }

    /// The texture that a parameter is.
    pub(super) fn texture(&mut self, property: &'t Property, role: Role) -> Option<Texture> {
        if let Some(value) = self.color(property, role == Role::Light) {
            let (name, at) = (&property.name, &property.at);
            return Some(Texture::rgb(match role {
                Role::Light => self.build.light(value, name, at),
                _ => self.build.share(value, name, at),
            }));
        }
        if !matches!(property.value, Value::Plugin(_) | Value::Reference(_)) {
            self.wrong(property, "colour or texture");
            return None;
        }
        let plugin = self.resolved(property)?;
        self.depth += 1;
        let made = if self.depth > DEEPEST { None } else { self.of_plugin(plugin, role) };
        self.depth -= 1;
        made
    }

    fn of_plugin(&mut self, plugin: &'t Plugin, role: Role) -> Option<Texture> {
        let made = match (plugin.tag.as_str(), plugin.sort.as_str()) {
            ("texture", "bitmap") => self.bitmap(plugin, role),
            ("texture", "checkerboard") => self.checkerboard(plugin, role),
            ("texture", "mesh_attribute") => self.attribute(plugin, role),
            _ => {
                self.unsupported(plugin, "use `bitmap`, `checkerboard`, `mesh_attribute` or a colour");
                return None;
            }
        };
        self.finish(plugin);
        made
    }

    fn bitmap(&mut self, plugin: &'t Plugin, role: Role) -> Option<Texture> {
        let raw = self.flag(plugin, "raw", false);
        if let Some(filter) = self.text(plugin, "filter_type")
            && filter != "bilinear"
        {
            self.build.problems.error(&plugin.at, format!("the filter `{filter}` is not supported"), "use `bilinear`");
        }
        let clamp = match self.text(plugin, "wrap_mode") {
            None | Some("repeat") => false,
            Some("clamp") => true,
            Some(mode) => {
                let what = format!("the wrap mode `{mode}` is not supported");
                self.build.problems.error(&plugin.at, what, "use `repeat` or `clamp`");
                false
            }
        };
        let uv = self.uv(plugin);
        self.pass_over(plugin, &["accel", "format"]);
        let path = self.text(plugin, "filename");
        if path.is_none() {
            self.build.problems.error(&plugin.at, "a bitmap without `filename`", "name a picture");
        }
        let number = matches!(role, Role::Number | Role::Heights);
        let channels = if number { Channels::Luminance } else { Channels::Colors };
        let bound = if matches!(role, Role::Light | Role::Heights) { Bound::Positive } else { Bound::Share };
        let image = self.build.picture(path?, raw, channels, bound, &plugin.at)?;
        Some(Texture::Bitmap { image, uv, scale: [1.0; 3], channel: None, clamp })
    }

    /// The map of texture coordinates, rows of a 2x3 matrix.
    fn uv(&mut self, plugin: &'t Plugin) -> [[f64; 3]; 2] {
        let map = self.transform(plugin, "to_uv").map_or(tauflow_data::scene::IDENTITY, |t| t.map);
        [0, 1].map(|r: usize| [map[r][0], map[r][1], map[r][3]])
    }

    fn checkerboard(&mut self, plugin: &'t Plugin, role: Role) -> Option<Texture> {
        let mut one = |name: &str, default: f32| {
            // What is wrong with a texture that is none was told.
            if let Texture::Constant { value } = self.texture_or(plugin, name, role, default)? {
                return Some(value);
            }
            let what = format!("`{name}` of a checkerboard is no constant colour");
            self.build.problems.error(&plugin.at, what, "use constant colours");
            None
        };
        let (color0, color1) = (one("color0", 0.4), one("color1", 0.2));
        let [a, b] = self.uv(plugin);
        if a[1] != 0.0 || b[0] != 0.0 || a[2] != 0.0 || b[2] != 0.0 {
            let what = "a checkerboard whose `to_uv` turns or moves it is not supported";
            self.build.problems.error(&plugin.at, what, "scale it alone, or use a picture");
        }
        // In Mitsuba, a square is half a unit of uv.
        Some(Texture::Checkerboard { color0: color0?, color1: color1?, scale: [2.0 * a[0], 2.0 * b[1]] })
    }

    fn attribute(&mut self, plugin: &'t Plugin, role: Role) -> Option<Texture> {
        let name = self.text(plugin, "name").filter(|name| name.starts_with("vertex_"));
        let scale = self.number(plugin, "scale").unwrap_or(1.0) as f32;
        let Some(name) = name else {
            let what = "a mesh attribute that is not one of vertices is not supported";
            self.build.problems.error(&plugin.at, what, "name one as `vertex_...`");
            return None;
        };
        let number = role == Role::Number;
        let slot = &mut self.reads[usize::from(number)];
        if slot.get_or_insert_with(|| name.to_owned()) != name {
            let what = "a second attribute of vertices in one material is not supported";
            self.build.problems.error(&plugin.at, what, "use one for colours and one for numbers");
            return None;
        }
        Some(Texture::VertexColor { scale: [scale; 3], channel: number.then_some(3) })
    }
}
