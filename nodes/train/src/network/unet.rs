//! The U-Net (Ronneberger et al. 2015): residual blocks at falling resolutions and back, told the time in every block.
//!
//! The image is first folded, [H, W, C] to [H/2, W/2, 4 C], which loses nothing and makes every layer four times
//! cheaper than at full resolution; the last layers have the numbers of four pixels side by side.

use super::head::{Head, LastLayer, Output, SMOOTHED};
use burn::tensor::{Device, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use tauflow_ops::{Convolutions, GUIDES, LOCAL_MODELS};
use tauflow_tensors::{
    Slots, Start,
    layers::{conv3, fold, linear, modulated_silu, norm_silu, silu, unfold},
};

/// Size of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// About 0.4 million weights: minutes on one core.
    #[default]
    Tiny,
    /// About 1.4 million weights: studies on a CPU.
    Small,
    /// About 12 million weights.
    Base,
    /// About 0.46 million weights, local: for images of any size, and for speed.
    Fast,
    /// About 1.5 million weights, local: for images of any size.
    Best,
    /// About 1.8 million weights: `best` with more channels at the highest resolution, where details are decided.
    Wide,
}

/// Sides of the windows of weights, from full resolution down: at blocks of 1, 2, 4 and 8 pixels.
pub(crate) const SIDES: &[usize] = &[5, 3, 3, 3];

/// The same with blocks of 16 pixels.
const LARGER_SIDES: &[usize] = &[5, 3, 3, 3, 3];

impl Preset {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Tiny, Self::Small, Self::Base, Self::Fast, Self::Best, Self::Wide];

    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiny => "tiny",
            Self::Small => "small",
            Self::Base => "base",
            Self::Fast => "fast",
            Self::Best => "best",
            Self::Wide => "wide",
        }
    }

    /// Bytes of memory that a training takes for each pixel of a batch, at most.
    pub(crate) fn bytes_per_pixel(self) -> u64 {
        match self {
            Self::Tiny | Self::Fast => 8 << 10,
            Self::Small | Self::Best | Self::Wide => 16 << 10,
            Self::Base => 64 << 10,
        }
    }

    /// Sides of the windows of weights around a pixel, from full resolution down: those at level i are of blocks of
    /// 2^i pixels.
    pub(crate) fn sides(self) -> &'static [usize] {
        self.plan().sides
    }

    /// Height and width of images must be multiples of this.
    pub(crate) fn multiple(self) -> usize {
        let plan = self.plan();
        (1 << plan.widths.len()).max(1 << (plan.sides.len() - 1))
    }

    fn plan(self) -> Plan {
        match self {
            Self::Tiny => Plan::normalised(&[32, 64, 96], 1, 1, 64),
            Self::Small => Plan::normalised(&[48, 96, 160], 1, 2, 128),
            Self::Base => Plan::normalised(&[96, 192, 384], 2, 2, 256),
            Self::Fast => Plan::local(&[32, 48, 64, 96], 1, 64),
            Self::Best => Plan::local(&[40, 80, 96, 144], 2, 64),
            Self::Wide => Plan::local(&[64, 80, 96, 144], 2, 64),
        }
    }

    /// Whether the other is local and differs from this one only in having fewer channels. More channels would change
    /// the groups in which others are normalised.
    pub(crate) fn widens(self, other: Self) -> bool {
        let (own, other) = (self.plan(), other.plan());
        !own.normalise
            && own.widths.len() == other.widths.len()
            && own.widths.iter().zip(other.widths).all(|(own, other)| own >= other)
            && Plan { widths: other.widths, ..own } == other
    }
}

#[derive(PartialEq, Eq)]
struct Plan {
    /// Channels at each resolution.
    widths: &'static [usize],
    /// Residual blocks at each resolution, on the way down and on the way up.
    blocks: usize,
    /// Convolutions in a block.
    convolutions: usize,
    /// Channels of the time embedding.
    embedding: usize,
    /// Sides of the windows of weights.
    sides: &'static [usize],
    /// Whether values are normalised over the image.
    normalise: bool,
}

impl Plan {
    fn normalised(widths: &'static [usize], blocks: usize, convolutions: usize, embedding: usize) -> Self {
        Self { widths, blocks, convolutions, embedding, sides: SIDES, normalise: true }
    }

    /// A pixel of the output depends only on pixels around it: nothing but rounding changes with the size of the image.
    fn local(widths: &'static [usize], convolutions: usize, embedding: usize) -> Self {
        Self { widths, blocks: 1, convolutions, embedding, sides: LARGER_SIDES, normalise: false }
    }
}

/// Values of a pixel by local models of the light: three colours for each.
pub(crate) const FITTED: usize = 3 * LOCAL_MODELS;

/// The input of the network.
pub(crate) struct Inputs {
    /// [N, H, W, C]; H and W are multiples of [`Unet::multiple`].
    pub(crate) features: Tensor<4>,
    /// Logarithms of the light by local models, [N, H, W, [`FITTED`]], if they take part.
    pub(crate) fits: Option<Tensor<4>>,
    /// [N, [`super::features::CLOCK`]].
    pub(crate) clock: Tensor<2>,
    /// The components of the output; none if it is the prediction.
    pub(crate) head: Option<Head>,
}

/// A network: which weights are used where.
#[derive(Clone, Debug)]
pub(crate) struct Unet {
    slots: Slots,
    time: [Layer; 2],
    stem: Layer,
    down: Vec<Level>,
    middle: Vec<Block>,
    up: Vec<Level>,
    last: Layer,
    head: Layer,
    shade: Option<Layer>,
    fits: Option<Layer>,
    blend: Option<Layer>,
    guide: Option<Layer>,
    smooth: Option<Layer>,
    normalise: bool,
    multiple: usize,
}

#[derive(Clone, Copy, Debug)]
struct Layer {
    kernel: usize,
    bias: usize,
}

/// Residual blocks, and what leads to or from the next lower resolution.
#[derive(Clone, Debug)]
struct Level {
    blocks: Vec<Block>,
    resize: Layer,
    /// On the way up: what the image of the way down is added through.
    skip: Option<Layer>,
}

/// Each convolution with the modulation of the normalisation before it.
#[derive(Clone, Debug)]
struct Block(Vec<(Layer, Layer)>);

impl Unet {
    /// The network of a preset for inputs of so many channels.
    pub(crate) fn new(preset: Preset, channels: usize, clock: usize, output: Output) -> Self {
        let plan = preset.plan();
        let mut build = Builder { slots: Slots::default(), embedding: plan.embedding };
        let time = [
            build.layer("time.0", [1, clock], [1, plan.embedding], Start::Normal(2.0)),
            build.layer("time.1", [1, plan.embedding], [1, plan.embedding], Start::Normal(2.0)),
        ];
        let stem = build.conv("stem", 4 * channels, plan.widths[0], Start::Normal(1.0));
        let (deepest, upper) = plan.widths.split_last().expect("a preset has resolutions");
        let mut down = Vec::new();
        for (i, width) in upper.iter().enumerate() {
            let blocks = build.blocks(&format!("down.{i}"), *width, &plan);
            let resize =
                build.layer(&format!("down.{i}.out"), [4, *width], [1, plan.widths[i + 1]], Start::Normal(1.0));
            down.push(Level { blocks, resize, skip: None });
        }
        let middle = build.blocks("middle", *deepest, &plan);
        let mut up = Vec::new();
        for (i, width) in upper.iter().enumerate().rev() {
            let resize = build.layer(&format!("up.{i}.in"), [1, plan.widths[i + 1]], [4, *width], Start::Normal(0.5));
            let skip = build.layer(&format!("up.{i}.skip"), [1, *width], [1, *width], Start::Normal(0.5));
            up.push(Level { blocks: build.blocks(&format!("up.{i}"), *width, &plan), resize, skip: Some(skip) });
        }
        let last = build.modulation("last", plan.widths[0]);
        // Every place weighs the same at first, or nothing is predicted.
        let head = build.conv("head", plan.widths[0], 4 * output.numbers(plan.sides), Start::Zero);
        let shade = output.is_shaded().then(|| build.conv("shade", plan.widths[0], 4 * 3, Start::Zero));
        // Local models are not seen at first, and hardly count.
        let fits = output.is_fitted().then(|| build.conv("fits", 4 * FITTED, plan.widths[0], Start::Zero));
        let blend = output.is_fitted().then(|| build.conv("blend", plan.widths[0], 4 * LOCAL_MODELS, Start::Zero));
        let strengths = 4 * GUIDES * plan.sides.len();
        let guide = output.is_guided().then(|| build.conv("guide", plan.widths[0], strengths, Start::Zero));
        let places = 4 * SMOOTHED * SMOOTHED;
        let smooth = output.is_smoothed().then(|| build.conv("smooth", plan.widths[0], places, Start::Zero));
        let multiple = preset.multiple();
        let normalise = plan.normalise;
        Self {
            slots: build.slots,
            time,
            stem,
            down,
            middle,
            up,
            last,
            head,
            shade,
            fits,
            blend,
            guide,
            smooth,
            normalise,
            multiple,
        }
    }

    /// Its weights.
    pub(crate) fn slots(&self) -> &Slots {
        &self.slots
    }

    /// Height and width must be multiples of this.
    pub(crate) fn multiple(&self) -> usize {
        self.multiple
    }

    /// Whether weights of this name are a convolution below the highest resolution: there are many, and details
    /// depend on them less.
    pub(crate) fn is_coarse(name: &str) -> bool {
        // A block has its number after the level; layers between resolutions have a name.
        let numbers =
            |name: &str| name.split('.').skip(1).map_while(|part| part.parse::<usize>().ok()).collect::<Vec<_>>();
        let convolution = name.ends_with(".kernel") && !name.ends_with(".time.kernel");
        convolution
            && match (name.split('.').next(), &numbers(name)[..]) {
                (Some("middle"), [_, _]) => true,
                (Some("down" | "up"), [level, _, _]) => *level > 0,
                _ => false,
            }
    }

    /// How far, in pixels, the output looks at most; none if it looks at the whole image.
    pub(crate) fn reach(&self) -> Option<usize> {
        if self.normalise {
            return None;
        }
        let convolutions = |blocks: &[Block]| blocks.iter().map(|Block(steps)| steps.len()).sum::<usize>();
        // A pixel of level i is 2^(i + 1) pixels wide, and what looks at one looks at all of it.
        let levels = (1..).zip(self.down.iter().zip(self.up.iter().rev()));
        let levels =
            levels.map(|(i, (down, up))| (convolutions(&down.blocks) + convolutions(&up.blocks)) * (1 << i) + (2 << i));
        // The stem, the head, and the block that they are folded to.
        let ends = 2 * 2 + 2;
        Some(ends + levels.sum::<usize>() + (convolutions(&self.middle) << (self.down.len() + 1)))
    }

    /// The prediction, [N, H, W, 3].
    pub(crate) fn forward(&self, weights: &[Tensor<2>], inputs: Inputs, convolutions: Convolutions) -> Tensor<4> {
        let run = Run { weights, normalise: self.normalise, convolutions };
        let time = silu(run.linear(self.time[0], inputs.clock));
        let time = silu(run.linear(self.time[1], time));
        let mut x = run.conv(self.stem, fold(inputs.features));
        if let Some((layer, fits)) = self.fits.zip(inputs.fits) {
            x = x + run.conv(layer, fold(fits));
        }
        let mut skips = Vec::new();
        for level in &self.down {
            x = run.blocks(&level.blocks, x, &time);
            skips.push(x.clone());
            x = run.linear(level.resize, fold(x));
        }
        x = run.blocks(&self.middle, x, &time);
        for level in &self.up {
            x = unfold(run.linear(level.resize, x));
            if let (Some(layer), Some(skip)) = (level.skip, skips.pop()) {
                x = x + run.linear(layer, skip);
            }
            x = run.blocks(&level.blocks, x, &time);
        }
        let x = run.activated(x, self.last, &time);
        let [images, rows, columns, _] = x.dims();
        let layer = |layer: Option<Layer>, rows: Range<usize>| {
            run.conv_rows(layer.expect("a layer for each part of the head"), &x, rows)
        };
        match inputs.head {
            Some(head) => head.expand([images, rows, columns], &parts(&x), |last, rows| match last {
                LastLayer::Numbers => layer(Some(self.head), rows),
                LastLayer::Strengths => layer(self.guide, rows),
                LastLayer::Blend => layer(self.blend, rows),
                LastLayer::Shades => layer(self.shade, rows),
                LastLayer::Smooths => layer(self.smooth, rows),
            }),
            None => unfold(layer(Some(self.head), 0..rows)),
        }
    }
}

/// Rows of a small image that the last layers compute at once, about.
const PART: usize = 128;

/// Minimal filtering makes tiles of so many rows: parts that begin with a whole tile have the bits of the whole image.
const TILE: usize = 4;

/// The parts of an image in which the last layers are computed: one in training, where all outputs are kept, and on
/// devices that are no CPU.
fn parts(x: &Tensor<4>) -> Vec<Range<usize>> {
    let [images, rows, ..] = x.dims();
    let some = images == 1 && !x.is_autodiff() && x.device() == Device::flex();
    parts_of(rows, if some { rows / PART } else { 1 })
}

/// So many parts, at least one, that begin with whole tiles.
fn parts_of(rows: usize, count: usize) -> Vec<Range<usize>> {
    let count = count.max(1);
    let bound = |i: usize| if i < count { i * rows / count / TILE * TILE } else { rows };
    (0..count).map(|i| bound(i)..bound(i + 1)).collect()
}

struct Builder {
    slots: Slots,
    embedding: usize,
}

impl Builder {
    /// Rows and columns are so many times as many channels.
    fn layer(&mut self, name: &str, rows: [usize; 2], columns: [usize; 2], start: Start) -> Layer {
        let ([times, inputs], [repeats, outputs]) = (rows, columns);
        let shape = [times * inputs, repeats * outputs];
        let kernel = self.slots.add_parts(format!("{name}.kernel"), [times, repeats], shape, start);
        let bias = self.slots.add_parts(format!("{name}.bias"), [1, repeats], [1, shape[1]], Start::Zero);
        Layer { kernel, bias }
    }

    fn conv(&mut self, name: &str, inputs: usize, outputs: usize, start: Start) -> Layer {
        self.layer(name, [9, inputs], [1, outputs], start)
    }

    fn modulation(&mut self, name: &str, channels: usize) -> Layer {
        self.layer(&format!("{name}.time"), [1, self.embedding], [2, channels], Start::Normal(0.1))
    }

    fn blocks(&mut self, name: &str, channels: usize, plan: &Plan) -> Vec<Block> {
        let mut block = |i: usize| {
            let step = |j: usize| {
                let name = format!("{name}.{i}.{j}");
                // The branch starts as nothing: only its last convolution is zero.
                let start = if j + 1 == plan.convolutions { Start::Zero } else { Start::Normal(2.0) };
                (self.modulation(&name, channels), self.conv(&name, channels, channels, start))
            };
            Block((0..plan.convolutions).map(step).collect())
        };
        (0..plan.blocks).map(&mut block).collect()
    }
}

struct Run<'a> {
    weights: &'a [Tensor<2>],
    normalise: bool,
    convolutions: Convolutions,
}

impl Run<'_> {
    fn linear<const D: usize>(&self, layer: Layer, x: Tensor<D>) -> Tensor<D> {
        linear(x, self.weights[layer.kernel].clone(), self.weights[layer.bias].clone())
    }

    fn conv(&self, layer: Layer, x: Tensor<4>) -> Tensor<4> {
        conv3(x, self.weights[layer.kernel].clone(), self.weights[layer.bias].clone(), self.convolutions)
    }

    /// Some rows of a convolution.
    fn conv_rows(&self, layer: Layer, x: &Tensor<4>, rows: Range<usize>) -> Tensor<4> {
        let height = x.dims()[1];
        if rows == (0..height) {
            return self.conv(layer, x.clone());
        }
        let seen = rows.start.saturating_sub(TILE)..(rows.end + TILE).min(height);
        let above = rows.start - seen.start;
        let made = self.conv(layer, x.clone().narrow(1, seen.start, seen.len()));
        made.narrow(1, above, rows.len())
    }

    fn activated(&self, x: Tensor<4>, modulation: Layer, time: &Tensor<2>) -> Tensor<4> {
        let modulation = self.linear(modulation, time.clone());
        if self.normalise { norm_silu(x, modulation) } else { modulated_silu(x, modulation) }
    }

    fn blocks(&self, blocks: &[Block], mut x: Tensor<4>, time: &Tensor<2>) -> Tensor<4> {
        for Block(steps) in blocks {
            let branch = steps
                .iter()
                .fold(x.clone(), |h, (modulation, conv)| self.conv(*conv, self.activated(h, *modulation, time)));
            x = x + branch;
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_sizes_that_they_say() {
        let count = |preset| Unet::new(preset, 15, 14, Output::Means).slots().count();
        let sizes = Preset::ALL.map(count);
        assert!((350_000..450_000).contains(&sizes[0]), "{sizes:?}");
        assert!((1_000_000..2_000_000).contains(&sizes[1]), "{sizes:?}");
        assert!((10_000_000..15_000_000).contains(&sizes[2]), "{sizes:?}");
        assert!((420_000..500_000).contains(&sizes[3]), "{sizes:?}");
        assert!((1_200_000..1_500_000).contains(&sizes[4]), "{sizes:?}");
        assert!((1_400_000..1_800_000).contains(&sizes[5]), "{sizes:?}");
    }

    #[test]
    fn convolutions_below_the_highest_resolution_are_coarse() {
        let net = Unet::new(Preset::Wide, 15, 14, Output::SmoothedMeans);
        let shapes = net.slots().shapes();
        let coarse = shapes.iter().filter(|(name, _)| Unet::is_coarse(name));
        let expected = [80, 96, 144].map(|width| (9 * width, width));
        let mut found = [0; 3];
        for (name, [rows, columns]) in coarse {
            let at = expected.iter().position(|shape| *shape == (*rows, *columns)).unwrap_or_else(|| panic!("{name}"));
            found[at] += 1;
        }
        assert_eq!(found, [4, 4, 2]);
    }

    #[test]
    fn parts_begin_with_whole_tiles_and_cover_all_rows() {
        for rows in (8..1000).step_by(8) {
            let parts = parts_of(rows, rows / PART);
            assert_eq!((parts.len(), parts[0].start, parts[parts.len() - 1].end), ((rows / 128).max(1), 0, rows));
            assert!(parts.iter().all(|part| part.start % 4 == 0 && part.len() >= rows.min(124)), "{parts:?}");
            assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
        }
    }

    #[test]
    fn weights_start_as_a_function_of_seed_and_name() {
        let net = Unet::new(Preset::Tiny, 3, 14, Output::Means);
        let weights = net.slots().draw(1);
        assert!(weights == net.slots().draw(1) && weights != net.slots().draw(2));
        let kernel = &weights.0[net.stem.kernel];
        let square = kernel.iter().map(|w| f64::from(*w).powi(2)).sum::<f64>() / kernel.len() as f64;
        assert!((square * 108.0 - 1.0).abs() < 0.1, "{square}");
        assert!(weights.0[net.head.kernel].iter().all(|w| *w == 0.0));
    }
}
