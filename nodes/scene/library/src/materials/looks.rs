//! From what a part is made of to its BSDF, by regime.
//!
//! A share `diffuse.textured` of what may be plain (paint, plastic, plaster, glazes) has maps; what is known by its
//! pattern (wood, brick, print) has them always, unless that share is 0.

use super::{
    Materials,
    optics::Metal,
    palette::{at_level, within},
    surface::{Laid, Place, Tone},
    two_sided,
};
use crate::{
    stuff::Stuff,
    textures::{COVERS, Pattern},
};
use tauflow_contract::KindError;
use tauflow_data::{
    Regime,
    rng::Stream,
    scene::{Bsdf, Texture},
};

/// The look of a stuff in all regimes: maps, or a plain colour.
enum Look {
    Laid(Box<Laid>),
    Plain([f32; 3]),
}

/// How a stuff shines by itself.
#[derive(Clone, Copy, PartialEq)]
enum Shine {
    /// Not at all, unless it is to show gloss.
    Dull,
    /// Glazes, lacquers, polished stone.
    Coat,
    /// Metals.
    Metal,
}

fn shine(stuff: Stuff) -> Shine {
    match stuff {
        Stuff::Metal | Stuff::Mirror => Shine::Metal,
        Stuff::PaintedMetal | Stuff::Plastic | Stuff::Ceramic | Stuff::Tile => Shine::Coat,
        _ => Shine::Dull,
    }
}

/// Whether a closed body of it may be of glass where glass is the subject.
fn castable(stuff: Stuff) -> bool {
    !matches!(
        stuff,
        Stuff::Fabric
            | Stuff::Carpet
            | Stuff::Leather
            | Stuff::Paper
            | Stuff::Print
            | Stuff::Wallpaper
            | Stuff::Plaster
            | Stuff::Brick
            | Stuff::Concrete
            | Stuff::Tile
            | Stuff::Leaf
            | Stuff::Grass
            | Stuff::Soil
            | Stuff::Sand
            | Stuff::Asphalt
            | Stuff::Snow
            | Stuff::Metal
            | Stuff::PaintedMetal
            | Stuff::Mirror
            | Stuff::Pane
            | Stuff::Water
            | Stuff::Glow
            | Stuff::Screen
    )
}

impl Materials<'_, '_> {
    /// The BSDF of a part. `uv_per_metre`: how many units of uv one metre of the surface has (1 for forms; for a
    /// rectangle `[1 / width, -1 / height]`, whose v grows upwards over its unit square).
    ///
    /// `special`: this part shows the regime. That is gloss in L1; in L2 and L3 a body of glass (so it must be closed,
    /// unless it is of a stuff that is never cast or blown), in L3 mirrors of metal.
    ///
    /// In L0 and L1 nothing lets light through: panes and water are opaque there, and better left out.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn stuff(
        &self,
        stuff: Stuff,
        regime: Regime,
        special: bool,
        uv_per_metre: [f64; 2],
        draw: &mut Stream,
    ) -> Result<Bsdf, KindError> {
        // A rectangle's v grows upwards, that of images downwards.
        let once = (uv_per_metre != [1.0; 2]).then_some([[0.0, 1.0], [1.0, 0.0]]);
        self.stuff_over(stuff, regime, special, uv_per_metre, once, draw)
    }

    /// As [`Self::stuff`], for a part whose uv spans the box `extent` (low, high; row 0 of an image at the first v):
    /// what is printed is then one picture over the whole.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn stuff_over(
        &self,
        stuff: Stuff,
        regime: Regime,
        special: bool,
        uv_per_metre: [f64; 2],
        extent: Option<[[f64; 2]; 2]>,
        draw: &mut Stream,
    ) -> Result<Bsdf, KindError> {
        let glassy = matches!(regime, Regime::L2 | Regime::L3);
        let mut d = draw.part("optics");
        if glassy {
            let whole = stuff == Stuff::Glass || (special && castable(stuff));
            match (stuff, regime) {
                _ if whole && regime == Regime::L2 => return Ok(self.frosted(&mut d)),
                _ if whole => return Ok(self.clear(&mut d)),
                (Stuff::Pane, _) => return Ok(self.pane(&mut d)),
                (Stuff::Water, _) => {
                    let place = Place::Repeated(uv_per_metre);
                    let ripples = self.lay(Pattern::of("ripples"), place, Tone::Own, None, &mut d)?;
                    let [low, _] = self.ranges.refractive.roughness;
                    return Ok(self.water(&mut d, if regime == Regime::L2 { low } else { 0.0 }, &ripples));
                }
                (Stuff::Mirror, Regime::L3) => return Ok(self.mirror(&mut d, 0.0)),
                (Stuff::Metal, Regime::L3) if special => {
                    return Ok(self.conductor(Metal::new(&mut d), 0.0, Texture::scalar(1.0)));
                }
                _ => {}
            }
        }
        match stuff {
            Stuff::Screen => return Ok(plain([0.02; 3])),
            Stuff::Glow => return Ok(plain([0.5; 3])),
            _ => {}
        }
        if shine(stuff) == Shine::Metal && regime != Regime::L0 {
            return self.polished(stuff, regime, uv_per_metre, &mut d);
        }
        let look = self.look(stuff, uv_per_metre, extent, draw)?;
        let coat = match regime {
            Regime::L0 => false,
            Regime::L1 => special || shine(stuff) == Shine::Coat,
            Regime::L2 | Regime::L3 => shine(stuff) == Shine::Coat,
        };
        Ok(match look {
            Look::Laid(laid) if coat => self.coated(&laid, &mut d),
            Look::Laid(laid) => {
                let large = uv_per_metre != [1.0; 2]
                    && matches!(stuff, Stuff::Plaster | Stuff::Concrete | Stuff::Brick | Stuff::Stone | Stuff::Wood);
                if large && d.part("dirt").chance(0.35) { self.soiled(&laid, &mut d)? } else { self.matte(&laid) }
            }
            Look::Plain(color) if coat => two_sided(Bsdf::Plastic {
                diffuse_reflectance: Texture::rgb(color),
                int_ior: d.range(1.4, 1.7) as f32,
                ext_ior: 1.0,
                alpha: self.gloss(&mut d) as f32,
            }),
            Look::Plain(color) => plain(color),
        })
    }

    /// Metals that shine: brushed or scratched, of one alpha or by a roughness map; mirrors that are not quite smooth.
    fn polished(
        &self,
        stuff: Stuff,
        regime: Regime,
        uv_per_metre: [f64; 2],
        d: &mut Stream,
    ) -> Result<Bsdf, KindError> {
        let alpha = self.gloss(d);
        let [smoothest, _] = self.ranges.glossy.roughness;
        let metal = if stuff == Stuff::Mirror { Metal::silver() } else { Metal::new(d) };
        let name = if stuff == Stuff::Mirror || d.chance(0.4) { "scratched" } else { "brushed" };
        // L2 is about broad light through glass: its metals are of the principled sort, never conductors.
        let conducting = regime != Regime::L2 && d.chance(self.ranges.glossy.metal);
        if !self.textured(d, true) {
            let alpha = if stuff == Stuff::Mirror { smoothest } else { alpha };
            return Ok(if conducting {
                self.conductor(metal, alpha, Texture::scalar(1.0))
            } else {
                metallic(Texture::rgb(metal.color().map(|c| c as f32)), Texture::scalar(alpha.sqrt() as f32))
            });
        }
        let place = Place::Repeated(uv_per_metre);
        if stuff == Stuff::Metal && d.chance(0.1) {
            // Rusted through: its bare parts do not shine any more.
            return Ok(self.matte(&self.lay(Pattern::of("rust"), place, Tone::Nature, None, d)?));
        }
        let level = metal.color().iter().fold(0.0f64, |m, c| m.max(*c));
        let laid = self.lay(Pattern::of(name), place, Tone::Of(metal.color(), 0.95 * level), None, d)?;
        Ok(if conducting {
            // The conductor has its own colour: the map dims it alone.
            laid.bumped(self.conductor(metal, alpha, laid.share()))
        } else {
            laid.bumped(metallic(laid.albedo(), laid.roughness(alpha)))
        })
    }

    /// Whether a surface has maps; `may_be_plain` if it is known without.
    fn textured(&self, draw: &mut Stream, may_be_plain: bool) -> bool {
        let share = self.ranges.diffuse.textured;
        if may_be_plain { draw.part("textured").chance(share.max(0.0).sqrt()) } else { share > 0.0 }
    }

    /// The maps of a stuff, or its colour.
    fn look(
        &self,
        stuff: Stuff,
        uv_per_metre: [f64; 2],
        extent: Option<[[f64; 2]; 2]>,
        draw: &mut Stream,
    ) -> Result<Look, KindError> {
        let mut d = draw.part("look");
        let albedo = self.ranges.diffuse.albedo;
        let [low, high] = albedo;
        // Rectangles are floors and walls.
        let broad = uv_per_metre != [1.0; 2];
        let color = self.palette.pick(&mut d);
        let pale = self.palette.pale(&mut d);
        let level = d.range(low, high);
        // White as paint and paper are, where the range allows.
        let bright = d.range(0.5 * (low + high), high);
        let of = |names: &[&'static str], d: &mut Stream| *d.pick(names);
        let dark = d.range(0.03, 0.06);
        let (name, tone, may_be_plain) = match stuff {
            Stuff::Wood if broad => {
                (of(&["planks", "planks", "planks", "parquet", "weathered", "veneer"], &mut d), Tone::Own, false)
            }
            Stuff::Wood => (of(&["veneer", "veneer", "veneer", "veneer", "weathered"], &mut d), Tone::Own, false),
            Stuff::Bark => ("bark", Tone::Own, false),
            Stuff::Stone if broad => (of(&["marble", "terrazzo", "rock", "paving"], &mut d), Tone::Own, false),
            Stuff::Stone => (of(&["rock", "rock", "marble"], &mut d), Tone::Own, false),
            Stuff::Concrete => ("concrete", Tone::Own, false),
            Stuff::Brick => ("brick", Tone::Own, false),
            Stuff::Plaster => ("plaster", Tone::Of(pale, bright), true),
            Stuff::Tile => ("tiles", Tone::Own, false),
            Stuff::Wallpaper => ("wallpaper", Tone::Of(pale, bright), false),
            Stuff::Fabric => {
                let own = d.chance(0.3);
                let names: &[&'static str] =
                    if own { &["check", "stripes"] } else { &["plain", "twill", "herringbone", "wrinkles"] };
                (of(names, &mut d), if own { Tone::Own } else { Tone::Of(color, level) }, false)
            }
            Stuff::Carpet if d.chance(0.55) => ("rug", Tone::Own, false),
            Stuff::Carpet => ("pile", Tone::Of(color, level), false),
            Stuff::Leather => {
                let hide = [[0.42, 0.2, 0.1], [0.2, 0.12, 0.08], [0.7, 0.5, 0.32], [0.16, 0.15, 0.15], color];
                let hide = *d.pick(&hide);
                ("leather", Tone::Of(hide, level.min(0.5).max(low)), false)
            }
            Stuff::Paper => ("paper", Tone::Of([1.0, d.range(0.94, 1.0), d.range(0.82, 0.98)], bright), true),
            Stuff::Print if broad => ("poster", Tone::Nature, false),
            Stuff::Print => (of(&["covers", "covers", "covers", "poster"], &mut d), Tone::Nature, false),
            Stuff::Metal | Stuff::Mirror => {
                let metal = if stuff == Stuff::Mirror { Metal::silver() } else { Metal::new(&mut d) };
                let names = ["brushed", "scratched", "scratched", "rust"];
                match of(if stuff == Stuff::Mirror { &names[..2] } else { &names }, &mut d) {
                    "rust" => ("rust", Tone::Nature, false),
                    // The diffuse colour of a metal.
                    name => (name, Tone::Of(metal.color(), (0.6 * level + 0.15).clamp(low, high)), true),
                }
            }
            Stuff::PaintedMetal if d.chance(0.5) => ("chipped", Tone::Of(color, level), true),
            Stuff::PaintedMetal => ("grain", Tone::Of(color, level), true),
            Stuff::Plastic => ("grain", Tone::Of(color, level), true),
            Stuff::Rubber => ("grain", Tone::Of([1.0, 0.98, 0.96], dark), true),
            Stuff::Ceramic => ("glaze", Tone::Of(if d.chance(0.5) { pale } else { color }, bright), true),
            Stuff::Clay => ("clay", Tone::Own, false),
            Stuff::Leaf => ("leaf", Tone::Own, false),
            Stuff::Grass if broad => ("lawn", Tone::Nature, false),
            Stuff::Grass => ("blade", Tone::Own, false),
            Stuff::Soil => ("soil", Tone::Nature, false),
            Stuff::Sand => (of(&["sand", "gravel", "gravel"], &mut d), Tone::Own, false),
            Stuff::Asphalt => (of(&["asphalt", "asphalt", "paving"], &mut d), Tone::Nature, false),
            Stuff::Snow => ("snow", Tone::Nature, false),
            Stuff::Wax => ("plaster", Tone::Of(pale, bright), true),
            Stuff::Food => ("food", Tone::Own, false),
            // Where light may not pass, a pane and a pool show what they mirror: a pale and a deep blue.
            Stuff::Glass | Stuff::Pane => ("scratched", Tone::Of([0.88, 0.96, 1.0], bright), true),
            Stuff::Water => ("ripples", Tone::Of([0.45, 0.75, 0.9], low.max(0.2)), false),
            Stuff::Glow | Stuff::Screen => ("paper", Tone::Of([1.0; 3], bright), true),
        };
        let pattern = Pattern::of(name);
        if !self.textured(&mut d, may_be_plain) {
            let plain = match tone {
                Tone::Of(color, level) => at_level(color, level),
                Tone::Own | Tone::Nature => within(color, albedo, &mut d),
            };
            return Ok(Look::Plain(plain));
        }
        let (place, shift) = match (name, extent) {
            ("poster", Some(extent)) => (Place::Once(extent), Some([0.0; 2])),
            ("covers", Some(extent)) => (Place::part(extent, COVERS, d.below(COVERS * COVERS)), Some([0.0; 2])),
            ("covers", None) => {
                // A whole cover away: forms begin with their covers at the origin of uv.
                let cell = d.below(COVERS * COVERS);
                let shift = [cell % COVERS, cell / COVERS].map(|k| k as f64 / COVERS as f64);
                (Place::Repeated(uv_per_metre), Some(shift))
            }
            ("leaf" | "poster", None) => (Place::Repeated(uv_per_metre), Some([0.0; 2])),
            _ => (Place::Repeated(uv_per_metre), None),
        };
        Ok(Look::Laid(Box::new(self.lay(pattern, place, tone, shift, &mut d)?)))
    }

    /// Radiance over a glowing part ([`Stuff::Glow`], [`Stuff::Screen`]): mean luminance 1, times `radiance`. Its uv is
    /// taken as the unit square, as a rectangle's.
    ///
    /// # Errors
    /// If a blob cannot be stored.
    #[cfg(test)]
    pub fn glow(
        &self,
        stuff: Stuff,
        draw: &mut Stream,
        radiance: tauflow_data::scene::Rgb,
    ) -> Result<Texture, KindError> {
        self.glow_over(stuff, draw, radiance, [[0.0, 1.0], [1.0, 0.0]])
    }

    /// As [`Self::glow`], for a part whose uv spans the box `extent` (low, high; row 0 of an image at the first v).
    ///
    /// # Errors
    /// If a blob cannot be stored.
    pub fn glow_over(
        &self,
        stuff: Stuff,
        draw: &mut Stream,
        radiance: tauflow_data::scene::Rgb,
        extent: [[f64; 2]; 2],
    ) -> Result<Texture, KindError> {
        let mut d = draw.part("glow");
        let name = if stuff == Stuff::Screen { "screen" } else { "lampshade" };
        // Bulbs and tubes are even.
        let share = self.ranges.textured_lights;
        if share <= 0.0 || (stuff != Stuff::Screen && !d.chance(share)) {
            return Ok(Texture::rgb(radiance));
        }
        let laid = self.lay(Pattern::of(name), Place::Once(extent), Tone::Nature, Some([0.0; 2]), &mut d)?;
        Ok(laid.radiance(radiance))
    }
}

fn plain(color: [f32; 3]) -> Bsdf {
    two_sided(Bsdf::Diffuse { reflectance: Texture::rgb(color) })
}

fn metallic(base_color: Texture, roughness: Texture) -> Bsdf {
    two_sided(Bsdf::Principled {
        base_color,
        metallic: Texture::scalar(1.0),
        roughness,
        specular: 0.5,
        spec_trans: Texture::scalar(0.0),
        clearcoat: 0.0,
        clearcoat_gloss: 0.9,
    })
}
