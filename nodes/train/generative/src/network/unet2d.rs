//! diffusers' `UNet2DModel` (Ho et al. 2020 in the layout of `google/ddpm-church-256`): residual blocks with attention,
//! strided convolutions down, nearest neighbours and a convolution up, and the time by sines.

use super::{
    layers::{Run, attention, beside, nearest, silu, waves},
    parameters::{Builder, LinearMap, Norm, Parameter},
};
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_data::maths;
use tauflow_tensors::Start;

/// `config.json` of a `UNet2DModel`; what is left out is as in diffusers. Fields that are not here
/// are ignored; one that changes the network shows as missing, extra or misshapen weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Unet2dConfig {
    /// `UNet2DModel`.
    #[serde(rename = "_class_name")]
    pub class_name: String,
    /// Side of its images; a number or two.
    pub sample_size: Value,
    /// Channels of images.
    pub in_channels: usize,
    /// Channels of the prediction.
    pub out_channels: usize,
    /// Whether images are brought from [0, 1] to [-1, 1] first.
    pub center_input_sample: bool,
    /// `positional`.
    pub time_embedding_type: String,
    /// Taken from the number of frequencies.
    pub freq_shift: f64,
    /// Whether cosines come first.
    pub flip_sin_to_cos: bool,
    /// Blocks on the way down.
    pub down_block_types: Vec<String>,
    /// Blocks on the way up.
    pub up_block_types: Vec<String>,
    /// Channels at each resolution.
    pub block_out_channels: Vec<usize>,
    /// Residual blocks at each resolution.
    pub layers_per_block: usize,
    /// What the middle block's sums are divided by.
    pub mid_block_scale_factor: f64,
    /// 0: a column and a row of zeros to the right and below.
    pub downsample_padding: usize,
    /// `conv`.
    pub downsample_type: String,
    /// `conv`.
    pub upsample_type: String,
    /// `silu`.
    pub act_fn: String,
    /// Channels of an attention head; null for one head.
    pub attention_head_dim: Option<usize>,
    /// Groups of normalisations.
    pub norm_num_groups: usize,
    /// Groups of the middle attention's; null for the same.
    pub attn_norm_num_groups: Option<usize>,
    /// Added to variances.
    pub norm_eps: f64,
    /// `default`.
    pub resnet_time_scale_shift: String,
    /// Whether the middle block has attention.
    pub add_attention: bool,
    /// null.
    pub class_embed_type: Option<String>,
    /// null.
    pub num_class_embeds: Option<usize>,
}

impl Default for Unet2dConfig {
    fn default() -> Self {
        let texts = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect();
        Self {
            class_name: "UNet2DModel".into(),
            sample_size: Value::Null,
            in_channels: 3,
            out_channels: 3,
            center_input_sample: false,
            time_embedding_type: "positional".into(),
            freq_shift: 0.0,
            flip_sin_to_cos: true,
            down_block_types: texts(&["DownBlock2D", "AttnDownBlock2D", "AttnDownBlock2D", "AttnDownBlock2D"]),
            up_block_types: texts(&["AttnUpBlock2D", "AttnUpBlock2D", "AttnUpBlock2D", "UpBlock2D"]),
            block_out_channels: vec![224, 448, 672, 896],
            layers_per_block: 2,
            mid_block_scale_factor: 1.0,
            downsample_padding: 1,
            downsample_type: "conv".into(),
            upsample_type: "conv".into(),
            act_fn: "silu".into(),
            attention_head_dim: Some(8),
            norm_num_groups: 32,
            attn_norm_num_groups: None,
            norm_eps: 1e-5,
            resnet_time_scale_shift: "default".into(),
            add_attention: true,
            class_embed_type: None,
            num_class_embeds: None,
        }
    }
}

impl Unet2dConfig {
    /// The layout of `google/ddpm-church-256`.
    pub fn church() -> Self {
        let block = |attends: bool, name: &str| if attends { format!("Attn{name}") } else { name.to_owned() };
        Self {
            sample_size: 256.into(),
            flip_sin_to_cos: false,
            freq_shift: 1.0,
            down_block_types: (0..6).map(|i| block(i == 4, "DownBlock2D")).collect(),
            up_block_types: (0..6).map(|i| block(i == 1, "UpBlock2D")).collect(),
            block_out_channels: vec![128, 128, 256, 256, 512, 512],
            downsample_padding: 0,
            attention_head_dim: None,
            norm_eps: 1e-6,
            ..Self::default()
        }
    }

    /// A small network for images of `side` pixels: attention at 8 pixels.
    pub fn small(side: usize, width: usize) -> Self {
        let levels = (side / 8).max(1).ilog2() as usize + 1;
        let block = |attends: bool, name: &str| if attends { format!("Attn{name}") } else { name.to_owned() };
        Self {
            sample_size: side.into(),
            down_block_types: (0..levels).map(|i| block(i + 1 == levels, "DownBlock2D")).collect(),
            up_block_types: (0..levels).map(|i| block(i == 0, "UpBlock2D")).collect(),
            block_out_channels: (0..levels).map(|i| if i == 0 { width } else { 2 * width }).collect(),
            layers_per_block: 1,
            norm_num_groups: 8,
            ..Self::church()
        }
    }

    /// Side of its images, if it says.
    pub fn side(&self) -> Option<usize> {
        let number = |value: &Value| value.as_u64().map(|side| side as usize);
        number(&self.sample_size).or_else(|| number(self.sample_size.get(0)?))
    }

    /// Images are whole if their sides are multiples of this.
    pub fn multiple(&self) -> usize {
        1 << self.block_out_channels.len().saturating_sub(1).min(16)
    }

    /// What of it is not supported: everything, a line each.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut want = |fine: bool, field: &str, found: String, wanted: &str| {
            if !fine {
                problems.push(format!("`{field}` is {found}, supported is {wanted}"));
            }
        };
        let text = |value: &str| format!("`{value}`");
        want(self.class_name == "UNet2DModel", "_class_name", text(&self.class_name), "`UNet2DModel`");
        want(self.in_channels == 3, "in_channels", self.in_channels.to_string(), "3");
        want(self.out_channels == 3, "out_channels", self.out_channels.to_string(), "3");
        let positional = self.time_embedding_type == "positional";
        want(positional, "time_embedding_type", text(&self.time_embedding_type), "`positional`");
        want(self.act_fn == "silu" || self.act_fn == "swish", "act_fn", text(&self.act_fn), "`silu`");
        want(self.downsample_padding == 0, "downsample_padding", self.downsample_padding.to_string(), "0");
        want(self.downsample_type == "conv", "downsample_type", text(&self.downsample_type), "`conv`");
        want(self.upsample_type == "conv", "upsample_type", text(&self.upsample_type), "`conv`");
        let shift = self.resnet_time_scale_shift == "default";
        want(shift, "resnet_time_scale_shift", text(&self.resnet_time_scale_shift), "`default`");
        want(self.class_embed_type.is_none(), "class_embed_type", format!("{:?}", self.class_embed_type), "null");
        want(self.num_class_embeds.is_none(), "num_class_embeds", format!("{:?}", self.num_class_embeds), "null");
        let levels = self.block_out_channels.len();
        want((1..=10).contains(&levels), "block_out_channels", format!("of {levels} levels"), "of 1 to 10 levels");
        want((1..=16).contains(&self.layers_per_block), "layers_per_block", self.layers_per_block.to_string(), "1..16");
        let groups = self.norm_num_groups;
        let fits = |channels: &usize| groups > 0 && (1..=4096).contains(channels) && channels.is_multiple_of(groups);
        let channels = &self.block_out_channels;
        let wanted = format!("of up to 4096 channels, multiples of `norm_num_groups` {groups}");
        want(channels.iter().all(fits), "block_out_channels", format!("{channels:?}"), &wanted);
        want(
            channels.iter().all(|c| c.is_multiple_of(2)),
            "block_out_channels",
            format!("{channels:?}"),
            "even numbers",
        );
        let head = self.attention_head_dim.unwrap_or(1);
        let heads = head > 0 && channels.iter().all(|c| c.is_multiple_of(head));
        want(heads, "attention_head_dim", head.to_string(), "a divisor of all channels, or null");
        let attn = self.attn_norm_num_groups.is_none_or(|found| found == groups);
        want(attn, "attn_norm_num_groups", format!("{:?}", self.attn_norm_num_groups), "null");
        let scale = self.mid_block_scale_factor.is_finite() && self.mid_block_scale_factor > 0.0;
        want(scale, "mid_block_scale_factor", self.mid_block_scale_factor.to_string(), "a positive number");
        let eps = self.norm_eps.is_finite() && self.norm_eps > 0.0;
        want(eps, "norm_eps", self.norm_eps.to_string(), "a positive number");
        for (field, types, plain) in [
            ("down_block_types", &self.down_block_types, "DownBlock2D"),
            ("up_block_types", &self.up_block_types, "UpBlock2D"),
        ] {
            let fits = |name: &String| name == plain || *name == format!("Attn{plain}");
            let wanted = format!("{levels} of `{plain}` and `Attn{plain}`");
            want(types.len() == levels && types.iter().all(fits), field, format!("{types:?}"), &wanted);
        }
        problems
    }
}

#[derive(Clone, Debug)]
struct Resnet {
    norm1: Norm,
    conv1: LinearMap,
    time: LinearMap,
    norm2: Norm,
    conv2: LinearMap,
    shortcut: Option<LinearMap>,
    scale: f64,
}

#[derive(Clone, Debug)]
struct Attend {
    norm: Norm,
    query: LinearMap,
    key: LinearMap,
    value: LinearMap,
    out: LinearMap,
    heads: usize,
    scale: f64,
}

#[derive(Clone, Debug)]
struct Level {
    blocks: Vec<(Resnet, Option<Attend>)>,
    resize: Option<LinearMap>,
}

/// The network: which weights are used where.
#[derive(Clone, Debug)]
pub struct Unet2d {
    config: Unet2dConfig,
    parameters: Vec<Parameter>,
    stem: LinearMap,
    time: [LinearMap; 2],
    down: Vec<Level>,
    middle: (Resnet, Option<Attend>, Resnet),
    up: Vec<Level>,
    last: Norm,
    out: LinearMap,
}

struct Parts<'a> {
    build: Builder,
    config: &'a Unet2dConfig,
}

impl Parts<'_> {
    fn resnet(&mut self, name: &str, inputs: usize, outputs: usize, scale: f64) -> Resnet {
        let (groups, epsilon) = (self.config.norm_num_groups, self.config.norm_eps);
        let embedding = 4 * self.config.block_out_channels[0];
        let build = &mut self.build;
        let norm1 = build.norm(&format!("{name}.norm1"), inputs, groups, epsilon);
        let conv1 = build.conv3(&format!("{name}.conv1"), inputs, outputs, Start::Normal(1.0));
        let time = build.linear(&format!("{name}.time_emb_proj"), embedding, outputs, Start::Normal(1.0));
        let norm2 = build.norm(&format!("{name}.norm2"), outputs, groups, epsilon);
        let conv2 = build.conv3(&format!("{name}.conv2"), outputs, outputs, Start::Zero);
        let shortcut = (inputs != outputs).then(|| build.conv1(&format!("{name}.conv_shortcut"), inputs, outputs));
        Resnet { norm1, conv1, time, norm2, conv2, shortcut, scale }
    }

    fn attend(&mut self, name: &str, channels: usize, scale: f64) -> Attend {
        let (groups, epsilon) = (self.config.norm_num_groups, self.config.norm_eps);
        let heads = self.config.attention_head_dim.map_or(1, |size| channels / size);
        let build = &mut self.build;
        let norm = build.norm(&format!("{name}.group_norm"), channels, groups, epsilon);
        let mut map = |part: &str, start| build.linear(&format!("{name}.{part}"), channels, channels, start);
        let [query, key, value] = ["to_q", "to_k", "to_v"].map(|part| map(part, Start::Normal(1.0)));
        Attend { norm, query, key, value, out: map("to_out.0", Start::Zero), heads, scale }
    }
}

impl Unet2d {
    /// The network of a configuration without problems.
    pub fn new(config: &Unet2dConfig) -> Self {
        let channels = &config.block_out_channels;
        let (first, levels) = (channels[0], channels.len());
        let mut parts = Parts { build: Builder::default(), config };
        let stem = parts.build.conv3("conv_in", config.in_channels, first, Start::Normal(1.0));
        let time = [
            parts.build.linear("time_embedding.linear_1", first, 4 * first, Start::Normal(1.0)),
            parts.build.linear("time_embedding.linear_2", 4 * first, 4 * first, Start::Normal(1.0)),
        ];
        // Channels of what the way up is given beside, last first out.
        let mut skips = vec![first];
        let mut at = first;
        let mut down = Vec::new();
        for (level, (width, sort)) in channels.iter().zip(&config.down_block_types).enumerate() {
            let name = format!("down_blocks.{level}");
            let mut blocks = Vec::new();
            for i in 0..config.layers_per_block {
                let resnet = parts.resnet(&format!("{name}.resnets.{i}"), at, *width, 1.0);
                at = *width;
                let attends = sort.starts_with("Attn");
                let attend = attends.then(|| parts.attend(&format!("{name}.attentions.{i}"), at, 1.0));
                blocks.push((resnet, attend));
                skips.push(at);
            }
            let resize = (level + 1 < levels).then(|| {
                skips.push(at);
                parts.build.conv3(&format!("{name}.downsamplers.0.conv"), at, at, Start::Normal(1.0))
            });
            down.push(Level { blocks, resize });
        }
        let scale = config.mid_block_scale_factor;
        let middle = (
            parts.resnet("mid_block.resnets.0", at, at, scale),
            config.add_attention.then(|| parts.attend("mid_block.attentions.0", at, scale)),
            parts.resnet("mid_block.resnets.1", at, at, scale),
        );
        let mut up = Vec::new();
        for (level, (width, sort)) in channels.iter().rev().zip(&config.up_block_types).enumerate() {
            let name = format!("up_blocks.{level}");
            let mut blocks = Vec::new();
            for i in 0..=config.layers_per_block {
                let beside = skips.pop().expect("as many as went down");
                let resnet = parts.resnet(&format!("{name}.resnets.{i}"), at + beside, *width, 1.0);
                at = *width;
                let attends = sort.starts_with("Attn");
                let attend = attends.then(|| parts.attend(&format!("{name}.attentions.{i}"), at, 1.0));
                blocks.push((resnet, attend));
            }
            let resize = (level + 1 < levels)
                .then(|| parts.build.conv3(&format!("{name}.upsamplers.0.conv"), at, at, Start::Normal(1.0)));
            up.push(Level { blocks, resize });
        }
        let last = parts.build.norm("conv_norm_out", first, config.norm_num_groups, config.norm_eps);
        let out = parts.build.conv3("conv_out", first, config.out_channels, Start::Zero);
        let parameters = parts.build.0;
        Self { config: config.clone(), parameters, stem, time, down, middle, up, last, out }
    }

    /// Its weights.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// The noise in images [N, H, W, 3] at times of 0 to 999.
    pub(crate) fn forward(&self, weights: &[Tensor<2>], x: Tensor<4>, times: &[f64]) -> Tensor<4> {
        let run = Run(weights);
        let phases: Vec<Vec<f32>> = times.iter().map(|time| self.phases(*time as f32)).collect();
        let time = waves(&phases, self.config.flip_sin_to_cos, &weights[self.time[0].kernel]);
        let time = silu(run.linear(self.time[0], time));
        // Each block takes it through SiLU.
        let time = silu(run.linear(self.time[1], time));
        let x = if self.config.center_input_sample { x.mul_scalar(2.0).sub_scalar(1.0) } else { x };
        let mut x = run.conv3(self.stem, x);
        let mut skips = vec![x.clone()];
        for level in &self.down {
            for block in &level.blocks {
                x = self.block(&run, block, x, &time);
                skips.push(x.clone());
            }
            if let Some(resize) = level.resize {
                x = run.strided(resize, x);
                skips.push(x.clone());
            }
        }
        x = resnet(&run, &self.middle.0, x, &time);
        if let Some(attend) = &self.middle.1 {
            x = attended(&run, attend, x);
        }
        x = resnet(&run, &self.middle.2, x, &time);
        for level in &self.up {
            for block in &level.blocks {
                x = beside(x, skips.pop().expect("as many as went down"));
                x = self.block(&run, block, x, &time);
            }
            if let Some(resize) = level.resize {
                x = run.conv3(resize, nearest(x));
            }
        }
        run.conv3(self.out, run.norm(self.last, x, None, true))
    }

    fn block(&self, run: &Run<'_>, block: &(Resnet, Option<Attend>), x: Tensor<4>, time: &Tensor<2>) -> Tensor<4> {
        let x = resnet(run, &block.0, x, time);
        match &block.1 {
            Some(attend) => attended(run, attend, x),
            None => x,
        }
    }

    /// time/10000^(i/(half - shift)), rounded as in diffusers.
    fn phases(&self, time: f32) -> Vec<f32> {
        let half = self.config.block_out_channels[0] / 2;
        let log = -maths::log(10_000.0) as f32;
        let last = (half as f64 - self.config.freq_shift) as f32;
        (0..half).map(|i| maths::exp(f64::from(log * i as f32 / last)) as f32 * time).collect()
    }
}

fn resnet(run: &Run<'_>, block: &Resnet, x: Tensor<4>, time: &Tensor<2>) -> Tensor<4> {
    let h = run.conv3(block.conv1, run.norm(block.norm1, x.clone(), None, true));
    let shift = run.linear(block.time, time.clone());
    let h = run.conv3(block.conv2, run.norm(block.norm2, h, Some(shift), true));
    let x = match block.shortcut {
        Some(map) => run.linear(map, x),
        None => x,
    };
    scaled(x + h, block.scale)
}

fn attended(run: &Run<'_>, block: &Attend, x: Tensor<4>) -> Tensor<4> {
    let h = run.norm(block.norm, x.clone(), None, false);
    let [q, k, v] = [block.query, block.key, block.value].map(|map| run.linear(map, h.clone()));
    scaled(run.linear(block.out, attention(q, k, v, block.heads)) + x, block.scale)
}

fn scaled(x: Tensor<4>, by: f64) -> Tensor<4> {
    if by == 1.0 { x } else { x.div_scalar(by) }
}
