//! Mitsuba's emitters that are no shapes.

use super::{MitsubaReader, Plugin};
use crate::scene_files::build::{Bound, Channels};
use tauflow_data::{
    geom::{apply, length, unit},
    scene::Emitter,
};

impl<'t> MitsubaReader<'t, '_, '_> {
    pub(super) fn emitter(&mut self, plugin: &'t Plugin) {
        let made = match plugin.sort.as_str() {
            "constant" => Some(Emitter::Constant { radiance: self.light(plugin, "radiance") }),
            "envmap" => self.envmap(plugin),
            "point" => {
                let map = self.transform(plugin, "to_world");
                let position = self.vector(plugin, "position").or(map.map(|m| apply(&m.map, [0.0; 3])));
                let intensity = self.light(plugin, "intensity");
                Some(Emitter::Point { position: position.unwrap_or([0.0; 3]), intensity })
            }
            "spot" => {
                let to_world = self.placed(plugin);
                let intensity = self.light(plugin, "intensity");
                let cutoff_angle = self.number(plugin, "cutoff_angle").unwrap_or(20.0);
                let beam_width = self.number(plugin, "beam_width").unwrap_or(0.75 * cutoff_angle);
                Some(Emitter::Spot { to_world, intensity, cutoff_angle, beam_width })
            }
            "directional" => {
                let map = self.placed(plugin);
                let along = [0, 1, 2].map(|r: usize| map[r][2]);
                let along = if length(along) > 0.0 { unit(along) } else { along };
                let direction = self.vector(plugin, "direction").unwrap_or(along);
                if length(direction) == 0.0 {
                    self.build.problems.error(&plugin.at, "a light without a direction", "give it one");
                }
                Some(Emitter::Directional { direction, irradiance: self.light(plugin, "irradiance") })
            }
            _ => {
                self.unsupported(plugin, "use `constant`, `envmap`, `point`, `spot`, `directional` or an `area`");
                return;
            }
        };
        self.pass_over(plugin, &["sampling_weight"]);
        self.finish(plugin);
        if let Some(emitter) = made {
            self.build.emitter(emitter, &plugin.at);
        }
    }

    fn envmap(&mut self, plugin: &'t Plugin) -> Option<Emitter> {
        let to_world = self.placed(plugin);
        let scale = self.number(plugin, "scale").unwrap_or(1.0) as f32;
        self.pass_over(plugin, &["mis_compensation"]);
        let Some(path) = self.text(plugin, "filename") else {
            self.build.problems.error(&plugin.at, "an environment map without `filename`", "name a picture");
            return None;
        };
        let image = self.build.picture(path, false, Channels::Colors, Bound::Positive, &plugin.at)?;
        Some(Emitter::Envmap { image, scale, to_world })
    }
}
