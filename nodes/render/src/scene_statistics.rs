#![doc = include_str!("scene_statistics.md")]

use crate::{
    accumulator::Accumulator,
    convergence::{slope, top_share},
    integrator::Strategy,
    outlines,
    picture_statistics::{self, Noise},
    render::Renderer,
    world::World,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, Context, Digest, Each, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem,
};
use tauflow_data::{
    Image, Resolution, Scene,
    image::luminance,
    maths::log,
    records::{PictureStatistics, SceneRecord, SceneStatistics},
    scene::{Bsdf, Emitter, Texture},
    statistics::quantile,
};

const SCENES: Each<SceneRecord> = Each::new("scenes", "The scenes to measure.");
const STATISTICS: Out<SceneStatistics> = Out::new(Group::main(4), "statistics", "The measurements.");

/// Shortest side of a film that statistics can be taken from.
const LEAST_SIDE: usize = 4;

/// The kind `scene_statistics`.
pub struct SceneStatisticsKind;

/// Params of `scene_statistics`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SceneStatisticsParams {
    /// Width and height in pixels, at least 4 each.
    pub resolution: Resolution,
    /// Samples per pixel: the last rung of the ladder for the slope, and the renders for the shares.
    #[schemars(range(min = 8, max = 65536))]
    pub spp: u64,
    /// Factor by which the reference has more samples.
    #[schemars(range(min = 4, max = 256))]
    pub reference: u64,
}

impl Default for SceneStatisticsParams {
    fn default() -> Self {
        let resolution = Resolution::new(64, 64).expect("sides that can be rendered");
        Self { resolution, spp: 32, reference: 16 }
    }
}

/// The stream of the reference, which no ladder of a usual pipeline has.
const HELD_OUT: u64 = 0x5EED;

impl Kind for SceneStatisticsKind {
    type Params = SceneStatisticsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "scene_statistics",
            summary: "Measures properties of scenes: path lengths, shares of light, errors and slopes.",
            manual: include_str!("scene_statistics.md"),
            mode: Mode::Map,
            inputs: vec![SCENES.port()],
            outputs: vec![STATISTICS.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let film = params.resolution;
        if film.width().min(film.height()) >= LEAST_SIDE {
            return Vec::new();
        }
        let what = format!("statistics need more than {} x {} pixels", film.width(), film.height());
        vec![ParamProblem::new("/resolution", what, "use at least 4 x 4; [64, 64] is enough")]
    }

    fn work(params: &Self::Params, _group: &str) -> f64 {
        let pixels = (params.resolution.width() * params.resolution.height()) as f64;
        pixels * params.spp as f64 * params.reference as f64
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let scene = SceneRecord::scene(ctx, action.handle(SCENES)?)?;
        let statistics = Measure { ctx, params: &action.params }.measure(&scene)?;
        Ok(Outputs::default().put(STATISTICS, statistics.store(ctx)?))
    }
}

struct Measure<'a> {
    ctx: &'a Context<'a>,
    params: &'a SceneStatisticsParams,
}

impl Measure<'_> {
    fn world(&self, scene: &Scene) -> Result<World, KindError> {
        World::new(scene, &mut |digest: &Digest| self.ctx.get(digest))
    }

    /// Renders to each of the sample counts, and hands over what there is then.
    fn render(
        &self,
        world: &World,
        stream: u64,
        strategy: Strategy,
        stops: &[u64],
        at: &mut dyn FnMut(&Accumulator),
    ) -> Result<(), KindError> {
        let renderer = Renderer::new(world, self.params.resolution, stream)?.with_integrator(strategy);
        let mut film = renderer.begin();
        for stop in stops {
            renderer.advance(&mut film, *stop, &mut |done| {
                self.ctx.progress(done, *stop, "samples per pixel");
                self.ctx.check_cancelled()
            })?;
            at(&film);
        }
        Ok(())
    }

    /// Mean luminance of a scene, or of part of its light.
    fn light(&self, world: &World, strategy: Strategy) -> Result<f64, KindError> {
        let mut mean = 0.0;
        self.render(world, 0, strategy, &[self.params.spp], &mut |film| mean = mean_luminance(film))?;
        Ok(mean)
    }

    fn measure(&self, scene: &Scene) -> Result<SceneStatistics, KindError> {
        let world = self.world(scene)?;
        let SceneStatisticsParams { spp, reference, .. } = *self.params;
        let stops: Vec<u64> = (0..).map(|i| 1u64 << i).take_while(|n| *n < spp).chain([spp]).collect();
        let mut films = Vec::new();
        self.render(&world, 0, Strategy::Mis, &stops, &mut |film| films.push(film.clone()))?;
        let last = films.last().ok_or_else(|| KindError::Internal("a ladder without rungs".into()))?;
        let mean = mean_luminance(last);
        let held_out = spp * reference;
        let (mut slope, mut truth) = (None, None);
        self.render(&world, HELD_OUT, Strategy::Mis, &[held_out], &mut |film| {
            slope = fit(&films, film);
            truth = Some(Truth::of(film));
        })?;
        let truth = truth.ok_or_else(|| KindError::Internal("a reference without samples".into()))?;
        let seen = outlines::seen(&Renderer::new(&world, self.params.resolution, 0)?);
        let [depth_discontinuities, normal_discontinuities] =
            outlines::discontinuities(self.params.resolution.width(), &seen);
        let over = |value: f64| if mean > 0.0 { value / mean } else { 0.0 };
        // The two renders have errors of their own.
        let share = |light: f64| over(light).min(1.0);
        let rest = |light: f64| if mean > 0.0 { (1.0 - light / mean).max(0.0) } else { 0.0 };

        let mut lit = scene.clone();
        lit.emitters.retain(|emitter| matches!(emitter, Emitter::Constant { .. } | Emitter::Envmap { .. }));
        lit.shapes.iter_mut().for_each(|shape| shape.emission = None);
        let alone = lit.emitters.len() == scene.emitters.len() && lit.shapes == scene.shapes;
        let environment_share = match lit.emitters.len() {
            0 => 0.0,
            _ if alone => 1.0,
            _ => share(self.light(&self.world(&lit)?, Strategy::Mis)?),
        };
        // `None` if there is nothing of the kind.
        let without = |wanted: fn(&Bsdf) -> bool| -> Result<Option<f64>, KindError> {
            let mut painted = scene.clone();
            painted.materials.iter_mut().for_each(|bsdf| paint(bsdf, wanted));
            (painted != *scene).then(|| self.light(&self.world(&painted)?, Strategy::Mis)).transpose()
        };
        let diffuse = without(|bsdf| !matches!(bsdf, Bsdf::Diffuse { .. }))?;
        let caustics = diffuse.map(|_| self.light(&world, Strategy::Caustics)).transpose()?;
        Ok(SceneStatistics {
            mean_path_length: last.mean_path_length(),
            environment_share,
            diffuse_share: diffuse.map_or(1.0, share),
            refractive_share: without(is_glass)?.map_or(0.0, rest),
            caustic_share: caustics.map_or(0.0, share),
            relative_rmse: truth.relative_rmse,
            slope,
            tail_share: truth.tail_share,
            samples_to_percent: truth.samples_to_percent,
            depth_discontinuities,
            normal_discontinuities,
            picture: truth.picture,
            spp: [spp, held_out],
            rejected: last.rejected,
            dropped: world.dropped.degenerate + world.dropped.not_finite,
        })
    }
}

/// Measurements of the reference.
struct Truth {
    relative_rmse: f64,
    tail_share: f64,
    samples_to_percent: Option<f64>,
    picture: PictureStatistics,
}

impl Truth {
    fn of(film: &Accumulator) -> Self {
        let (image, variance, of_pixels) = (film.mean(), film.variance(), variances(film));
        let mean = mean_luminance(film);
        let error = (of_pixels.iter().sum::<f64>() / of_pixels.len() as f64).sqrt();
        Self {
            relative_rmse: if mean > 0.0 { error / mean } else { 0.0 },
            samples_to_percent: samples_to(0.01, &image, &of_pixels),
            tail_share: top_share(of_pixels),
            picture: picture_statistics::measure(&image, Some(Noise { variance: &variance, spp: film.count })),
        }
    }
}

/// Samples at which the standard error is at most `relative` of the mean in half of the pixels that get light; none if
/// none does.
fn samples_to(relative: f64, image: &Image, variances: &[f64]) -> Option<f64> {
    let means = image.data().chunks_exact(3).map(|rgb| rgb.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0);
    let lit = means.zip(variances).filter(|(mean, _)| *mean > 0.0);
    let mut needed: Vec<f64> = lit.map(|(mean, variance)| variance / (relative * mean * relative * mean)).collect();
    needed.sort_by(f64::total_cmp);
    (!needed.is_empty()).then(|| quantile(&needed, 0.5))
}

fn is_glass(bsdf: &Bsdf) -> bool {
    match bsdf {
        Bsdf::Dielectric { .. } | Bsdf::ThinDielectric { .. } => true,
        Bsdf::Principled { spec_trans, .. } => *spec_trans != Texture::scalar(0.0),
        _ => false,
    }
}

/// Makes black what is wanted of a material; what lets rays pass goes on to.
fn paint(bsdf: &mut Bsdf, wanted: fn(&Bsdf) -> bool) {
    match bsdf {
        Bsdf::Finish { inner, .. } if wanted(inner) => *bsdf = Bsdf::Diffuse { reflectance: Texture::scalar(0.0) },
        Bsdf::Mask { inner, .. }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::TwoSided { inner } => paint(inner, wanted),
        Bsdf::Blend { a, b, .. } => {
            paint(a, wanted);
            paint(b, wanted);
        }
        leaf if wanted(leaf) => *leaf = Bsdf::Diffuse { reflectance: Texture::scalar(0.0) },
        _ => {}
    }
}

fn mean_luminance(film: &Accumulator) -> f64 {
    let image = film.mean();
    let sum: f64 = image.data().chunks_exact(3).map(|rgb| f64::from(luminance(rgb))).sum();
    sum / film.pixels.len() as f64
}

/// Variance of single samples of each pixel, mean over the channels.
fn variances(film: &Accumulator) -> Vec<f64> {
    let image = film.variance();
    image.data().chunks_exact(3).map(|rgb| rgb.iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0).collect()
}

/// Slope of log RMSE on log n by least squares, against a reference whose variance is subtracted; none for scenes
/// without noise.
fn fit(films: &[Accumulator], reference: &Accumulator) -> Option<f64> {
    let own = variances(reference).iter().sum::<f64>() / reference.pixels.len() as f64 / reference.count as f64;
    let truth = reference.mean();
    // The rest of noise-free scenes is rounding.
    let least = (1e-5 * mean_luminance(reference)).powi(2);
    let points: Vec<(f64, f64)> = films
        .iter()
        .filter_map(|film| {
            let image = film.mean();
            let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
            let mse = image.data().iter().zip(truth.data()).map(square).sum::<f64>() / truth.data().len() as f64 - own;
            (mse > least).then(|| (log(film.count as f64), 0.5 * log(mse)))
        })
        .collect();
    (points.len() >= 3).then(|| slope(&points))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_to_a_relative_error_are_those_of_the_middle_pixel() {
        // Means 0, 1, 2 and 4 of three channels, whose samples have variance 4.
        let image = Image::from_data(4, 1, 3, [0.0, 1.0, 2.0, 4.0].map(|v| [v; 3]).concat()).expect("fits");
        let found = samples_to(0.01, &image, &[4.0; 4]).expect("light");
        assert!((found / 1e4 - 1.0).abs() < 1e-9, "{found}");
        assert_eq!(samples_to(0.01, &image, &[0.0; 4]), Some(0.0));
        assert_eq!(samples_to(0.01, &image.map(|_| 0.0), &[4.0; 4]), None);
    }
}
