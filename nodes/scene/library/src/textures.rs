//! The library of procedural maps: tileable colour, roughness and normals of one height field, in fixed variants.
//!
//! Like the forms, variants come from the library and not from a scene's seed, so that scenes share blobs. Everything
//! has its real size: [`Pattern::period`] is how many metres a map covers. Knows no scene and no BSDF.

mod canvas;
mod cloth;
pub mod field;
mod ground;
mod masonry;
mod metal;
mod print;
mod skin;
mod stone;
#[cfg(test)]
mod tests;
mod wood;

pub use print::COVERS;
pub use skin::Maps;

use cloth::Weave;
use field::Size;
use skin::Skin;
use tauflow_data::rng::Stream;

/// Raised when the maps of a variant change: what is kept of earlier ones is then not found.
pub const VERSION: u32 = 1;

/// A sort of map.
pub struct Pattern {
    /// Its name.
    pub name: &'static str,
    /// Columns and rows.
    pub size: Size,
    /// Metres that one period covers along u and v.
    pub period: [f64; 2],
    /// Variants of it in one library.
    pub variants: u64,
    /// True if its colour has one channel, and so takes any colour.
    pub gray: bool,
    /// True if both of its ends meet; of pictures they need not.
    pub tiles: bool,
    make: fn(&mut Stream, Size) -> Skin,
}

type Make = fn(&mut Stream, Size) -> Skin;

const fn natural(name: &'static str, size: usize, period: f64, make: Make) -> Pattern {
    Pattern { name, size: [size, size], period: [period, period], variants: 8, gray: false, tiles: true, make }
}

const fn gray(name: &'static str, size: usize, period: f64, make: Make) -> Pattern {
    Pattern { gray: true, ..natural(name, size, period, make) }
}

const fn picture(name: &'static str, size: usize, period: f64, make: Make) -> Pattern {
    Pattern { tiles: false, ..natural(name, size, period, make) }
}

/// Every sort, in order of name.
pub static PATTERNS: [Pattern; 46] = [
    natural("asphalt", 512, 1.6, ground::asphalt),
    natural("bark", 256, 0.9, wood::bark),
    natural("blade", 64, 0.08, wood::blade),
    Pattern { period: [2.0, 1.92], ..natural("brick", 512, 2.0, masonry::brick) },
    gray("brushed", 256, 0.4, metal::brushed),
    natural("check", 256, 0.4, |d, s| cloth::woven(d, s, Weave::Check)),
    natural("chipped", 256, 0.8, metal::chipped),
    natural("clay", 256, 0.5, metal::clay),
    natural("concrete", 512, 2.4, stone::concrete),
    Pattern { period: [0.64, 0.88], ..picture("covers", 512, 0.64, print::covers) },
    Pattern { gray: true, ..picture("dirt", 256, 1.0, ground::dirt) },
    natural("food", 128, 0.12, metal::food),
    gray("glaze", 256, 0.3, metal::glaze),
    gray("grain", 256, 0.12, metal::grain),
    natural("gravel", 512, 0.9, ground::gravel),
    gray("herringbone", 256, 0.3, |d, s| cloth::woven(d, s, Weave::Herringbone)),
    natural("lampshade", 128, 0.4, print::lampshade),
    natural("lawn", 512, 1.0, ground::lawn),
    natural("leaf", 128, 0.12, wood::leaf),
    gray("leather", 256, 0.3, cloth::leather),
    natural("marble", 512, 1.6, stone::marble),
    gray("paper", 256, 0.3, cloth::paper),
    natural("parquet", 512, 0.96, wood::parquet),
    natural("paving", 512, 2.0, masonry::paving),
    gray("pile", 256, 0.4, cloth::pile),
    gray("plain", 256, 0.25, |d, s| cloth::woven(d, s, Weave::Plain)),
    natural("planks", 512, 1.44, wood::planks),
    gray("plaster", 256, 1.5, stone::plaster),
    Pattern { period: [0.6, 0.8], ..picture("poster", 256, 0.6, print::poster) },
    gray("ripples", 256, 2.4, ground::ripples),
    natural("rock", 256, 1.2, stone::rock),
    natural("rug", 512, 1.6, cloth::rug),
    natural("rust", 256, 0.6, metal::rust),
    natural("sand", 256, 1.0, ground::sand),
    gray("scratched", 256, 0.5, metal::scratched),
    picture("screen", 256, 0.6, print::screen),
    natural("snow", 256, 1.8, ground::snow),
    natural("soil", 256, 1.0, ground::soil),
    natural("stripes", 256, 0.5, |d, s| cloth::woven(d, s, Weave::Stripes)),
    natural("terrazzo", 512, 1.2, stone::terrazzo),
    natural("tiles", 512, 1.2, masonry::tiles),
    gray("twill", 256, 0.2, |d, s| cloth::woven(d, s, Weave::Twill)),
    natural("veneer", 256, 0.9, wood::veneer),
    natural("wallpaper", 256, 1.06, cloth::wallpaper),
    natural("weathered", 512, 1.44, wood::weathered),
    gray("wrinkles", 256, 1.0, cloth::wrinkles),
];

impl Pattern {
    /// The sort of this name; there must be one.
    pub fn of(name: &str) -> &'static Self {
        let at = PATTERNS.binary_search_by(|p| p.name.cmp(name));
        &PATTERNS[at.unwrap_or_else(|_| panic!("the library has no maps named `{name}`"))]
    }

    /// The maps of a variant: a function of name and variant alone.
    pub fn maps(&self, variant: u64) -> Maps {
        let mut draw = Stream::new(0x7465_7874, &[variant]).part(self.name);
        (self.make)(&mut draw, self.size).maps(self.period, self.gray)
    }
}
