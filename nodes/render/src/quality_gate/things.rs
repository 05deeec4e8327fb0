//! Visible things in a frame: things that lie mostly within it, and their contrast to the surroundings.
//!
//! A thing is a shape of the scene. Walls, floors and rims reach beyond the frame, so that few of their rays lie in it;
//! what one recognises mostly lies within. Objects behind clear glass count in addition to the glass.

use crate::{
    camera::Camera,
    geometry::{Ray, offset_origin},
    integrator::first_solid,
    rng::{FILM, Sampler, render_state},
    world::World,
};
use std::collections::BTreeMap;
use tauflow_contract::KindError;
use tauflow_data::{
    Image, SamplerKind, Scene,
    image::preview,
    maths,
    scene::{Bsdf, Texture},
};

use super::framing::SIDE;

/// Label that parts these samples from those of the render.
const STREAM: u64 = 0x7468_696e_6773;
/// Share of the frame's sides that rays go beyond on each side.
const BEYOND: usize = 4;
/// Surfaces of glass that a ray passes at most.
const PASSES: u32 = 12;
/// Roughness up to which one sees through glass.
const CLEAR: f64 = 0.1;
/// Rays of the frame that a thing has at least.
const LEAST: usize = 3;
/// Rays around it that it is compared with at least.
const AROUND: usize = 4;
/// Share of the frame from which a shape is what is around, and no thing.
const GROUND: f64 = 0.5;

/// One of them.
#[derive(Clone, Debug, PartialEq)]
struct Thing {
    /// Rays of the frame that meet it.
    cells: Vec<usize>,
    /// Rays two steps away from it.
    around: Vec<usize>,
    /// Share of its rays that lie in the frame, of those in a frame of one and a half times the sides.
    within: f64,
}

/// The hits of rays through a frame, grouped into things.
#[derive(Clone, Debug, PartialEq)]
pub struct Things {
    width: usize,
    height: usize,
    things: Vec<Thing>,
}

/// Whether one sees through a material as through a window.
fn clear(bsdf: &Bsdf) -> bool {
    match bsdf {
        Bsdf::Dielectric { alpha, .. } => f64::from(*alpha) <= CLEAR,
        Bsdf::ThinDielectric { .. } => true,
        Bsdf::Principled { spec_trans: Texture::Constant { value }, .. } => value[0] >= 0.5,
        // What a texture makes rough is nowhere seen through for sure.
        Bsdf::Finish { alpha: Some(_), .. } => false,
        Bsdf::Mask { inner, .. }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::Finish { inner, .. }
        | Bsdf::TwoSided { inner } => clear(inner),
        Bsdf::Principled { .. }
        | Bsdf::Conductor { .. }
        | Bsdf::Diffuse { .. }
        | Bsdf::Plastic { .. }
        | Bsdf::Blend { .. } => false,
    }
}

/// The middle value; of an even number the mean of both.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.len() % 2 == 1 { values[half] } else { 0.5 * (values[half - 1] + values[half]) }
}

impl Things {
    /// Traces the rays of a scene whose film has these sides.
    ///
    /// # Errors
    /// If the camera looks nowhere.
    pub fn of(world: &World, scene: &Scene, film: [usize; 2]) -> Result<Self, KindError> {
        let longest = film[0].max(film[1]).max(1);
        let [width, height] = film.map(|side| (side * SIDE).div_ceil(longest).max(1));
        let beyond = [width / BEYOND, height / BEYOND];
        let (wide, high) = (width + 2 * beyond[0], height + 2 * beyond[1]);
        let degrees = 360.0 / core::f64::consts::PI;
        let mut stands = world.camera.clone();
        let half = maths::tan(stands.fov_x / degrees) * wide as f64 / width as f64;
        stands.fov_x = maths::atan2(half, 1.0) * degrees;
        let camera = Camera::new(&stands, wide, high)?;
        let state = tauflow_data::rng::mix(render_state(world.seed, 0), STREAM);
        let glass: Vec<bool> = scene.shapes.iter().map(|shape| clear(&scene.materials[shape.material])).collect();
        let (mut met, mut behind) = (Vec::new(), Vec::new());
        for index in 0..wide * high {
            // A grid of a few dozen rays a side.
            let (x, y) = ((index % wide) as u32, (index / wide) as u32);
            let sampler = Sampler::new(SamplerKind::Independent, state, (x, y), 0);
            let mut ray = camera.ray(x, y, sampler.two(FILM));
            let (mut first, mut last) = (None, None);
            for depth in 0..PASSES {
                let Some((_, at)) = first_solid(world, &sampler, depth, ray) else { break };
                first = first.or(Some(at.shape));
                if !glass[at.shape as usize] {
                    last = Some(at.shape);
                    break;
                }
                ray = Ray::new(offset_origin(at.p, at.error, at.geometric, ray.direction), ray.direction);
            }
            met.push(first);
            behind.push(last);
        }
        let mut things = BTreeMap::new();
        for layer in [&met, &behind] {
            for (shape, thing) in found(layer, [width, height], beyond) {
                things.entry(shape).or_insert(thing);
            }
        }
        Ok(Self { width, height, things: things.into_values().collect() })
    }

    /// One, a quarter of the frame wide and high, a quarter from its corner, and wholly within.
    #[cfg(test)]
    pub fn card() -> Self {
        let of = SIDE / 4..SIDE / 2;
        let cells: Vec<usize> = of.clone().flat_map(|y| of.clone().map(move |x| y * SIDE + x)).collect();
        let around = ring(&cells, [SIDE; 2]);
        Self { width: SIDE, height: SIDE, things: vec![Thing { cells, around, within: 1.0 }] }
    }

    /// How much the things differ from what is around them in the display values of an exposed image, by their medians
    /// or by twice their median deviations. Each is weighed by the 3/4th power of its share of the frame, and by the
    /// 4th of how much of it lies within.
    pub fn contrast(&self, image: &Image, exposure: f64) -> f64 {
        let shown: Vec<[f64; 3]> =
            (0..self.width * self.height).map(|cell| self.shown(image, exposure, cell)).collect();
        let of = |cells: &[usize], value: &dyn Fn(usize) -> f64| {
            let mut values: Vec<f64> = cells.iter().map(|cell| value(*cell)).collect();
            median(&mut values)
        };
        let one = |thing: &Thing| {
            let differs = |channel: usize| {
                let value = |cell: usize| shown[cell][channel];
                let ground = of(&thing.around, &value);
                let off = |cell: usize| (value(cell) - ground).abs();
                // Glass shows what is around it, brighter here and darker there.
                let strewn = 2.0 * (of(&thing.cells, &off) - of(&thing.around, &off));
                (of(&thing.cells, &value) - ground).abs().max(strewn)
            };
            let share = thing.cells.len() as f64 / shown.len() as f64;
            let within = thing.within * thing.within;
            differs(0).max(differs(1)).max(differs(2)) * share.sqrt() * share.sqrt().sqrt() * within * within
        };
        self.things.iter().map(one).sum()
    }

    /// The display values of the pixels that a ray stands for.
    fn shown(&self, image: &Image, exposure: f64, cell: usize) -> [f64; 3] {
        let range = |at: usize, of: usize, pixels: usize| {
            let from = at * pixels / of;
            from..((at + 1) * pixels / of).max(from + 1)
        };
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for y in range(cell / self.width, self.height, image.height()) {
            for x in range(cell % self.width, self.width, image.width()) {
                let pixel = image.pixel(x, y);
                (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
                count += 1.0;
            }
        }
        sum.map(|value| f64::from(preview((value / count * exposure) as f32)))
    }
}

/// The things of one layer of shapes, met by rays that go `beyond` a frame on each side.
fn found(layer: &[Option<u32>], frame: [usize; 2], beyond: [usize; 2]) -> Vec<(u32, Thing)> {
    let [width, height] = frame;
    let wide = width + 2 * beyond[0];
    let mut all: BTreeMap<u32, (usize, Vec<usize>)> = BTreeMap::new();
    for (index, shape) in layer.iter().enumerate() {
        let Some(shape) = shape else { continue };
        let (total, cells) = all.entry(*shape).or_default();
        *total += 1;
        let (x, y) = ((index % wide).wrapping_sub(beyond[0]), (index / wide).wrapping_sub(beyond[1]));
        if x < width && y < height {
            cells.push(y * width + x);
        }
    }
    let mut things = Vec::new();
    for (shape, (total, cells)) in all {
        let around = ring(&cells, frame);
        let ground = cells.len() as f64 >= GROUND * (width * height) as f64;
        if cells.len() >= LEAST && around.len() >= AROUND && !ground {
            let within = cells.len() as f64 / total as f64;
            things.push((shape, Thing { cells, around, within }));
        }
    }
    things
}

/// The cells that are two steps away from some, across or along.
fn ring(cells: &[usize], [width, height]: [usize; 2]) -> Vec<usize> {
    let mut steps = vec![u8::MAX; width * height];
    cells.iter().for_each(|cell| steps[*cell] = 0);
    let mut edge = cells.to_vec();
    for step in 1..=2 {
        let mut next = Vec::new();
        for at in edge {
            let (x, below) = (at % width, at + width);
            let beside = [
                (x > 0).then(|| at - 1),
                (x + 1 < width).then_some(at + 1),
                at.checked_sub(width),
                (below < steps.len()).then_some(below),
            ];
            for cell in beside.into_iter().flatten() {
                if steps[cell] == u8::MAX {
                    steps[cell] = step;
                    next.push(cell);
                }
            }
        }
        edge = next;
    }
    edge
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::Built;
    use tauflow_data::scene::Geometry;

    const FILM: usize = 64;

    fn grey(value: f32) -> Image {
        Image::from_data(FILM, FILM, 3, vec![value; FILM * FILM * 3]).expect("fits")
    }

    fn things(built: &Built) -> Things {
        let world = World::new(&built.scene, &mut |digest| built.load(digest)).expect("a sound scene");
        Things::of(&world, &built.scene, [FILM, FILM]).expect("a camera that looks somewhere")
    }

    /// A wall that fills more than the frame, and a card of this half side before it, so far to the right.
    fn card(half: f64, x: f64) -> Built {
        let mut built = Built::new([0.0; 3], [0.0, 0.0, -1.0], 90.0, 8);
        let white = built.diffuse([0.5; 3]);
        built.shape(Geometry::Rectangle, [[9.0, 0.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0], [0.0, 0.0, 1.0, -3.0]], white);
        built.shape(Geometry::Rectangle, [[half, 0.0, 0.0, x], [0.0, half, 0.0, 0.0], [0.0, 0.0, 1.0, -2.0]], white);
        built
    }

    #[test]
    fn a_card_before_a_wall_is_a_thing_and_the_wall_is_none() {
        let found = things(&card(0.5, 0.0));
        assert_eq!(found.things.len(), 1);
        assert!((found.things[0].within - 1.0).abs() < 1e-9);
        // A quarter of the frame's side, 12 of 48 rays.
        let cells = found.things[0].cells.len();
        assert!((132..=156).contains(&cells), "{cells}");
        // It is cut in half by the frame's border, and seen in full by the rays beyond it.
        let cut = things(&card(0.5, 2.0));
        assert!((cut.things[0].within - 0.5).abs() < 0.05, "{cut:?}");
        // Surfaces that fill the frame are background.
        assert_eq!(things(&card(2.5, 0.0)).things, []);
    }

    #[test]
    fn what_looks_like_all_around_does_not_stand_out_and_more_does_by_more() {
        let found = things(&card(0.5, 0.0));
        assert_eq!(found.contrast(&grey(0.2), 1.0), 0.0);
        let lit = |value: f32| {
            let mut image = grey(0.2);
            (24..40).for_each(|y| (24..40).for_each(|x| image.pixel_mut(x, y).fill(value)));
            found.contrast(&image, 1.0)
        };
        let area = found.things[0].cells.len() as f64 / (48.0 * 48.0);
        let differ = f64::from(preview(0.4) - preview(0.2));
        assert!((lit(0.4) - 2.0 * differ * area.powf(0.75)).abs() < 1e-6, "{}", lit(0.4));
        assert!(lit(0.8) > 1.5 * lit(0.4) && (lit(0.2)).abs() < 1e-9);
        // At twice the exposure of half the light the same is shown; on a film of four times the sides, too.
        let mut fine = Image::from_data(4 * FILM, 4 * FILM, 3, vec![0.1; 48 * FILM * FILM]).expect("fits");
        (96..160).for_each(|y| (96..160).for_each(|x| fine.pixel_mut(x, y).fill(0.2)));
        assert!((found.contrast(&fine, 2.0) - lit(0.4)).abs() < 1e-6);
    }

    #[test]
    fn a_thing_behind_a_pane_is_seen_and_so_is_a_glass() {
        let mut shop = card(0.5, 0.0);
        let clear = shop.material(Bsdf::ThinDielectric {
            int_ior: 1.5,
            ext_ior: 1.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::scalar(1.0),
        });
        shop.shape(Geometry::Rectangle, [[9.0, 0.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]], clear);
        assert_eq!(things(&shop).things, things(&card(0.5, 0.0)).things);
        let mut glass = card(0.5, 0.0);
        let clear = glass.material(glass.scene.materials[0].clone());
        glass.scene.shapes[1].material = clear;
        glass.scene.materials[clear] = Bsdf::Dielectric {
            int_ior: 1.5,
            ext_ior: 1.0,
            alpha: 0.0,
            specular_reflectance: Texture::scalar(1.0),
            specular_transmittance: Texture::scalar(1.0),
        };
        assert_eq!(things(&glass).things, things(&card(0.5, 0.0)).things);
    }
}
