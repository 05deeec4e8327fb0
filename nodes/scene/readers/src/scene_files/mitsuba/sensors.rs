//! Mitsuba's sensors and films.

use super::{MitsubaReader, Plugin};
use crate::scene_files::build::{camera, fov_x, mirrors};
use tauflow_data::{
    maths,
    scene::{Camera, IDENTITY},
};

/// A camera, its film, and whether its picture is mirrored.
type Sensor = (Camera, [u32; 2], bool);

impl<'t> MitsubaReader<'t, '_, '_> {
    pub(super) fn sensor(&mut self, plugin: &'t Plugin) -> Option<Sensor> {
        if plugin.sort != "perspective" {
            let remedy = if plugin.sort == "thinlens" {
                "use `perspective`: nothing is out of focus"
            } else {
                "use `perspective`"
            };
            self.unsupported(plugin, remedy);
            return None;
        }
        let mut film = [768, 576];
        match self.inside(plugin, "film").as_slice() {
            [] => {}
            [(_, one)] => film = self.film(one),
            _ => self.build.problems.error(&plugin.at, "a sensor with several films", "leave one"),
        }
        self.inside(plugin, "sampler");
        let axis = self.text(plugin, "fov_axis");
        let (degrees, axis) = match (self.number(plugin, "fov"), self.text(plugin, "focal_length")) {
            (Some(fov), None) => (fov, axis.unwrap_or("x")),
            (None, length) => {
                // On film of 36 x 24 mm, across its diagonal.
                let millimetres = length.unwrap_or("50mm").trim().trim_end_matches("mm").trim().parse::<f64>();
                let millimetres = millimetres.ok().filter(|mm| *mm > 0.0 && mm.is_finite());
                if millimetres.is_none() || axis.is_some_and(|a| a != "diagonal") {
                    let what = "a `focal_length` that is no length, or along another axis";
                    self.build.problems.error(&plugin.at, what, "write such as `50mm`, without `fov_axis`");
                }
                let half = (36.0f64 * 36.0 + 24.0 * 24.0).sqrt() / (2.0 * millimetres.unwrap_or(50.0));
                (2.0 * maths::atan(half).to_degrees(), "diagonal")
            }
            (Some(_), Some(_)) => {
                self.build.problems.error(&plugin.at, "`fov` and `focal_length`", "give one of them");
                plugin.properties.iter().for_each(|p| p.used.set(true));
                return None;
            }
        };
        let fov = fov_x(degrees, axis, film).filter(|fov| *fov > 0.0 && *fov < 180.0);
        if fov.is_none() {
            let what = format!("a field of view of {degrees} degrees along `{axis}`");
            self.build.problems.error(
                &plugin.at,
                what,
                "use an angle below 180, along x, y, diagonal, smaller or larger",
            );
        }
        let near = self.number(plugin, "near_clip").unwrap_or(1e-2);
        let far = self.number(plugin, "far_clip").unwrap_or(1e4);
        for name in ["principal_point_offset_x", "principal_point_offset_y"] {
            if self.number(plugin, name).unwrap_or(0.0) != 0.0 {
                self.build.problems.error(&plugin.at, format!("`{name}` is not supported"), "set it to 0");
            }
        }
        self.pass_over(plugin, &["shutter_open", "shutter_close", "focus_distance"]);
        let placed = self.transform(plugin, "to_world");
        self.finish(plugin);
        let (fov, map) = (fov?, placed.map_or(IDENTITY, |t| t.map));
        let made = match placed.and_then(|t| t.look) {
            Some([origin, target, up]) => Camera { origin, target, up, fov_x: fov, near },
            None => camera(&map, fov, near),
        };
        self.build.check_camera(&made, &plugin.at);
        self.far = Some((made.clone(), far, &plugin.at));
        Some((made, film, mirrors(&map)))
    }

    fn film(&mut self, plugin: &'t Plugin) -> [u32; 2] {
        if plugin.sort != "hdrfilm" && plugin.sort != "ldrfilm" {
            self.unsupported(plugin, "use `hdrfilm`");
        }
        let mut side = |name: &str, default: f64| {
            let value = self.number(plugin, name).unwrap_or(default);
            if !(1.0..=65536.0).contains(&value) {
                self.build.problems.error(&plugin.at, format!("a film with a {name} of {value}"), "use 1 to 65536");
            }
            value.clamp(1.0, 65536.0) as u32
        };
        let film = [side("width", 768.0), side("height", 576.0)];
        for name in ["crop_offset_x", "crop_offset_y", "crop_width", "crop_height"] {
            if self.find(plugin, name).is_some() {
                self.build.problems.error(&plugin.at, "a crop of the film is not supported", "render all of it");
            }
        }
        let filters = self.inside(plugin, "rfilter");
        if filters.first().is_none_or(|(_, filter)| filter.sort != "box") {
            let what = "pixels are means over their squares (`box`), whatever the film's reconstruction filter";
            self.build.problems.note(&plugin.at, what);
        }
        let others = [
            "pixel_format",
            "component_format",
            "file_format",
            "high_quality_edges",
            "banner",
            "sample_border",
            "compensate",
        ];
        self.pass_over(plugin, &others);
        self.finish(plugin);
        film
    }
}
