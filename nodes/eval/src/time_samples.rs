//! What was measured of each scene: images by method, what each took, and how far off it is.
//!
//! Knows neither where it comes from (`time_scene`) nor what is made of it (`time_course`, `time_tables`).

use crate::evaluation::coordinates;
use std::collections::BTreeMap;
use tauflow_data::{
    methods::{
        Conditioning,
        axes::{CONDITIONING, FROM, METHOD, PARAMETERIZATION, SAMPLER},
    },
    statistics::quantile,
};

/// One image: what it took, and how far off it is.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    pub(crate) from_spp: u64,
    pub(crate) nfe: u64,
    /// Quartiles of the times that it was made.
    pub(crate) wall_s: [f64; 3],
    pub(crate) cpu_s: [f64; 3],
    pub(crate) mse: f64,
    pub(crate) rel_mse: f64,
    pub(crate) hdr_psnr: f64,
    pub(crate) preview_psnr: f64,
    pub(crate) ssim: f64,
    /// Whether the reference's own noise hides the error.
    pub(crate) unresolved: bool,
}

/// A method's name and coordinates, but for where it starts.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MethodOf {
    pub(crate) method: String,
    pub(crate) conditioning: String,
    pub(crate) cell: BTreeMap<String, String>,
}

impl MethodOf {
    pub(crate) fn new(cell: &str, method: &str) -> Self {
        let mut cell = coordinates(cell);
        let conditioning = cell.remove(CONDITIONING).unwrap_or_else(|| Conditioning::Rgb.name().to_owned());
        [FROM, PARAMETERIZATION, METHOD, SAMPLER].into_iter().for_each(|axis| drop(cell.remove(axis)));
        Self { method: method.to_owned(), conditioning, cell }
    }

    /// The same method, applied to endpoints of another sampler.
    pub(crate) fn on_sampler(mut self, sampler: &str) -> Self {
        self.cell.insert(SAMPLER.to_owned(), sampler.to_owned());
        self
    }
}

/// A scene's images: the path tracer's by samples, and those of the other methods.
#[derive(Clone, Debug)]
pub(crate) struct Measured {
    pub(crate) scene: String,
    pub(crate) own: Vec<Sample>,
    pub(crate) methods: BTreeMap<MethodOf, Vec<Sample>>,
}

/// A method, none for the path tracer, with its samples and NFE.
pub(crate) type Points<'a> = (Option<&'a MethodOf>, Vec<(u64, u64)>);

impl Measured {
    /// The path tracer's images, then those of each method.
    pub(crate) fn samples(&self) -> impl Iterator<Item = &Vec<Sample>> {
        std::iter::once(&self.own).chain(self.methods.values())
    }

    /// What was measured, without the figures.
    pub(crate) fn layout(&self) -> Vec<Points<'_>> {
        let names = std::iter::once(None).chain(self.methods.keys().map(Some));
        names.zip(self.samples()).map(|(name, of)| (name, of.iter().map(|s| (s.from_spp, s.nfe)).collect())).collect()
    }
}

/// The quartiles of some values.
pub(crate) fn quartiles(values: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    [0.25, 0.5, 0.75].map(|share| quantile(&sorted, share))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use tauflow_data::{maths::log10, rng::Stream};

    pub(crate) fn sample(from_spp: u64, nfe: u64, wall_s: f64, mse: f64) -> Sample {
        let hdr_psnr = -10.0 * log10(mse);
        let preview_psnr = hdr_psnr + 5.0;
        Sample {
            from_spp,
            nfe,
            wall_s: [0.9 * wall_s, wall_s, 1.3 * wall_s],
            cpu_s: [1.9, 2.0, 2.2].map(|factor| factor * wall_s),
            mse,
            rel_mse: 2.0 * mse,
            hdr_psnr,
            preview_psnr,
            ssim: 0.5,
            unresolved: false,
        }
    }

    /// A path tracer with error variance/n and time 0.1 s + n times 10 ms, and a solver that divides the error of 1
    /// sample by 100 in 0.2 s more.
    pub(crate) fn scene(i: u64) -> Measured {
        let variance = 0.1 + Stream::new(5, &[i]).uniform();
        let own = (0..8).map(|k| 1u64 << k);
        let own = own.map(|n| sample(n, 0, 0.1 + 0.01 * n as f64, variance / n as f64)).collect();
        let solver = MethodOf::new("parameterization=mc_noise+conditioning=gbuffer+from=1+extra=x", "mc_noise");
        assert_eq!(solver.cell.len(), 1);
        let methods = BTreeMap::from([(solver, vec![sample(1, 1, 0.31, variance / 100.0)])]);
        Measured { scene: format!("L{}-open-{i:06}", i % 2), own, methods }
    }

    pub(crate) fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9 * expected.abs().max(1.0), "{found} {expected}");
    }
}
