//! A solver that looks at an image and at its mirror images: its prediction is the mean of theirs, mirrored back. Each
//! errs in its own way, so that the mean errs less.

use crate::{model::Model, rollout::Denoiser, space::Space};
use tauflow_contract::KindError;
use tauflow_data::{Image, methods::Parameterization, time::VarianceTime, views::Views};

/// A model by the mean of several views.
pub struct Mirrored<'a> {
    model: &'a Model,
    views: Views,
}

impl<'a> Mirrored<'a> {
    /// Of so many views.
    pub fn new(model: &'a Model, views: Views) -> Self {
        Self { model, views }
    }
}

impl Denoiser for Mirrored<'_> {
    fn parameterization(&self) -> Parameterization {
        self.model.parameterization()
    }

    fn space(&self) -> Space {
        self.model.space()
    }

    fn clock(&self) -> VarianceTime {
        self.model.clock()
    }

    fn next(&self, count: f64) -> f64 {
        self.model.next(count)
    }

    fn predict(&self, state: &Image, gbuffer: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        let mut sum = self.model.predict(state, gbuffer, tau)?;
        for view in self.views.all().skip(1) {
            let gbuffer = gbuffer.map(|gbuffer| view.gbuffer(gbuffer)).transpose()?;
            let seen = self.model.predict(&view.image(state)?, gbuffer.as_ref(), tau)?;
            sum.data_mut().iter_mut().zip(view.inverse().image(&seen)?.data()).for_each(|(sum, seen)| *sum += seen);
        }
        let share = 1.0 / self.views.all().count() as f32;
        Ok(sum.map(|value| value * share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        device::Place,
        law::Law,
        model::ModelInfo,
        network::{Features, Output, Preset},
    };
    use tauflow_data::{SamplerKind, methods::Conditioning, rng::Stream, time::INDEPENDENT_EXPONENT, views::View};

    /// A model of weights that are nowhere zero.
    fn model() -> Model {
        let info = ModelInfo {
            parameterization: Parameterization::McNoise,
            conditioning: Conditioning::Gbuffer,
            preset: Preset::Tiny,
            space: Space::Log1p,
            counts: vec![1, 4, 16],
            steps: 1,
            output: Output::Means,
            unknown_counts: false,
            features: Features::Contrast,
            law: Law::Limits,
            exponent: INDEPENDENT_EXPONENT,
            sampler: SamplerKind::Independent,
        };
        let network = info.encoding().expect("a ladder").network();
        let mut weights = network.slots().draw(3);
        for (i, matrix) in weights.0.iter_mut().enumerate() {
            let mut stream = Stream::new(5, &[i as u64]);
            matrix.iter_mut().filter(|w| **w == 0.0).for_each(|w| *w = stream.range(-0.05, 0.05) as f32);
        }
        Model::new(info, weights, &Place::cpu()).expect("fits")
    }

    fn image(channels: usize, seed: u64) -> Image {
        let mut stream = Stream::new(seed, &[]);
        let data = (0..16 * 8 * channels).map(|_| stream.range(0.0, 1.0) as f32).collect();
        Image::from_data(16, 8, channels, data).expect("fits")
    }

    fn furthest(a: &Image, b: &Image) -> f32 {
        a.data().iter().zip(b.data()).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
    }

    #[test]
    fn one_view_is_the_model_and_all_of_them_do_not_know_left_from_right() {
        let (model, state, gbuffer) = (model(), image(3, 1), image(6, 2));
        let alone = model.predict(&state, Some(&gbuffer), Some(0.3)).expect("fits");
        let every: Vec<View> = Views::try_from(8).expect("a number of views").all().collect();
        let of = |views: u64, view: usize| {
            let view = every[view];
            let (state, gbuffer) = (view.image(&state).expect("fits"), view.gbuffer(&gbuffer).expect("fits"));
            let mirrored = Mirrored::new(&model, Views::try_from(views).expect("a number of views"));
            view.inverse().image(&mirrored.predict(&state, Some(&gbuffer), Some(0.3)).expect("fits")).expect("fits")
        };
        assert_eq!(of(1, 0), alone);
        assert!(furthest(&of(1, 1), &alone) > 1e-3, "the network knows left from right");
        assert!(furthest(&of(2, 1), &of(2, 0)) < 1e-5);
        assert!(furthest(&of(2, 2), &of(2, 0)) > 1e-3);
        for view in 1..4 {
            assert!(furthest(&of(4, view), &of(4, 0)) < 1e-5, "{view}");
        }
        assert!(furthest(&of(4, 5), &of(4, 0)) > 1e-3);
        for view in 1..8 {
            assert!(furthest(&of(8, view), &of(8, 0)) < 1e-5, "{view}");
        }
    }
}
