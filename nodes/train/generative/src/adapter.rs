//! The transport adapter: a small network that sees a frozen backbone's correction coordinate and the time, and says
//! how far rendering would move it. Its last layer starts at zero, so that an untrained adapter changes nothing.
//!
//! Source: the paper's section on the transport adapter. Where the paper is silent the choices are ours: three residual
//! blocks of 48 channels at half the resolution, and a time embedding of low frequencies, so that times between the
//! rungs' are told smoothly.

use burn::tensor::{Device, Tensor, TensorData};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Image, TensorFile, maths, records::Family};
use tauflow_ops::Convolutions;
use tauflow_tensors::{
    Slots, Start, Weights,
    layers::{conv3, fold, linear, norm_silu, silu, unfold},
};

const WIDTH: usize = 48;
const BLOCKS: usize = 3;
const EMBEDDING: usize = 64;
/// Waves of the time embedding, beside the time itself.
const WAVES: usize = 4;

/// What an adapter's targets are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Residuals {
    /// Those of rendering: u_MC - u_base of the same scene and rung.
    #[default]
    Rendered,
    /// A control: those of another scene at the same rung.
    Shuffled,
    /// A control: Gaussian numbers of the same variance at each rung.
    Gaussian,
}

impl Residuals {
    /// Its name in pipelines.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rendered => "rendered",
            Self::Shuffled => "shuffled",
            Self::Gaussian => "gaussian",
        }
    }
}

/// What an adapter was trained for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdapterInfo {
    /// Digest of the backbone whose predictions it saw.
    pub backbone: Digest,
    /// The backbone's family.
    pub family: Family,
    /// What its targets were.
    pub residuals: Residuals,
    /// Whether the clean images that it saw were held to their range.
    pub clamp_clean: bool,
    /// Sample counts of its ladder.
    pub counts: Vec<u64>,
    /// Training steps.
    pub steps: u64,
}

#[derive(Clone, Copy, Debug)]
struct Layer {
    kernel: usize,
    bias: usize,
}

/// Twice: the modulation of a normalisation, and the convolution after it.
type Block = [(Layer, Layer); 2];

/// The adapter's network: which weights are used where.
#[derive(Clone, Debug)]
pub(crate) struct AdapterNetwork {
    slots: Slots,
    time: [Layer; 2],
    stem: Layer,
    blocks: Vec<Block>,
    last: Layer,
}

fn add(slots: &mut Slots, name: &str, rows: usize, columns: usize, start: Start) -> Layer {
    let kernel = slots.add(format!("{name}.kernel"), [rows, columns], start);
    Layer { kernel, bias: slots.add(format!("{name}.bias"), [1, columns], Start::Zero) }
}

impl AdapterNetwork {
    pub(crate) fn new() -> Self {
        let mut slots = Slots::default();
        let time = [
            add(&mut slots, "time.0", 1 + 2 * WAVES, EMBEDDING, Start::Normal(2.0)),
            add(&mut slots, "time.1", EMBEDDING, EMBEDDING, Start::Normal(2.0)),
        ];
        let stem = add(&mut slots, "stem", 9 * 12, WIDTH, Start::Normal(1.0));
        let block = |i: usize| {
            [0, 1].map(|j| {
                let name = format!("blocks.{i}.{j}");
                let time = add(&mut slots, &format!("{name}.time"), EMBEDDING, 2 * WIDTH, Start::Normal(0.1));
                let start = if j == 1 { Start::Zero } else { Start::Normal(2.0) };
                (time, add(&mut slots, &name, 9 * WIDTH, WIDTH, start))
            })
        };
        let blocks = (0..BLOCKS).map(block).collect();
        let last = add(&mut slots, "last", 9 * WIDTH, 12, Start::Zero);
        Self { slots, time, stem, blocks, last }
    }

    pub(crate) fn slots(&self) -> &Slots {
        &self.slots
    }

    /// The correction of `base` [N, H, W, 3] at times from 0 to 1; sides are even.
    pub(crate) fn forward(&self, weights: &[Tensor<2>], base: Tensor<4>, times: &[f64]) -> Tensor<4> {
        let map = |layer: Layer, x: Tensor<2>| linear(x, weights[layer.kernel].clone(), weights[layer.bias].clone());
        let conv = |layer: Layer, x: Tensor<4>| {
            conv3(x, weights[layer.kernel].clone(), weights[layer.bias].clone(), Convolutions::Minimal)
        };
        let waves = |time: &f64| {
            let wave = |k: usize| [maths::sin(k as f64 * PI * time), maths::cos(k as f64 * PI * time)];
            std::iter::once(*time).chain((1..=WAVES).flat_map(wave)).map(|v| v as f32).collect::<Vec<_>>()
        };
        let shape = [times.len(), 1 + 2 * WAVES];
        let time = TensorData::new(times.iter().flat_map(waves).collect::<Vec<_>>(), shape);
        let time = silu(map(self.time[0], Tensor::from_data(time, &weights[0].device())));
        let time = silu(map(self.time[1], time));
        let mut x = conv(self.stem, fold(base));
        for block in &self.blocks {
            let branch = block
                .iter()
                .fold(x.clone(), |h, (modulation, layer)| conv(*layer, norm_silu(h, map(*modulation, time.clone()))));
            x = x + branch;
        }
        unfold(conv(self.last, silu(x)))
    }
}

/// An adapter, ready to correct.
pub struct Adapter {
    info: AdapterInfo,
    network: AdapterNetwork,
    weights: Weights,
    tensors: Vec<Tensor<2>>,
}

impl Adapter {
    pub(crate) fn new(info: AdapterInfo, weights: Weights) -> Self {
        let network = AdapterNetwork::new();
        let tensors = network.slots().tensors(&weights, &Device::flex());
        Self { info, network, weights, tensors }
    }

    /// One that was never trained, and changes nothing.
    pub fn untrained(info: AdapterInfo, seed: u64) -> Self {
        let weights = AdapterNetwork::new().slots().draw(seed);
        Self::new(info, weights)
    }

    /// Number of weights.
    pub fn size() -> usize {
        AdapterNetwork::new().slots().count()
    }

    /// What it was trained for.
    pub fn info(&self) -> &AdapterInfo {
        &self.info
    }

    /// The adapter as bytes; the same adapter gives the same bytes.
    ///
    /// # Errors
    /// If it cannot be written as safetensors.
    pub fn to_bytes(&self) -> Result<Vec<u8>, KindError> {
        let note = serde_json::to_string(&self.info).expect("plain data");
        let file = TensorFile::default().note("adapter", note);
        Ok(self.network.slots().write(file, "", &self.weights).to_bytes()?)
    }

    /// Reads an adapter.
    ///
    /// # Errors
    /// If the bytes are damaged or of another version.
    pub fn load(bytes: &[u8]) -> Result<Self, KindError> {
        let damaged = |why: String| {
            KindError::Input(format!(
                "this is no transport adapter: {why}; connect the output `adapter` of a `transport_adapter` node"
            ))
        };
        let file = TensorFile::from_bytes(bytes).map_err(|e| damaged(e.to_string()))?;
        let note = file.metadata.get("adapter").ok_or_else(|| damaged("the note `adapter` is missing".into()))?;
        let info = serde_json::from_str(note).map_err(|e| damaged(format!("its note `adapter`: {e}")))?;
        let weights = AdapterNetwork::new().slots().read(&file, "")?;
        Ok(Self::new(info, weights))
    }

    /// The corrections of images of one size, with even sides, at a time from 0 to 1.
    ///
    /// # Errors
    /// If a side is odd.
    pub fn correct(&self, base: &Image, time: f64) -> Result<Image, KindError> {
        let (width, height) = (base.width(), base.height());
        if width % 2 + height % 2 > 0 || base.channels() != 3 {
            return Err(KindError::Input(format!(
                "the adapter takes images with even sides and three channels, and got {width} x {height} x {}",
                base.channels()
            )));
        }
        let x = TensorData::new(base.data().to_vec(), [1, height, width, 3]);
        let out = self.network.forward(&self.tensors, Tensor::from_data(x, &Device::flex()), &[time]).into_data();
        let values = out.try_into_vec::<f32>().map_err(|e| KindError::Internal(format!("adapter output: {e:?}")))?;
        Ok(Image::from_data(width, height, 3, values)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn info() -> AdapterInfo {
        AdapterInfo {
            backbone: Digest::of(b"some backbone"),
            family: Family::Ddpm,
            residuals: Residuals::Rendered,
            clamp_clean: true,
            counts: vec![1, 2, 4],
            steps: 0,
        }
    }

    #[test]
    fn it_is_as_large_as_it_should_be_and_changes_nothing_untrained() {
        assert!((150_000..250_000).contains(&Adapter::size()), "{}", Adapter::size());
        let adapter = Adapter::untrained(info(), 1);
        let base = Image::from_data(8, 4, 3, (0..96).map(|i| (i % 7) as f32 - 3.0).collect()).expect("fits");
        assert!(adapter.correct(&base, 0.3).expect("fits").data().iter().all(|v| *v == 0.0));
        assert!(adapter.correct(&Image::new(3, 4, 3), 0.3).is_err());
        let back = Adapter::load(&adapter.to_bytes().expect("plain")).expect("its own");
        assert!(back.info() == adapter.info() && back.weights == adapter.weights);
        assert!(Adapter::load(b"nothing").is_err());
    }

    #[test]
    fn corrections_change_smoothly_with_time() {
        let mut adapter = Adapter::untrained(info(), 1);
        // A last layer that is not zero, and blocks that do something.
        for (at, values) in adapter.weights.0.iter_mut().enumerate().filter(|(_, v)| v.iter().all(|v| *v == 0.0)) {
            values.iter_mut().enumerate().for_each(|(i, v)| *v = ((i * 7 + at) % 11) as f32 * 0.004 - 0.02);
        }
        let adapter = Adapter::new(info(), adapter.weights);
        let base = Image::from_data(8, 8, 3, (0..192).map(|i| (i % 7) as f32 - 3.0).collect()).expect("fits");
        let at = |time: f64| adapter.correct(&base, time).expect("fits");
        let apart = |a: &Image, b: &Image| {
            let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
            a.data().iter().zip(b.data()).map(square).sum::<f64>().sqrt()
        };
        let whole = apart(&at(0.2), &at(0.8));
        assert!(whole > 0.0);
        for i in 0..60 {
            let time = 0.2 + f64::from(i) * 0.01;
            assert!(apart(&at(time), &at(time + 0.01)) < 0.2 * whole, "{time}");
        }
    }
}
