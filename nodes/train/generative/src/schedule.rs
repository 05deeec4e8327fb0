//! The samplers: DDPM's ancestral steps (Ho et al. 2020, as diffusers' `DDPMScheduler` has them) and the Euler steps of
//! Rectified Flow (Liu et al. 2022). Both are a row of steps at fixed times. Knows no network.

use serde::{Deserialize, Serialize};

/// `scheduler_config.json` of a `DDPMScheduler`; what is left out is as in `google/ddpm-church-256`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DdpmConfig {
    /// `DDPMScheduler`.
    #[serde(rename = "_class_name")]
    pub class_name: String,
    /// Times of the training.
    pub num_train_timesteps: usize,
    /// First noise rate.
    pub beta_start: f64,
    /// Last noise rate.
    pub beta_end: f64,
    /// `linear`.
    pub beta_schedule: String,
    /// null.
    pub trained_betas: Option<Vec<f64>>,
    /// Whether the clean image of each step is clipped.
    pub clip_sample: bool,
    /// To minus and plus this.
    pub clip_sample_range: f64,
    /// `epsilon`.
    pub prediction_type: String,
    /// `fixed_small`.
    pub variance_type: String,
    /// `leading`.
    pub timestep_spacing: String,
    /// Added to the times of sampling.
    pub steps_offset: usize,
    /// false.
    pub thresholding: bool,
    /// false.
    pub rescale_betas_zero_snr: bool,
}

impl Default for DdpmConfig {
    fn default() -> Self {
        Self {
            class_name: "DDPMScheduler".into(),
            num_train_timesteps: 1000,
            beta_start: 1e-4,
            beta_end: 0.02,
            beta_schedule: "linear".into(),
            trained_betas: None,
            clip_sample: true,
            clip_sample_range: 1.0,
            prediction_type: "epsilon".into(),
            variance_type: "fixed_small".into(),
            timestep_spacing: "leading".into(),
            steps_offset: 0,
            thresholding: false,
            rescale_betas_zero_snr: false,
        }
    }
}

impl DdpmConfig {
    /// What of it is not supported: everything, a line each.
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        for (field, found, wanted) in [
            ("_class_name", &self.class_name, "DDPMScheduler"),
            ("beta_schedule", &self.beta_schedule, "linear"),
            ("prediction_type", &self.prediction_type, "epsilon"),
            ("variance_type", &self.variance_type, "fixed_small"),
            ("timestep_spacing", &self.timestep_spacing, "leading"),
        ] {
            if found != wanted {
                problems.push(format!("`{field}` is `{found}`, supported is `{wanted}`"));
            }
        }
        for (field, set) in [
            ("thresholding", self.thresholding),
            ("rescale_betas_zero_snr", self.rescale_betas_zero_snr),
            ("trained_betas", self.trained_betas.is_some()),
        ] {
            if set {
                problems.push(format!("`{field}` is set, supported is leaving it away"));
            }
        }
        let rates = self.beta_start > 0.0 && self.beta_start <= self.beta_end && self.beta_end < 1.0;
        if !rates || !(2..=100_000).contains(&self.num_train_timesteps) {
            problems.push(format!(
                "`beta_start` {}, `beta_end` {} and `num_train_timesteps` {} are no schedule",
                self.beta_start, self.beta_end, self.num_train_timesteps
            ));
        }
        if self.clip_sample && !(self.clip_sample_range > 0.0 && self.clip_sample_range.is_finite()) {
            problems.push(format!("`clip_sample_range` is {}, supported is a positive number", self.clip_sample_range));
        }
        problems
    }
}

/// DDPM's noise at each time.
#[derive(Clone, Debug)]
pub struct Ddpm {
    clip: Option<f32>,
    offset: usize,
    /// Products of 1 - beta, by time.
    alphas: Vec<f64>,
}

impl Ddpm {
    /// The schedule of a configuration without problems.
    pub fn new(config: &DdpmConfig) -> Self {
        let last = (config.num_train_timesteps - 1) as f64;
        let mut product = 1.0;
        let alphas = (0..config.num_train_timesteps).map(|i| {
            product *= 1.0 - (config.beta_start + (config.beta_end - config.beta_start) * i as f64 / last);
            product
        });
        let clip = config.clip_sample.then_some(config.clip_sample_range as f32);
        Self { clip, offset: config.steps_offset, alphas: alphas.collect() }
    }

    /// Times of the training.
    pub fn times(&self) -> usize {
        self.alphas.len()
    }

    /// The share of the clean image's square at a time.
    pub fn alpha(&self, time: usize) -> f64 {
        self.alphas[time.min(self.alphas.len() - 1)]
    }

    /// The range to which clean images are clipped; none if they are not.
    pub fn clip(&self) -> Option<f32> {
        self.clip
    }

    /// The clean image in a state, by the noise that is predicted in it.
    pub fn clean(&self, state: f32, noise: f32, time: usize) -> f32 {
        let alpha = self.alpha(time);
        ((f64::from(state) - (1.0 - alpha).sqrt() * f64::from(noise)) / alpha.sqrt()) as f32
    }
}

/// A sampler: its steps, at times that networks are told.
#[derive(Clone, Debug)]
pub enum Sampler {
    /// DDPM's ancestral steps.
    Ddpm {
        /// The noise at each time.
        schedule: Ddpm,
        /// Steps.
        steps: usize,
    },
    /// Rectified Flow's Euler steps from 1e-3 to 1.
    Euler {
        /// Steps.
        steps: usize,
    },
}

/// Where Rectified Flow begins.
pub const FIRST: f64 = 1e-3;
/// What its network is given as time at 1.
pub const SCALE: f64 = 999.0;

impl Sampler {
    /// Steps in all.
    pub fn steps(&self) -> usize {
        match self {
            Self::Ddpm { steps, .. } | Self::Euler { steps } => *steps,
        }
    }

    /// The time of a step: of the training for DDPM, from 1e-3 to 1 for Rectified Flow.
    pub fn time(&self, step: usize) -> f64 {
        match self {
            Self::Ddpm { schedule, steps } => {
                let leading = (steps - 1 - step) * (schedule.times() / steps) + schedule.offset;
                leading.min(schedule.times() - 1) as f64
            }
            Self::Euler { steps } => step as f64 / *steps as f64 * (1.0 - FIRST) + FIRST,
        }
    }

    /// Whether a step adds noise.
    pub fn is_noisy(&self, step: usize) -> bool {
        matches!(self, Self::Ddpm { .. }) && self.time(step) > 0.0
    }

    /// Takes a step by a prediction, and by standard normal noise where it is noisy.
    pub fn advance(&self, step: usize, state: &mut [f32], prediction: &[f32], noise: &[f32]) {
        match self {
            Self::Euler { steps } => {
                let size = (1.0 / *steps as f64) as f32;
                state.iter_mut().zip(prediction).for_each(|(x, velocity)| *x += velocity * size);
            }
            Self::Ddpm { schedule, steps } => {
                let time = self.time(step) as usize;
                let before = time.checked_sub(schedule.times() / steps);
                let (alpha, earlier) = (schedule.alpha(time), before.map_or(1.0, |time| schedule.alpha(time)));
                let (rest, kept) = (1.0 - alpha, alpha / earlier);
                let of_clean = (earlier.sqrt() * (1.0 - kept) / rest) as f32;
                let of_state = (kept.sqrt() * (1.0 - earlier) / rest) as f32;
                let variance = ((1.0 - earlier) / rest * (1.0 - kept)).max(1e-20);
                let deviation = if self.is_noisy(step) { variance.sqrt() as f32 } else { 0.0 };
                for (i, (x, epsilon)) in state.iter_mut().zip(prediction).enumerate() {
                    let clean = schedule.clean(*x, *epsilon, time);
                    let clean = schedule.clip.map_or(clean, |range| clean.clamp(-range, range));
                    let mean = of_clean * clean + of_state * *x;
                    *x = if deviation > 0.0 { mean + deviation * noise[i] } else { mean };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_lead_and_end_where_they_should() {
        let ddpm = Sampler::Ddpm { schedule: Ddpm::new(&DdpmConfig::default()), steps: 100 };
        assert_eq!((ddpm.time(0), ddpm.time(1), ddpm.time(99)), (990.0, 980.0, 0.0));
        assert!(ddpm.is_noisy(98) && !ddpm.is_noisy(99));
        let euler = Sampler::Euler { steps: 4 };
        assert_eq!((euler.time(0), euler.steps()), (1e-3, 4));
        assert!((euler.time(3) - (0.75 * 0.999 + 1e-3)).abs() < 1e-12 && !euler.is_noisy(0));
    }

    #[test]
    fn the_right_noise_leads_to_the_clean_image() {
        let schedule = Ddpm::new(&DdpmConfig::default());
        // ln of the product of 1 - beta is near minus the sum of beta: about -10.05 - 0.067.
        assert!((schedule.alpha(999).ln() + 10.12).abs() < 0.02, "{}", schedule.alpha(999));
        let sampler = Sampler::Ddpm { schedule: schedule.clone(), steps: 1000 };
        let mut state = [0.0f32];
        let clean = 0.3f32;
        for step in 0..1000 {
            let alpha = schedule.alpha(sampler.time(step) as usize);
            let epsilon = (f64::from(state[0]) - alpha.sqrt() * f64::from(clean)) / (1.0 - alpha).sqrt();
            sampler.advance(step, &mut state, &[epsilon as f32], &[1.0]);
        }
        assert!((state[0] - clean).abs() < 1e-5, "{}", state[0]);
        let mut state = [0.0f32, 1.0];
        let euler = Sampler::Euler { steps: 8 };
        (0..8).for_each(|step| euler.advance(step, &mut state, &[0.5, -1.0], &[]));
        assert_eq!(state, [0.5, 0.0]);
    }

    #[test]
    fn what_is_not_supported_is_told_in_full() {
        let config = DdpmConfig {
            prediction_type: "v_prediction".into(),
            thresholding: true,
            beta_end: 2.0,
            ..DdpmConfig::default()
        };
        let told = config.problems().join("\n");
        assert!(["prediction_type", "thresholding", "beta_end"].iter().all(|f| told.contains(f)), "{told}");
        assert_eq!(DdpmConfig::default().problems(), [""; 0]);
    }
}
