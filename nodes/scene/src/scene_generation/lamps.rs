//! The light of a scene: lamps, the view through windows, the sky.

use super::{
    assemble::Assembly,
    cast::{Cast, Sky},
    stage::{HERE, Light, Stage},
};
use core::f64::consts::PI;
use tauflow_contract::KindError;
use tauflow_data::{
    Regime,
    geom::{Vec3, facing, rotation_y, sub},
    maths,
    rng::Stream,
    scene::{Affine, Bsdf, Emitter, Geometry, Texture},
};
use tauflow_scene_library::skies;

impl Assembly<'_, '_> {
    /// A radiance from candle to overcast, about a white of the same power.
    pub fn warm(&self, radiance: f64, d: &mut Stream) -> [f32; 3] {
        let warmth = d.range(-0.15, 0.55);
        [1.0 + 0.5 * warmth, 1.0 + 0.05 * warmth, 1.0 - 0.6 * warmth].map(|c| (c * radiance) as f32)
    }

    /// Lights a lamp of the stage.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn light(&mut self, number: usize, light: &Light, power: f64, cast: &Cast<'_>) -> Result<(), KindError> {
        let mut d = self.stream.part("lamps");
        let own = self.stream.part(&format!("light.{number}"));
        let lamps = self.hour.lamps * power;
        let small = {
            let [low, high] = self.params.caustic.emitter;
            own.part("radius").range(low, high)
        };
        let black = |w: &mut Self| w.material(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
        let disk = |w: &mut Self, at: Vec3, normal: Vec3, radius: f64, d: &mut Stream| {
            let radiance = w.warm(lamps / (PI * PI * radius * radius), d);
            let material = black(w);
            let to_world = facing(at, normal, [radius, radius]);
            w.shape(Geometry::Disk, short(&to_world), material, Some(Texture::rgb(radiance)));
        };
        match *light {
            Light::Panel(at, normal, half) if self.regime == Regime::L3 => {
                disk(self, at, normal, small.min(half[0].min(half[1])), &mut d);
            }
            Light::Panel(at, normal, half) => {
                let radiance = self.warm(lamps / (PI * 4.0 * half[0] * half[1]), &mut d);
                let material = black(self);
                let to_world = facing(at, normal, half);
                self.shape(Geometry::Rectangle, short(&to_world), material, Some(Texture::rgb(radiance)));
            }
            Light::Disk(at, normal, radius) => {
                let radius = if self.regime == Regime::L3 { small.min(radius) } else { radius };
                disk(self, at, normal, radius, &mut d);
            }
            Light::Ball(center, radius) => {
                let radiance = self.warm(lamps / (4.0 * PI * PI * radius * radius), &mut d);
                let material = black(self);
                let geometry = Geometry::Sphere { center, radius };
                self.shape(geometry, HERE, material, Some(Texture::rgb(radiance)));
            }
            Light::Spot(at, aim, angle) => match self.regime {
                Regime::L0 | Regime::L1 => {
                    let cone = 2.0 * PI * (1.0 - maths::cos(angle.to_radians()));
                    self.emitters.push(Emitter::Spot {
                        to_world: short(&facing(at, sub(aim, at), [1.0, 1.0])),
                        intensity: self.warm(1.5 * lamps / cone, &mut d),
                        cutoff_angle: angle,
                        beam_width: 0.7 * angle,
                    });
                }
                Regime::L2 => disk(self, at, sub(aim, at), 0.1, &mut d),
                Regime::L3 => disk(self, at, sub(aim, at), small.min(0.06), &mut d),
            },
            Light::Outside(at, normal, half) => {
                let level = (power * self.hour.windows) as f32;
                let emission = if self.params.textured_lights > 0.0 {
                    let (sky, variant) = cast.outside(&mut self.stream.part("outside"));
                    let image = skies::stored(self.ctx, sky.name, variant)?;
                    // A part of the sky: from a little below the horizon up, an eighth of the way round for 1.5 m.
                    let (wide, tall) = (half[0] / 6.0, half[1] / 5.0);
                    let turn = 0.25 * (f64::from(u8::from(normal[0] != 0.0)) + f64::from(u8::from(normal[2] > 0.0)));
                    let uv = [[wide, 0.0, turn + 0.05 * at[0] + 0.05 * at[2]], [0.0, -tall, 0.53]];
                    Texture::Bitmap { image, uv, scale: [level; 3], channel: None, clamp: false }
                } else {
                    Texture::scalar(level)
                };
                let material = black(self);
                let to_world = facing(at, normal, half);
                self.shape(Geometry::Rectangle, short(&to_world), material, Some(emission));
            }
        }
        Ok(())
    }

    /// Hangs the sky, and gives its name.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn sky(&mut self, stage: &Stage<'_>, cast: &Cast<'_>, turn: &mut Stream) -> Result<String, KindError> {
        let Some(sky) = cast.sky(&mut self.stream.part("sky"), stage.studio) else { return Ok("none".to_owned()) };
        let turn = (turn.range(0.0, 2.0 * PI) * 1e3).round() / 1e3;
        let (image, mean) = match &sky {
            Sky::Procedural(kind, variant) => (skies::stored(self.ctx, kind.name, *variant)?, 1.0),
            Sky::Hdri(_, image, mean) => (*image, mean.max(1e-6)),
        };
        let scale = (stage.sky * self.hour.sky / mean) as f32;
        self.emitters.push(Emitter::Envmap { image, scale, to_world: short(&rotation_y(turn)) });
        Ok(sky.name())
    }
}

/// A map in fewer digits.
fn short(map: &Affine) -> Affine {
    map.map(|row| row.map(|v| (v * 1e6).round() / 1e6 + 0.0))
}
