#![doc = include_str!("guided_filter.md")]

use crate::{
    endpoint::{self, Endpoint},
    timed::{self, AFTER, TIMING},
};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::{
    Action, Before, Context, Each, Group, ItemKey, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out, Outlook,
    Outputs, ParamProblem, Probe,
};
use tauflow_data::{
    Image,
    maths::{exp, log},
    methods::{Conditioning, MethodName},
    records::{PackedScene, Refined, Timing},
    timing::measuring,
};

/// Added to the albedo that radiance is divided by.
const DARKEST: f32 = 0.02;

/// The kind `guided_filter`.
pub struct GuidedFilter;

/// Params of `guided_filter`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GuidedFilterParams {
    /// Name of the method in tables.
    pub method: MethodName,
    /// Guide of the filter; the G-buffer by default.
    pub conditioning: Conditioning,
    /// Sample count of the endpoint to filter.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// Radius of the window in pixels: the side is twice the radius plus 1.
    #[schemars(range(min = 0, max = 64))]
    pub radius: u64,
    /// Standard deviation of the weights over distance, in pixels.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub spatial: f64,
    /// Standard deviation for differences of albedo; none to ignore them.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub albedo: Option<f64>,
    /// Standard deviation for differences of normals; none to ignore them.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub normal: Option<f64>,
    /// Standard deviation for differences of patches of log radiance (non-local means); none for a joint bilateral
    /// filter, which uses only the G-buffer.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub colour: Option<f64>,
    /// Radius of the patches in pixels: the side is twice the radius plus 1.
    #[schemars(range(min = 0, max = 16))]
    pub patch: u64,
    /// Filter radiance divided by albedo, and multiply it back.
    pub demodulate: bool,
    /// Space of the means.
    pub average: Average,
    /// Number of measurements by `timing`.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

/// The space of weighted means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Average {
    /// Means of radiance.
    #[default]
    Linear,
    /// Means of log(1 + radiance), which single bright samples hardly change.
    Log1p,
}

impl Default for GuidedFilterParams {
    fn default() -> Self {
        Self {
            method: MethodName::new("guided_filter").expect("letters"),
            conditioning: Conditioning::Gbuffer,
            from: 1,
            radius: 10,
            spatial: 5.0,
            albedo: Some(0.1),
            normal: Some(0.2),
            colour: None,
            patch: 3,
            demodulate: true,
            average: Average::Linear,
            repeats: 5,
        }
    }
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "The scenes whose endpoints are filtered.");
const MAIN: Group = Group::main(1);
const TIMED: Group = Group::new(TIMING, 2);
const REFINED: Out<Refined> = Out::new(MAIN, "refined", "The filtered image.");
const TIMES: Out<Timing> = Out::new(TIMED, "timing", "Wall time on all cores.").measured();

impl Kind for GuidedFilter {
    type Params = GuidedFilterParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "guided_filter",
            summary: "Filters endpoints with a joint bilateral filter or non-local means, guided by G-buffers.",
            manual: include_str!("guided_filter.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port(), AFTER.port()],
            outputs: vec![REFINED.port(), TIMES.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        if params.conditioning == Conditioning::Rgb && params.demodulate {
            let hint = "set `demodulate: false`, or `conditioning: gbuffer`";
            out.push(ParamProblem::new("/demodulate", "`demodulate` needs albedo", hint));
        }
        out
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let (facts, problems) = endpoint::foresee(known, ENDPOINTS, params.from, params.conditioning);
        Outlook::default().with(REFINED, facts).but(problems)
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        timed::projected(params, group)
    }

    fn later() -> &'static [Later] {
        &[Later { pointer: "/average", before: Before::Text("linear") }]
    }

    fn environment(_params: &Self::Params, group: &str, probe: &dyn Probe) -> Option<Value> {
        Some(if group == TIMING { measuring(probe) } else { Value::Null })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let scene = action.read(ctx, ENDPOINTS)?;
        let Endpoint { color, gbuffer, said, sampler } =
            Endpoint::of(&scene, &params.method, params.from, params.conditioning)?;
        match action.group {
            TIMING => {
                let run = || filtered(color, gbuffer, params).map(|_| None);
                Ok(Outputs::default().put(TIMES, timed::timing(ctx, &said, params.repeats, run)?.store(ctx)?))
            }
            _ => {
                let refined = Refined { images: vec![(said, filtered(color, gbuffer, params)?)], note: None, sampler };
                Ok(Outputs::default().put(REFINED, refined.store(ctx)?))
            }
        }
    }
}

/// An image [H, W, 3] of linear radiance, each pixel a weighted mean of those around it.
///
/// Logarithms are signed, sign(x) log(1 + |x|), for negative values, which no ladder has.
///
/// # Errors
/// If the image has not three channels, the G-buffer [H, W, 6] is of another size, or a value of either is not finite.
pub fn filtered(color: &Image, gbuffer: Option<&Image>, params: &GuidedFilterParams) -> Result<Image, KindError> {
    let (width, height) = (color.width(), color.height());
    if color.channels() != 3 {
        return Err(KindError::Input(format!(
            "the endpoint has {} values per pixel; filter images with 3: red, green and blue",
            color.channels()
        )));
    }
    if let Some(g) = gbuffer
        && (g.width(), g.height(), g.channels()) != (width, height, 6)
    {
        return Err(KindError::Input(format!(
            "the G-buffer has {} x {} pixels with {} values, but the endpoint has {width} x {height}; render both \
            with the same `resolution`",
            g.width(),
            g.height(),
            g.channels()
        )));
    }
    finite(color, "endpoint")?;
    gbuffer.map_or(Ok(()), |gbuffer| finite(gbuffer, "G-buffer"))?;
    let albedo = |at: usize, c: usize| match gbuffer.filter(|_| params.demodulate) {
        Some(gbuffer) => gbuffer.data()[6 * at + c] + DARKEST,
        None => 1.0,
    };
    let light: Vec<f32> = color.data().iter().enumerate().map(|(i, v)| v / albedo(i / 3, i % 3)).collect();
    let logarithmic = params.average == Average::Log1p;
    let seen: Vec<f32> = if params.colour.is_some() || logarithmic {
        light.iter().map(|v| (log(1.0 + f64::from(v.abs())) as f32).copysign(*v)).collect()
    } else {
        Vec::new()
    };
    let averaged = if logarithmic { &seen } else { &light };
    let back = |mean: f64| if logarithmic { (exp(mean.abs()) - 1.0).copysign(mean) } else { mean };
    let view = View { width, height, gbuffer, seen: &seen, params };
    let mut data = vec![0.0f32; 3 * width * height];
    data.par_chunks_exact_mut(3 * width).enumerate().for_each(|(y, row)| {
        let mut sums = vec![[0.0f64; 4]; width];
        let radius = params.radius as isize;
        for dy in -radius..=radius {
            let Some(there) = y.checked_add_signed(dy).filter(|at| *at < height) else { continue };
            for dx in -radius..=radius {
                let patches = view.patches(y, dx, dy);
                for (x, sums) in sums.iter_mut().enumerate() {
                    let Some(other) = x.checked_add_signed(dx).filter(|at| *at < width) else { continue };
                    let (here, from) = (y * width + x, there * width + other);
                    let patch = patches.as_ref().map_or(0.0, |patches| patches[x]);
                    let weight = exp(-0.5 * (view.distance(here, from, dx, dy) + patch));
                    for (c, sum) in sums[..3].iter_mut().enumerate() {
                        *sum += weight * f64::from(averaged[3 * from + c]);
                    }
                    sums[3] += weight;
                }
            }
        }
        for (i, value) in row.iter_mut().enumerate() {
            let sums = &sums[i / 3];
            // The pixel itself has weight 1.
            *value = back(sums[i % 3] / sums[3]) as f32 * albedo(y * width + i / 3, i % 3);
        }
    });
    Ok(Image::from_data(width, height, 3, data)?)
}

/// A value that is no number would spread as far as the filter reaches.
fn finite(image: &Image, what: &str) -> Result<(), KindError> {
    Ok(image.finite(what, "mend the image, or look at what made it")?)
}

/// The features that determine weights.
struct View<'a> {
    width: usize,
    height: usize,
    gbuffer: Option<&'a Image>,
    /// Logarithms of what is filtered; empty where nothing reads them.
    seen: &'a [f32],
    params: &'a GuidedFilterParams,
}

impl View<'_> {
    /// Squared distance in units of the deviations, but for the patches.
    fn distance(&self, here: usize, there: usize, dx: isize, dy: isize) -> f64 {
        let square = |deviation: f64| 1.0 / (deviation * deviation);
        let mut sum = (dx * dx + dy * dy) as f64 * square(self.params.spatial);
        if let Some(gbuffer) = self.gbuffer {
            let pixel = |at: usize| &gbuffer.data()[6 * at..6 * at + 6];
            let (a, b) = (pixel(here), pixel(there));
            let part = |of: std::ops::Range<usize>| of.map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>();
            sum += self.params.albedo.map_or(0.0, |deviation| part(0..3) * square(deviation));
            sum += self.params.normal.map_or(0.0, |deviation| part(3..6) * square(deviation));
        }
        sum
    }

    /// For each pixel of row `y`, the mean squared difference of the patch around it and that around the pixel (dx, dy)
    /// away, in units of the deviation. None without patches. Pixels outside have the value of the edge.
    fn patches(&self, y: usize, dx: isize, dy: isize) -> Option<Vec<f64>> {
        let deviation = self.params.colour?;
        let reach = self.params.patch as isize;
        let edge = |at: isize, size: usize| at.clamp(0, size as isize - 1) as usize;
        // Sums over the columns of patches first, from `reach` left of the row to as far right of it.
        let column = |x: isize| -> f64 {
            let square = |v: isize| -> f64 {
                let at = |x: isize, y: isize| 3 * (edge(y, self.height) * self.width + edge(x, self.width));
                let (a, b) = (at(x, v), at(x + dx, v + dy));
                (0..3).map(|c| f64::from(self.seen[a + c] - self.seen[b + c]).powi(2)).sum()
            };
            (-reach..=reach).map(|v| square(y as isize + v)).sum()
        };
        let columns: Vec<f64> = (-reach..self.width as isize + reach).map(column).collect();
        let side = (2 * reach + 1) as usize;
        let scale = 1.0 / ((3 * side * side) as f64 * deviation * deviation);
        Some((0..self.width).map(|x| columns[x..x + side].iter().sum::<f64>() * scale).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_contract::{KindRow, NodeKind as _};
    use tauflow_data::rng::Stream;

    fn params() -> GuidedFilterParams {
        GuidedFilterParams { radius: 3, spatial: 2.0, ..GuidedFilterParams::default() }
    }

    /// Two halves of other albedo and light under noise, and their G-buffer.
    fn halves() -> (Image, Image, Image) {
        let (mut clean, mut noisy, mut gbuffer) = (Image::new(16, 8, 3), Image::new(16, 8, 3), Image::new(16, 8, 6));
        for y in 0..8 {
            for x in 0..16 {
                let mut stream = Stream::new(4, &[x as u64, y as u64]);
                let (albedo, light) = if x < 8 { (0.2, 1.0) } else { (0.8, 3.0) };
                clean.pixel_mut(x, y).fill((albedo + DARKEST) * light);
                let noise = stream.range(0.0, 2.0) as f32;
                noisy.pixel_mut(x, y).fill((albedo + DARKEST) * light * noise);
                gbuffer.pixel_mut(x, y).copy_from_slice(&[albedo, albedo, albedo, 0.0, 0.0, 1.0]);
            }
        }
        (clean, noisy, gbuffer)
    }

    fn error(a: &Image, b: &Image) -> f64 {
        a.data().iter().zip(b.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.data().len() as f64
    }

    #[test]
    fn weights_are_those_of_the_definition() {
        let (_, noisy, gbuffer) = halves();
        for (colour, average) in [(None, Average::Linear), (Some(0.4), Average::Linear), (None, Average::Log1p)] {
            let params = GuidedFilterParams { colour, average, patch: 1, radius: 2, ..params() };
            let found = filtered(&noisy, Some(&gbuffer), &params).expect("fits");
            let light =
                |x: usize, y: usize, c: usize| f64::from(noisy.pixel(x, y)[c] / (gbuffer.pixel(x, y)[c] + DARKEST));
            let seen = |x: i64, y: i64, c: usize| {
                let (x, y) = (x.clamp(0, 15) as usize, y.clamp(0, 7) as usize);
                log(1.0 + light(x, y, c))
            };
            for (x, y) in [(0i64, 0i64), (7, 3), (8, 4), (15, 7), (4, 7)] {
                let (mut sum, mut weights) = (0.0, 0.0);
                for v in (y - 2).max(0)..=(y + 2).min(7) {
                    for u in (x - 2).max(0)..=(x + 2).min(15) {
                        let mut d = ((u - x).pow(2) + (v - y).pow(2)) as f64 / params.spatial.powi(2);
                        let (a, b) = (gbuffer.pixel(x as usize, y as usize), gbuffer.pixel(u as usize, v as usize));
                        d += 3.0 * f64::from(a[0] - b[0]).powi(2) / params.albedo.expect("a default").powi(2);
                        if let Some(colour) = colour {
                            let mut patch = 0.0;
                            for (i, j) in (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j))) {
                                let at = |c| seen(x + i, y + j, c) - seen(u + i, v + j, c);
                                patch += (0..3).map(|c| at(c).powi(2)).sum::<f64>() / 27.0;
                            }
                            d += patch / colour.powi(2);
                        }
                        let value = light(u as usize, v as usize, 1);
                        let value = if average == Average::Log1p { value.ln_1p() } else { value };
                        sum += (-0.5 * d).exp() * value;
                        weights += (-0.5 * d).exp();
                    }
                }
                let albedo = f64::from(gbuffer.pixel(x as usize, y as usize)[1] + DARKEST);
                let mean = sum / weights;
                let expected = if average == Average::Log1p { mean.exp_m1() } else { mean } * albedo;
                let found = f64::from(found.pixel(x as usize, y as usize)[1]);
                assert!(
                    (found - expected).abs() < 1e-4 * expected,
                    "{colour:?} {average:?} {x} {y}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn noise_falls_and_edges_stay() {
        let (clean, noisy, gbuffer) = halves();
        let with = filtered(&noisy, Some(&gbuffer), &params()).expect("fits");
        assert!(
            error(&with, &clean) < 0.15 * error(&noisy, &clean),
            "{} {}",
            error(&with, &clean),
            error(&noisy, &clean)
        );
        let blind = GuidedFilterParams { conditioning: Conditioning::Rgb, demodulate: false, ..params() };
        let without = filtered(&noisy, None, &blind).expect("fits");
        assert!(error(&with, &clean) < 0.5 * error(&without, &clean));
        let flat = filtered(&clean, Some(&gbuffer), &params()).expect("fits");
        assert!(error(&flat, &clean) < 1e-10);
    }

    #[test]
    fn means_of_logarithms_hardly_see_a_single_bright_sample() {
        let (clean, mut noisy, gbuffer) = halves();
        noisy.pixel_mut(4, 4).fill(1e4);
        let of = |average| {
            let params = GuidedFilterParams { average, ..params() };
            filtered(&noisy, Some(&gbuffer), &params).expect("fits").pixel(5, 4)[0]
        };
        let truth = clean.pixel(5, 4)[0];
        assert!(of(Average::Log1p) < 5.0 * truth && of(Average::Linear) > 500.0 * truth);
    }

    #[test]
    fn without_deviations_of_features_the_filter_is_a_gaussian_of_demodulated_light() {
        let (_, noisy, gbuffer) = halves();
        let gaussian = GuidedFilterParams { albedo: None, normal: None, ..params() };
        let found = filtered(&noisy, Some(&gbuffer), &gaussian).expect("fits");
        // The same filter of what is left of the light without albedo, where nothing is known of the surfaces.
        let mut light = noisy.clone();
        light.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v /= gbuffer.data()[6 * (i / 3) + i % 3] + DARKEST);
        let blind = GuidedFilterParams { conditioning: Conditioning::Rgb, demodulate: false, ..gaussian };
        let light = filtered(&light, None, &blind).expect("fits");
        for (i, (found, light)) in found.data().iter().zip(light.data()).enumerate() {
            let expected = light * (gbuffer.data()[6 * (i / 3) + i % 3] + DARKEST);
            assert!((found - expected).abs() <= 1e-6 * expected, "{i}: {found} {expected}");
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let (_, noisy, _) = halves();
        let error = filtered(&noisy, Some(&Image::new(4, 4, 6)), &params()).expect_err("another size").to_string();
        assert!(error.contains("4 x 4") && error.contains("16 x 8"), "{error}");
        let error = filtered(&Image::new(4, 4, 1), None, &params()).expect_err("one channel").to_string();
        assert!(error.contains("has 1 values per pixel"), "{error}");
        let bad = GuidedFilterParams { conditioning: Conditioning::Rgb, ..params() };
        let pointers: Vec<String> = GuidedFilter::check(&bad).into_iter().map(|p| p.pointer).collect();
        assert_eq!(pointers, ["/demodulate"]);
        // What the schema says is refused before params are read.
        let schema = KindRow::<GuidedFilter>::new().params_schema();
        for deviation in ["spatial", "albedo", "normal", "colour"] {
            assert_eq!(schema["properties"][deviation]["exclusiveMinimum"], 0.0, "{deviation}");
        }
    }
}
