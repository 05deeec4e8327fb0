//! References that share no sample with what they judge: the errors that they tell, and whether they do share one.

use tauflow_contract::{Context, Handle, ItemKey, KindError};
use tauflow_data::{
    Image,
    maths::log10,
    records::{Ladder, PSNR_CEILING, deviation_of_both, shares_samples},
};

/// Added to squares of the reference that errors are relative to.
const DARKEST: f64 = 0.01;

/// A reference, exposed, and how much of a squared error is its own.
pub(crate) struct HeldOut {
    /// The image.
    pub(crate) image: Image,
    /// Its samples per pixel.
    pub(crate) spp: u64,
    /// Whether any of its samples vary.
    pub(crate) noisy: bool,
    /// Whether its samples are independent.
    pub(crate) independent: bool,
    /// Variance of single samples, of the exposed image; 0 where samples depend on each other.
    variance: Image,
    /// Mean squared error of the image; 0 where samples depend on each other.
    pub(crate) own_mse: f64,
    own_rel: f64,
}

/// The errors of an image.
pub(crate) struct Errors {
    /// Mean square.
    pub(crate) mse: f64,
    /// Mean of squares relative to the reference's, with [`DARKEST`] added.
    pub(crate) rel_mse: f64,
    /// PSNR of the mean square, peak 1, in dB.
    pub(crate) hdr_psnr: f64,
    /// Whether the image is nearer to the reference than the reference's own noise tells.
    pub(crate) unresolved: bool,
}

impl HeldOut {
    /// The last rung of a ladder, exposed by `factor`.
    pub(crate) fn load(
        ctx: &Context<'_>,
        ladder: Handle<'_, Ladder>,
        factor: f64,
        key: &ItemKey,
    ) -> Result<Self, KindError> {
        let ladder = ladder.load(ctx)?;
        let last =
            ladder.rungs.last().ok_or_else(|| KindError::Input(format!("the reference of `{key}` has no rung")))?;
        let image = last.image.map(|v| (f64::from(v) * factor) as f32);
        let noisy = ladder.variance.data().iter().any(|v| *v > 0.0);
        // Samples that depend on each other do not tell: less is taken off than could be.
        let independent = ladder.meta.sampler.is_independent();
        let known = f64::from(u8::from(independent));
        let variance = ladder.variance.map(|v| (known * f64::from(v) * factor * factor) as f32);
        Ok(Self { independent, ..Self::new(image, variance, last.spp, noisy) })
    }

    fn new(image: Image, variance: Image, spp: u64, noisy: bool) -> Self {
        let count = image.data().len().max(1) as f64;
        let own = |v: &f32| f64::from(*v) / spp as f64;
        let own_mse = variance.data().iter().map(own).sum::<f64>() / count;
        let pairs = variance.data().iter().zip(image.data());
        let own_rel = pairs.map(|(v, r)| own(v) / (f64::from(*r).powi(2) + DARKEST)).sum::<f64>() / count;
        Self { image, spp, noisy, independent: true, variance, own_mse, own_rel }
    }

    /// Errors of an image, less what the reference's own noise adds. At least a thousandth of what was measured is
    /// left, as noise may hide the rest.
    pub(crate) fn errors(&self, image: &Image) -> Errors {
        let (mut square, mut relative) = (0.0, 0.0);
        for (a, r) in image.data().iter().zip(self.image.data()) {
            let (a, r) = (f64::from(a.max(0.0)), f64::from(*r));
            let d = (a - r) * (a - r);
            square += d;
            relative += d / (r * r + DARKEST);
        }
        let count = image.data().len().max(1) as f64;
        let (square, relative) = (square / count, relative / count);
        let least = |found: f64| 1e-3 * found;
        let hidden = |found: f64, own: f64| own > 0.0 && found - own < least(found);
        let unresolved = hidden(square, self.own_mse) || hidden(relative, self.own_rel);
        let less = |found: f64, own: f64| (found - own).max(least(found)).max(f64::MIN_POSITIVE);
        let mse = less(square, self.own_mse);
        Errors {
            mse,
            rel_mse: less(relative, self.own_rel),
            hdr_psnr: (-10.0 * log10(mse)).min(PSNR_CEILING),
            unresolved,
        }
    }

    /// The mean over pixels of ((I_n - R)^2/S^2 - 1/N) n, with the square of its standard error; none without noise.
    ///
    /// I_n is the last rung of a ladder of independent samples, R the reference of N samples, and S^2 the variance of
    /// the samples of both as one set. By the law the mean is 1. It is 1 - 2 n/N if the ladder's samples are among the
    /// reference's own.
    ///
    /// Variances of the ladder's own samples are not packed. What its rungs are apart stands for them. That is of the
    /// right size in the mean, and too small where one rare event decides: such pixels count too much, never too
    /// little.
    pub(crate) fn against_law(&self, counts: &[u64], states: &[Image]) -> Option<(f64, f64)> {
        let (spp, last) = counts.last().copied().zip(states.last())?;
        let values = |image: &Image, at: usize| f64::from(image.data()[at]);
        let own = |at: usize| {
            let pairs = counts.windows(2).zip(states.windows(2));
            let sum: f64 = pairs
                .map(|(counts, states)| {
                    let (a, b) = (counts[0] as f64, counts[1] as f64);
                    (values(&states[1], at) - values(&states[0], at)).powi(2) * a * b / (b - a)
                })
                .sum();
            sum / (counts.len() - 1).max(1) as f64
        };
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for pixel in 0..self.image.data().len() / 3 {
            // The colours of a pixel share their paths: one draw, not three.
            let (mut colours, mut off) = (0.0, 0.0);
            for at in 3 * pixel..3 * pixel + 3 {
                let truth = values(&self.image, at);
                let apart = values(last, at) - truth;
                let both = [(spp, own(at)), (self.spp, values(&self.variance, at))];
                if let Some(deviation) = deviation_of_both(both, apart, truth) {
                    colours += 1.0;
                    off += ((apart / deviation).powi(2) - 1.0 / self.spp as f64) * spp as f64;
                }
            }
            if colours > 0.0 {
                let off: f64 = off / colours;
                count += 1.0;
                sum += off;
                squares += off * off;
            }
        }
        let mean: f64 = sum / count;
        (self.independent && count > 1.0).then(|| (mean, (squares / count - mean * mean).max(0.0) / count))
    }
}

/// Whether references and images of `spp` samples share samples, by what [`HeldOut::against_law`] says of each scene.
///
/// If they do, this is how large it is over all scenes. Its standard error is the larger of what pixels and what scenes
/// say.
pub(crate) fn shared(figures: &[(f64, f64)], spp: u64, reference: u64) -> Option<f64> {
    let scenes = figures.len() as f64;
    let value = figures.iter().map(|figure| figure.0).sum::<f64>() / scenes;
    let within = figures.iter().map(|figure| figure.1).sum::<f64>() / (scenes * scenes);
    let spread = figures.iter().map(|figure| (figure.0 - value).powi(2)).sum::<f64>();
    let between = if figures.len() > 1 { spread / ((scenes - 1.0) * scenes) } else { 0.0 };
    (scenes > 0.0 && shares_samples(value, within.max(between).sqrt(), spp, reference)).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    const SIDE: usize = 64;
    const RUNGS: [u64; 5] = [1, 2, 4, 8, 16];
    const HELD: u64 = 256;

    /// A ladder of 16 draws for each pixel value and the mean of 256, of which the ladder's are the first if `nested`.
    fn images(nested: bool, mut draw: impl FnMut(usize) -> f64) -> (Vec<Image>, HeldOut) {
        let size = SIDE * SIDE * 3;
        let (mut rungs, mut means, mut variances) = (vec![Vec::new(); RUNGS.len()], Vec::new(), Vec::new());
        for at in 0..size {
            let held: Vec<f64> = (0..HELD).map(|_| draw(at)).collect();
            let own: Vec<f64> = if nested { held[..16].to_vec() } else { (0..16).map(|_| draw(at)).collect() };
            let mean = |draws: &[f64]| draws.iter().sum::<f64>() / draws.len() as f64;
            for (rung, count) in rungs.iter_mut().zip(RUNGS) {
                rung.push(mean(&own[..count as usize]) as f32);
            }
            let mu = mean(&held);
            means.push(mu as f32);
            variances.push((held.iter().map(|v| (v - mu).powi(2)).sum::<f64>() / (HELD - 1) as f64) as f32);
        }
        let image = |data| Image::from_data(SIDE, SIDE, 3, data).expect("fits");
        let held_out = HeldOut::new(image(means), image(variances), HELD, true);
        (rungs.into_iter().map(image).collect(), held_out)
    }

    /// Deviations from 0.01 to 10.
    fn normal(stream: &mut Stream, at: usize) -> f64 {
        [0.01, 0.1, 1.0, 10.0][at / 3 % 4] * (1.0 + stream.normal())
    }

    #[test]
    fn a_reference_that_shares_samples_is_found_out() {
        let of = |nested| {
            let mut stream = Stream::new(3, &[]);
            let (states, held_out) = images(nested, |at| normal(&mut stream, at));
            held_out.against_law(&RUNGS, &states).expect("noise")
        };
        let (among, apart) = (of(true), of(false));
        assert!(
            (among.0 - (1.0 - 2.0 * 16.0 / 256.0)).abs() < 0.05 && (apart.0 - 1.0).abs() < 0.05,
            "{among:?} {apart:?}"
        );
        assert!(shared(&[among; 4], 16, HELD).is_some() && shared(&[apart; 4], 16, HELD).is_none());
        // What too few pixels say, or scenes that differ, is no reason to refuse anything.
        assert!(shared(&[(among.0, 1.0)], 16, HELD).is_none() && shared(&[], 16, HELD).is_none());
        assert!(shared(&[(0.0, 0.0), (1.7, 0.0)], 16, HELD).is_none());
        let (states, still) = images(true, |_| 0.7);
        assert!(still.against_law(&RUNGS, &states).is_none());
    }

    #[test]
    fn events_that_are_too_rare_for_the_reference_are_no_sign_of_shared_samples() {
        for (share, events) in [(3, 0.5), (10, 0.5), (10, 0.1), (10, 2.0)] {
            let mut stream = Stream::new(4, &[]);
            let (states, held_out) = images(false, |at| {
                // In so many tenths of the pixels the reference draws as many events in the mean. Others are as noise
                // is.
                if at / 3 % 10 < share {
                    1.0 + f64::from(u8::from(stream.uniform() < events / HELD as f64))
                } else {
                    normal(&mut stream, at)
                }
            });
            let figure = held_out.against_law(&RUNGS, &states).expect("noise");
            assert!(shared(&[figure; 48], 16, HELD).is_none(), "{share} tenths, {events} events: {figure:?}");
        }
    }

    #[test]
    fn the_reference_s_noise_is_no_error_of_the_image() {
        let mut stream = Stream::new(5, &[]);
        let (states, held_out) = images(false, |at| normal(&mut stream, at));
        let errors = held_out.errors(&states[4]);
        assert!(errors.mse > 0.0 && (errors.hdr_psnr + 10.0 * errors.mse.log10()).abs() < 1e-9);
        assert!(!errors.unresolved);
        // An image that is the reference without its noise cannot be told from one that is a little worse.
        let errors = held_out.errors(&held_out.image.map(|v| v.max(0.0)));
        assert!(errors.unresolved);
        assert!(errors.mse > 0.0 && errors.rel_mse > 0.0);
        let still = HeldOut::new(states[4].map(f32::abs), states[4].map(|_| 0.0), HELD, false);
        let errors = still.errors(&still.image);
        assert!(errors.hdr_psnr == PSNR_CEILING && !errors.unresolved);
    }
}
