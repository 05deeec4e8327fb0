//! NCSN++ (Song et al. 2021) as the Rectified Flow image release has it (Liu et al. 2022, LSUN and CelebA-HQ). It has
//! BigGAN residual blocks, the filter 1 3 3 1 between resolutions, images added on the way down and summed on the way
//! up.

use super::{
    layers::{Run, attention, beside, fir, silu, waves},
    parameters::{Builder, LinearMap, Norm, Parameter},
};
use burn::tensor::{Tensor, TensorData};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;
use tauflow_data::maths;
use tauflow_tensors::Start;

/// Added to variances.
const EPSILON: f64 = 1e-6;
const CHANNELS: usize = 3;

/// `config.json` of an NCSN++: the fields `model` and `data` of the release's configuration, under their names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct NcsnppConfig {
    /// Side of its images.
    pub image_size: usize,
    /// Channels of the first resolution.
    pub nf: usize,
    /// Channels of each resolution, in `nf`.
    pub ch_mult: Vec<usize>,
    /// Residual blocks at each resolution.
    pub num_res_blocks: usize,
    /// Sides of the images that have attention.
    pub attn_resolutions: Vec<usize>,
    /// true: images are halved and doubled by residual blocks.
    pub resamp_with_conv: bool,
    /// true: the network is told the time.
    pub conditional: bool,
    /// true: images are filtered when halved and doubled.
    pub fir: bool,
    /// 1, 3, 3, 1.
    pub fir_kernel: Vec<u32>,
    /// true: sums are divided by the root of 2.
    pub skip_rescale: bool,
    /// `biggan`.
    pub resblock_type: String,
    /// `output_skip`.
    pub progressive: String,
    /// `input_skip`.
    pub progressive_input: String,
    /// `sum`.
    pub progressive_combine: String,
    /// `fourier`.
    pub embedding_type: String,
    /// `swish`.
    #[serde(skip_serializing)]
    pub nonlinearity: String,
    /// `GroupNorm`.
    #[serde(skip_serializing)]
    pub normalization: String,
    /// Deviation of the frequencies.
    pub fourier_scale: f64,
    /// Whether the output is divided by the time.
    pub scale_by_sigma: bool,
    /// True for images in [-1, 1], false for [0, 1].
    pub centered: bool,
}

impl Default for NcsnppConfig {
    fn default() -> Self {
        Self {
            image_size: 256,
            nf: 128,
            ch_mult: vec![1, 1, 2, 2, 2, 2, 2],
            num_res_blocks: 2,
            attn_resolutions: vec![16],
            resamp_with_conv: true,
            conditional: true,
            fir: true,
            fir_kernel: vec![1, 3, 3, 1],
            skip_rescale: true,
            resblock_type: "biggan".into(),
            progressive: "output_skip".into(),
            progressive_input: "input_skip".into(),
            progressive_combine: "sum".into(),
            embedding_type: "fourier".into(),
            nonlinearity: "swish".into(),
            normalization: "GroupNorm".into(),
            fourier_scale: 16.0,
            scale_by_sigma: true,
            centered: false,
        }
    }
}

impl NcsnppConfig {
    /// The layout of the release's LSUN models.
    pub fn lsun() -> Self {
        Self::default()
    }

    /// A small network for images of `side` pixels, to be trained: attention at 8 pixels, and no division by the time,
    /// which is up to 999 and leaves of its outputs too little to learn from in thousands of steps.
    pub fn small(side: usize, width: usize) -> Self {
        let levels = (side / 8).max(1).ilog2() as usize + 1;
        let ch_mult = (0..levels).map(|i| if i == 0 { 1 } else { 2 }).collect();
        Self {
            image_size: side,
            nf: width,
            ch_mult,
            num_res_blocks: 1,
            attn_resolutions: vec![8],
            scale_by_sigma: false,
            ..Self::default()
        }
    }

    /// Images are whole if their sides are multiples of this.
    pub fn multiple(&self) -> usize {
        1 << self.ch_mult.len().saturating_sub(1).min(16)
    }

    /// What of it is not supported: everything, a line each.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut want = |fine: bool, field: &str, found: String, wanted: &str| {
            if !fine {
                problems.push(format!("`{field}` is {found}, supported is {wanted}"));
            }
        };
        for (field, found, wanted) in [
            ("resblock_type", &self.resblock_type, "biggan"),
            ("progressive", &self.progressive, "output_skip"),
            ("progressive_input", &self.progressive_input, "input_skip"),
            ("progressive_combine", &self.progressive_combine, "sum"),
            ("embedding_type", &self.embedding_type, "fourier"),
            ("nonlinearity", &self.nonlinearity, "swish"),
            ("normalization", &self.normalization, "GroupNorm"),
        ] {
            want(found == wanted, field, format!("`{found}`"), &format!("`{wanted}`"));
        }
        for (field, found) in [
            ("resamp_with_conv", self.resamp_with_conv),
            ("conditional", self.conditional),
            ("fir", self.fir),
            ("skip_rescale", self.skip_rescale),
        ] {
            want(found, field, found.to_string(), "true");
        }
        want(self.fir_kernel == [1, 3, 3, 1], "fir_kernel", format!("{:?}", self.fir_kernel), "[1, 3, 3, 1]");
        let levels = self.ch_mult.len();
        want((1..=10).contains(&levels), "ch_mult", format!("of {levels} levels"), "of 1 to 10 levels");
        let widths = self.ch_mult.iter().all(|by| (1..=16).contains(by));
        want(widths, "ch_mult", format!("{:?}", self.ch_mult), "of numbers of 1 to 16");
        let width = self.nf.is_multiple_of(4) && (4..=1024).contains(&self.nf);
        want(width, "nf", self.nf.to_string(), "a multiple of 4 up to 1024");
        // Groups divide the channels of every block, also where two images' channels lie side by side.
        let mut counts: Vec<usize> = self.ch_mult.iter().map(|by| by.saturating_mul(self.nf)).collect();
        counts.push(self.nf);
        let pairs = counts.iter().flat_map(|a| counts.iter().map(move |b| a.saturating_add(*b)));
        let odd = counts.iter().copied().chain(pairs).find(|count| !count.is_multiple_of(groups(*count)));
        want(odd.is_none(), "nf", format!("{} with blocks of {odd:?} channels", self.nf), "one whose groups are whole");
        want((1..=16).contains(&self.num_res_blocks), "num_res_blocks", self.num_res_blocks.to_string(), "1..16");
        let whole = self.image_size > 0 && self.image_size.is_multiple_of(self.multiple());
        want(whole, "image_size", self.image_size.to_string(), &format!("a multiple of {}", self.multiple()));
        let scale = self.fourier_scale.is_finite();
        want(scale, "fourier_scale", self.fourier_scale.to_string(), "a number");
        problems
    }
}

/// Groups of a normalisation of so many channels.
fn groups(channels: usize) -> usize {
    (channels / 4).clamp(1, 32)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Resize {
    Same,
    Up,
    Down,
}

#[derive(Clone, Debug)]
struct Resnet {
    norm0: Norm,
    conv0: LinearMap,
    time: LinearMap,
    norm1: Norm,
    conv1: LinearMap,
    shortcut: Option<LinearMap>,
    resize: Resize,
}

#[derive(Clone, Debug)]
struct Attend {
    norm: Norm,
    maps: [LinearMap; 4],
}

/// A block, with attention after it where there is.
type Block = (Resnet, Option<Attend>);

#[derive(Clone, Debug)]
struct Down {
    blocks: Vec<Block>,
    /// What halves the images, and what brings the small input image into them.
    half: Option<(Resnet, LinearMap)>,
}

#[derive(Clone, Debug)]
struct Up {
    blocks: Vec<Resnet>,
    attend: Option<Attend>,
    /// What adds to the image that is summed.
    image: (Norm, LinearMap),
    twice: Option<Resnet>,
}

/// The network: which weights are used where.
#[derive(Clone, Debug)]
pub struct Ncsnpp {
    config: NcsnppConfig,
    parameters: Vec<Parameter>,
    frequencies: usize,
    time: [LinearMap; 2],
    stem: LinearMap,
    down: Vec<Down>,
    middle: (Resnet, Attend, Resnet),
    up: Vec<Up>,
}

/// Modules get their numbers in the order in which they are asked for.
struct Parts {
    build: Builder,
    next: usize,
    embedding: usize,
}

impl Parts {
    fn name(&mut self) -> String {
        self.next += 1;
        format!("all_modules.{}", self.next - 1)
    }

    fn resnet(&mut self, inputs: usize, outputs: usize, resize: Resize) -> Resnet {
        let (name, embedding) = (self.name(), self.embedding);
        let build = &mut self.build;
        let norm0 = build.norm(&format!("{name}.GroupNorm_0"), inputs, groups(inputs), EPSILON);
        let conv0 = build.conv3(&format!("{name}.Conv_0"), inputs, outputs, Start::Normal(1.0));
        let time = build.linear(&format!("{name}.Dense_0"), embedding, outputs, Start::Normal(1.0));
        let norm1 = build.norm(&format!("{name}.GroupNorm_1"), outputs, groups(outputs), EPSILON);
        let conv1 = build.conv3(&format!("{name}.Conv_1"), outputs, outputs, Start::Zero);
        let other = inputs != outputs || resize != Resize::Same;
        let shortcut = other.then(|| build.conv1(&format!("{name}.Conv_2"), inputs, outputs));
        Resnet { norm0, conv0, time, norm1, conv1, shortcut, resize }
    }

    fn attend(&mut self, channels: usize) -> Attend {
        let name = self.name();
        let norm = self.build.norm(&format!("{name}.GroupNorm_0"), channels, groups(channels), EPSILON);
        let maps = [0, 1, 2, 3].map(|i| {
            let start = if i == 3 { Start::Zero } else { Start::Normal(1.0) };
            self.build.nin(&format!("{name}.NIN_{i}"), channels, channels, start)
        });
        Attend { norm, maps }
    }
}

impl Ncsnpp {
    /// The network of a configuration without problems.
    pub fn new(config: &NcsnppConfig) -> Self {
        let (nf, levels) = (config.nf, config.ch_mult.len());
        let side = |level: usize| config.image_size >> level;
        let attends = |level: usize| config.attn_resolutions.contains(&side(level));
        let mut parts = Parts { build: Builder::default(), next: 0, embedding: 4 * nf };
        let name = parts.name();
        let frequencies = parts.build.frequencies(&name, nf, config.fourier_scale);
        let time = [2 * nf, 4 * nf].map(|inputs| {
            let name = parts.name();
            parts.build.linear(&name, inputs, 4 * nf, Start::Normal(1.0))
        });
        let name = parts.name();
        let stem = parts.build.conv3(&name, CHANNELS, nf, Start::Normal(1.0));
        let mut skips = vec![nf];
        let mut at = nf;
        let mut down = Vec::new();
        for (level, by) in config.ch_mult.iter().enumerate() {
            let mut blocks = Vec::new();
            for _ in 0..config.num_res_blocks {
                let resnet = parts.resnet(at, nf * by, Resize::Same);
                at = nf * by;
                blocks.push((resnet, attends(level).then(|| parts.attend(at))));
                skips.push(at);
            }
            let half = (level + 1 < levels).then(|| {
                let resnet = parts.resnet(at, at, Resize::Down);
                let name = format!("{}.Conv_0", parts.name());
                skips.push(at);
                (resnet, parts.build.conv1(&name, CHANNELS, at))
            });
            down.push(Down { blocks, half });
        }
        let middle = (parts.resnet(at, at, Resize::Same), parts.attend(at), parts.resnet(at, at, Resize::Same));
        let mut up = Vec::new();
        for (level, by) in config.ch_mult.iter().enumerate().rev() {
            let mut blocks = Vec::new();
            for _ in 0..=config.num_res_blocks {
                let beside = skips.pop().expect("as many as went down");
                blocks.push(parts.resnet(at + beside, nf * by, Resize::Same));
                at = nf * by;
            }
            let attend = attends(level).then(|| parts.attend(at));
            let name = parts.name();
            let norm = parts.build.norm(&name, at, groups(at), EPSILON);
            let name = parts.name();
            let image = (norm, parts.build.conv3(&name, at, CHANNELS, Start::Zero));
            let twice = (level > 0).then(|| parts.resnet(at, at, Resize::Up));
            up.push(Up { blocks, attend, image, twice });
        }
        let parameters = parts.build.0;
        Self { config: config.clone(), parameters, frequencies, time, stem, down, middle, up }
    }

    /// Its weights.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// The velocity of images [N, H, W, 3] at times of 0 to 999, all above 0.
    pub(crate) fn forward(&self, weights: &[Tensor<2>], x: Tensor<4>, times: &[f64]) -> Tensor<4> {
        let run = Run(weights);
        let frequencies = weights[self.frequencies].clone().into_data().try_into_vec::<f32>().expect("weights are f32");
        let phases = |time: &f64| {
            let log = maths::log(f64::from(*time as f32)) as f32;
            let turn = |frequency: &f32| log * frequency * 2.0 * std::f32::consts::PI;
            frequencies.iter().map(turn).collect::<Vec<f32>>()
        };
        let phases: Vec<Vec<f32>> = times.iter().map(phases).collect();
        let time = run.linear(self.time[0], waves(&phases, false, &weights[self.time[0].kernel]));
        let time = run.linear(self.time[1], silu(time));
        // Each block takes it through SiLU.
        let time = silu(time);
        let x = if self.config.centered { x } else { x.mul_scalar(2.0).sub_scalar(1.0) };
        let mut small = x.clone();
        let mut x = run.conv3(self.stem, x);
        let mut skips = vec![x.clone()];
        for level in &self.down {
            for (block, attend) in &level.blocks {
                x = resnet(&run, block, x, &time);
                if let Some(attend) = attend {
                    x = attended(&run, attend, x);
                }
                skips.push(x.clone());
            }
            if let Some((half, map)) = &level.half {
                small = fir(small, false);
                x = run.linear(*map, small.clone()) + resnet(&run, half, x, &time);
                skips.push(x.clone());
            }
        }
        x = resnet(&run, &self.middle.0, x, &time);
        x = attended(&run, &self.middle.1, x);
        x = resnet(&run, &self.middle.2, x, &time);
        let mut image: Option<Tensor<4>> = None;
        for level in &self.up {
            for block in &level.blocks {
                x = resnet(&run, block, beside(x, skips.pop().expect("as many as went down")), &time);
            }
            if let Some(attend) = &level.attend {
                x = attended(&run, attend, x);
            }
            let more = run.conv3(level.image.1, run.norm(level.image.0, x.clone(), None, true));
            image = Some(match image {
                Some(image) => fir(image, true) + more,
                None => more,
            });
            if let Some(twice) = &level.twice {
                x = resnet(&run, twice, x, &time);
            }
        }
        let image = image.expect("there is a resolution");
        if !self.config.scale_by_sigma {
            return image;
        }
        let times = times.iter().map(|time| *time as f32).collect();
        let times: Tensor<1> = Tensor::from_data(TensorData::new(times, [phases.len()]), &image.device());
        image / times.reshape([-1, 1, 1, 1])
    }
}

fn resnet(run: &Run<'_>, block: &Resnet, x: Tensor<4>, time: &Tensor<2>) -> Tensor<4> {
    let h = run.norm(block.norm0, x.clone(), None, true);
    let (h, x) = match block.resize {
        Resize::Same => (h, x),
        Resize::Up => (fir(h, true), fir(x, true)),
        Resize::Down => (fir(h, false), fir(x, false)),
    };
    let h = run.conv3(block.conv0, h);
    let shift = run.linear(block.time, time.clone());
    let h = run.conv3(block.conv1, run.norm(block.norm1, h, Some(shift), true));
    let x = match block.shortcut {
        Some(map) => run.linear(map, x),
        None => x,
    };
    (x + h).mul_scalar(FRAC_1_SQRT_2)
}

fn attended(run: &Run<'_>, block: &Attend, x: Tensor<4>) -> Tensor<4> {
    let h = run.norm(block.norm, x.clone(), None, false);
    let [query, key, value, out] = block.maps;
    let [q, k, v] = [query, key, value].map(|map| run.linear(map, h.clone()));
    (x + run.linear(out, attention(q, k, v, 1))).mul_scalar(FRAC_1_SQRT_2)
}
