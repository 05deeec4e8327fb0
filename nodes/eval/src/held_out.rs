//! References that share no sample with what they judge: the errors that they tell, and whether they do share one.

use crate::evaluation::PSNR_CEILING;
use std::cell::Cell;
use tauflow_contract::{Artifact, Context, ItemKey, KindError};
use tauflow_data::{Image, Ladder, convergence::shares_samples, maths::log10};

/// Added to squares of the reference that errors are relative to.
const DARKEST: f64 = 0.01;
/// Deviations below this share of a pixel's value are rounding, not noise.
const ROUNDING: f64 = 1e-4;

/// A reference, exposed, and how much of a squared error is its own.
pub(crate) struct HeldOut {
    /// The image.
    pub(crate) image: Image,
    /// Its samples a pixel.
    pub(crate) spp: u64,
    /// Whether any of its samples vary.
    pub(crate) noisy: bool,
    /// How many images were nearer to it than its own noise tells.
    pub(crate) unresolved: Cell<u64>,
    /// Variance of single samples, of the exposed image; 0 where samples depend on each other.
    variance: Image,
    own_mse: f64,
    own_rel: f64,
}

/// What an image is off by.
pub(crate) struct Errors {
    /// Mean square.
    pub(crate) mse: f64,
    /// Mean of squares relative to the reference's, with [`DARKEST`] added.
    pub(crate) rel_mse: f64,
    /// PSNR of the mean square, peak 1, in dB.
    pub(crate) hdr_psnr: f64,
}

impl HeldOut {
    /// The last rung of a ladder, exposed by `factor`.
    pub(crate) fn load(ctx: &Context<'_>, artifact: &Artifact, factor: f64, key: &ItemKey) -> Result<Self, KindError> {
        let ladder = Ladder::load(ctx, artifact)?;
        let last =
            ladder.rungs.last().ok_or_else(|| KindError::Input(format!("the reference of `{key}` has no rung")))?;
        let image = last.image.map(|v| (f64::from(v) * factor) as f32);
        let noisy = ladder.variance.data().iter().any(|v| *v > 0.0);
        // Samples that depend on each other do not tell: less is taken off than could be.
        let known = f64::from(u8::from(ladder.meta.sampler.is_independent()));
        let variance = ladder.variance.map(|v| (known * f64::from(v) * factor * factor) as f32);
        Ok(Self::new(image, variance, last.spp, noisy))
    }

    fn new(image: Image, variance: Image, spp: u64, noisy: bool) -> Self {
        let count = image.data().len().max(1) as f64;
        let own = |v: &f32| f64::from(*v) / spp as f64;
        let own_mse = variance.data().iter().map(own).sum::<f64>() / count;
        let pairs = variance.data().iter().zip(image.data());
        let own_rel = pairs.map(|(v, r)| own(v) / (f64::from(*r).powi(2) + DARKEST)).sum::<f64>() / count;
        Self { image, spp, noisy, unresolved: Cell::new(0), variance, own_mse, own_rel }
    }

    /// Errors of an image, less what the reference's own noise adds; at least a thousandth of what was measured, as noise may
    /// hide the rest.
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
        if self.own_mse > 0.0 && square - self.own_mse < least(square) {
            self.unresolved.set(self.unresolved.get() + 1);
        }
        let less = |found: f64, own: f64| (found - own).max(least(found)).max(f64::MIN_POSITIVE);
        let mse = less(square, self.own_mse);
        Errors { mse, rel_mse: less(relative, self.own_rel), hdr_psnr: (-10.0 * log10(mse)).min(PSNR_CEILING) }
    }

    /// The mean over pixel values of ((I_n - R)^2/S^2 - 1/N) n, with S the deviation of a sample, for an image I_n of `spp` independent
    /// samples: 1 by the law, and 1 - 2 n/N if they are among the reference's own. With the square of its standard error; none
    /// without noise.
    pub(crate) fn against_law(&self, image: &Image, spp: u64) -> Option<(f64, f64)> {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for ((a, r), v) in image.data().iter().zip(self.image.data()).zip(self.variance.data()) {
            let (a, r, v) = (f64::from(*a), f64::from(*r), f64::from(*v));
            if v.sqrt() > ROUNDING * r.abs() {
                let off = ((a - r) * (a - r) / v - 1.0 / self.spp as f64) * spp as f64;
                count += 1.0;
                sum += off;
                squares += off * off;
            }
        }
        let mean: f64 = sum / count;
        (count > 1.0).then(|| (mean, (squares / count - mean * mean).max(0.0) / count))
    }
}

/// Whether references and images of `spp` samples share samples, by what [`HeldOut::against_law`] says of each scene: how large it is
/// over all of them, if so.
pub(crate) fn shared(figures: &[(f64, f64)], spp: u64, reference: u64) -> Option<f64> {
    let scenes = figures.len() as f64;
    let value = figures.iter().map(|figure| figure.0).sum::<f64>() / scenes;
    // The colours of a pixel share their paths: three values are one draw.
    let error = (3.0 * figures.iter().map(|figure| figure.1).sum::<f64>()).sqrt() / scenes;
    (scenes > 0.0 && shares_samples(value, error, spp, reference)).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    const SIDE: usize = 64;
    const OWN: u64 = 16;
    const HELD: u64 = 256;

    /// Means of the first 16 and of all 256 draws for each pixel value, whose deviations go from 0.01 to 10, and those of others.
    fn images() -> (Image, HeldOut, Image) {
        let mut stream = Stream::new(3, &[]);
        let (mut first, mut all, mut variances, mut other) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for at in 0..SIDE * SIDE * 3 {
            let size = [0.01, 0.1, 1.0, 10.0][at / 3 % 4];
            let mut draws = |n: u64| (0..n).map(|_| size * (1.0 + stream.normal())).collect::<Vec<f64>>();
            let mean = |draws: &[f64]| draws.iter().sum::<f64>() / draws.len() as f64;
            let (own, held, others) = (draws(OWN), draws(HELD - OWN), draws(OWN));
            let whole = [own.clone(), held].concat();
            let mu = mean(&whole);
            first.push(mean(&own) as f32);
            all.push(mu as f32);
            variances.push((whole.iter().map(|v| (v - mu).powi(2)).sum::<f64>() / (HELD - 1) as f64) as f32);
            other.push(mean(&others) as f32);
        }
        let image = |data| Image::from_data(SIDE, SIDE, 3, data).expect("fits");
        (image(first), HeldOut::new(image(all), image(variances), HELD, true), image(other))
    }

    #[test]
    fn a_reference_that_shares_samples_is_found_out() {
        let (nested, held_out, independent) = images();
        let of = |image: &Image| held_out.against_law(image, OWN).expect("noise");
        let (among, apart) = (of(&nested), of(&independent));
        assert!(
            (among.0 - (1.0 - 2.0 * 16.0 / 256.0)).abs() < 0.05 && (apart.0 - 1.0).abs() < 0.05,
            "{among:?} {apart:?}"
        );
        // As of four scenes.
        assert!(shared(&[among; 4], OWN, HELD).is_some() && shared(&[apart; 4], OWN, HELD).is_none());
        // What too few pixels say is no reason to refuse anything.
        assert!(shared(&[(among.0, 1.0)], OWN, HELD).is_none() && shared(&[], OWN, HELD).is_none());
        let still = HeldOut::new(nested.clone(), nested.map(|_| 0.0), HELD, false);
        assert!(still.against_law(&nested, OWN).is_none());
    }

    #[test]
    fn the_reference_s_noise_is_no_error_of_the_image() {
        let (_, held_out, independent) = images();
        let errors = held_out.errors(&independent);
        // Three quarters of the values are of a hundredth and less; negatives of the others count as 0.
        assert!(errors.mse > 0.0 && (errors.hdr_psnr + 10.0 * errors.mse.log10()).abs() < 1e-9);
        assert_eq!(held_out.unresolved.get(), 0);
        // An image that is the reference without its noise cannot be told from one that is a little worse.
        let errors = held_out.errors(&held_out.image.map(|v| v.max(0.0)));
        assert_eq!(held_out.unresolved.get(), 1);
        assert!(errors.mse > 0.0 && errors.rel_mse > 0.0);
        let still = HeldOut::new(independent.map(f32::abs), independent.map(|_| 0.0), HELD, false);
        assert_eq!(still.errors(&still.image).hdr_psnr, PSNR_CEILING);
        assert_eq!(still.unresolved.get(), 0);
    }
}
