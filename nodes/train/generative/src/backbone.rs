//! A backbone: a network with its weights and its sampler, from the files of a checkpoint.

use crate::{
    checkpoint::{read_weights, write_weights},
    network::{Ncsnpp, NcsnppConfig, Network, Unet2d, Unet2dConfig, slots},
    schedule::{Ddpm, DdpmConfig, SCALE, Sampler},
};
use burn::tensor::{Device, Tensor, TensorData};
use serde::de::DeserializeOwned;
use serde_json::Value;
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    records::{BackboneFiles, Family},
};
use tauflow_tensors::Weights;

/// A value of a preview, from 0 to 1, as a family's networks have it.
pub(crate) fn encoded(family: Family, value: f32) -> f32 {
    match family {
        Family::Ddpm => 2.0 * value - 1.0,
        Family::RectifiedFlow => value,
    }
}

/// The inverse of [`encoded`], held to 0 to 1.
pub(crate) fn decoded(family: Family, value: f32) -> f32 {
    let value = match family {
        Family::Ddpm => 0.5 * (value + 1.0),
        Family::RectifiedFlow => value,
    };
    value.clamp(0.0, 1.0)
}

/// What a checkpoint's configuration says.
#[derive(Clone, Debug, PartialEq)]
pub enum Config {
    /// Of a U-Net and its scheduler.
    Ddpm(Box<Unet2dConfig>, Box<DdpmConfig>),
    /// Of an NCSN++.
    RectifiedFlow(Box<NcsnppConfig>),
}

fn parse<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, KindError> {
    let mut reader = serde_json::Deserializer::from_str(text);
    serde_path_to_error::deserialize(&mut reader)
        .map_err(|e| KindError::Input(format!("`{file}` of a backbone: {}: {}", e.path(), e.inner())))
}

impl Config {
    /// Reads `config.json` and, of a U-Net, `scheduler_config.json`, without which it has that of the published ones.
    ///
    /// # Errors
    /// Everything in them that is not supported.
    pub fn read(config: &str, scheduler: Option<&str>) -> Result<Self, KindError> {
        let value: Value = parse("config.json", config)?;
        let (read, problems) = if value.get("nf").is_some() {
            let config: NcsnppConfig = parse("config.json", config)?;
            let problems = config.problems();
            (Self::RectifiedFlow(Box::new(config)), problems)
        } else if value.get("_class_name").is_some() || value.get("block_out_channels").is_some() {
            let config: Unet2dConfig = parse("config.json", config)?;
            let scheduler = scheduler.map(|text| parse("scheduler_config.json", text)).transpose()?;
            let scheduler: DdpmConfig = scheduler.unwrap_or_default();
            let mut problems = config.problems();
            problems.extend(scheduler.problems().into_iter().map(|line| format!("scheduler: {line}")));
            (Self::Ddpm(Box::new(config), Box::new(scheduler)), problems)
        } else {
            return Err(KindError::Input(
                "`config.json` of a backbone is neither that of a diffusers `UNet2DModel` (`_class_name`) nor of an \
                 NCSN++ (`nf`)"
                    .into(),
            ));
        };
        if problems.is_empty() {
            return Ok(read);
        }
        Err(KindError::Input(format!("the backbone's configuration is not supported:\n- {}", problems.join("\n- "))))
    }

    /// Its family.
    pub fn family(&self) -> Family {
        match self {
            Self::Ddpm(..) => Family::Ddpm,
            Self::RectifiedFlow(_) => Family::RectifiedFlow,
        }
    }

    /// Its network.
    pub fn network(&self) -> Network {
        match self {
            Self::Ddpm(config, _) => Network::Unet2d(Box::new(Unet2d::new(config))),
            Self::RectifiedFlow(config) => Network::Ncsnpp(Box::new(Ncsnpp::new(config))),
        }
    }

    /// Side of its images, if it says.
    pub fn side(&self) -> Option<usize> {
        match self {
            Self::Ddpm(config, _) => config.side(),
            Self::RectifiedFlow(config) => Some(config.image_size),
        }
    }

    /// Sides of images are multiples of this.
    pub fn multiple(&self) -> usize {
        match self {
            Self::Ddpm(config, _) => config.multiple(),
            Self::RectifiedFlow(config) => config.multiple(),
        }
    }

    /// The checkpoint's files for these weights.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn files(&self, weights: &Weights) -> Result<BackboneFiles, KindError> {
        let text = |value: serde_json::Result<String>| value.expect("plain data");
        let (config, scheduler) = match self {
            Self::Ddpm(config, scheduler) => {
                (text(serde_json::to_string_pretty(config)), Some(text(serde_json::to_string_pretty(scheduler))))
            }
            Self::RectifiedFlow(config) => (text(serde_json::to_string_pretty(config)), None),
        };
        Ok(BackboneFiles { config, scheduler, weights: write_weights(self.network().parameters(), weights)? })
    }
}

/// A network with its weights, ready to predict.
pub struct Backbone {
    config: Config,
    network: Network,
    weights: Vec<Tensor<2>>,
}

impl Backbone {
    /// A configuration with its weights.
    pub fn new(config: Config, weights: &Weights) -> Self {
        tauflow_ops::keep_memory();
        let network = config.network();
        let weights = slots(network.parameters()).tensors(weights, &Device::flex());
        Self { config, network, weights }
    }

    /// Reads a checkpoint: `file` names its weights in errors.
    ///
    /// # Errors
    /// All that is wrong with its configuration, or else with its weights.
    pub fn read(config: &str, scheduler: Option<&str>, file: &str, weights: &[u8]) -> Result<Self, KindError> {
        let config = Config::read(config, scheduler)?;
        let weights = read_weights(file, weights, config.network().parameters())?;
        Ok(Self::new(config, &weights))
    }

    /// Reads a backbone's record.
    ///
    /// # Errors
    /// As [`Backbone::read`].
    pub fn load(files: &BackboneFiles) -> Result<Self, KindError> {
        Self::read(&files.config, files.scheduler.as_deref(), BackboneFiles::WEIGHTS, &files.weights)
    }

    /// What its configuration says.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Its family.
    pub fn family(&self) -> Family {
        self.config.family()
    }

    /// Its sampler, of so many steps.
    pub fn sampler(&self, steps: usize) -> Sampler {
        match &self.config {
            Config::Ddpm(_, scheduler) => Sampler::Ddpm { schedule: Ddpm::new(scheduler), steps },
            Config::RectifiedFlow(_) => Sampler::Euler { steps },
        }
    }

    /// Predictions for images of one size at sampler times: noise for DDPM, velocity for Rectified Flow.
    ///
    /// # Errors
    /// If images differ in size, or their sides are no multiples of what the network halves.
    pub fn predict(&self, images: &[&Image], times: &[f64]) -> Result<Vec<Image>, KindError> {
        let Some(first) = images.first() else { return Ok(Vec::new()) };
        let (width, height) = (first.width(), first.height());
        let multiple = self.config.multiple();
        let fits = width.is_multiple_of(multiple) && height.is_multiple_of(multiple) && first.channels() == 3;
        if !fits || images.iter().any(|image| !image.same_shape(first)) {
            return Err(KindError::Input(format!(
                "a backbone takes images of one size, with sides that are multiples of {multiple}, and got {width} x \
                 {height} x {}; use another `side` in `generation`, or render with another `resolution`",
                first.channels()
            )));
        }
        // Rectified Flow's network is given 999 t.
        let scale = if self.family() == Family::RectifiedFlow { SCALE } else { 1.0 };
        let times: Vec<f64> = times.iter().map(|time| scale * time).collect();
        let values: Vec<f32> = images.iter().flat_map(|image| image.data().iter().copied()).collect();
        let x = Tensor::from_data(TensorData::new(values, [images.len(), height, width, 3]), &Device::flex());
        let out = self.network.forward(&self.weights, x, &times).into_data();
        let values = out.as_slice::<f32>().map_err(|e| KindError::Internal(format!("network output: {e:?}")))?;
        let image = |values: &[f32]| Ok(Image::from_data(width, height, 3, values.to_vec())?);
        values.chunks_exact(first.data().len()).map(image).collect()
    }
}
