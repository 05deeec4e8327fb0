//! Draws from discrete distributions in constant time: Walker's alias method (1977), tables after Vose (1991).

use crate::lanes::{Integer, Real};

/// Tables of distributions, one after another: for each place the share of draws that stay there, and where the others
/// go.
#[derive(Clone, Debug, Default)]
pub(crate) struct Alias {
    stay: Vec<f32>,
    other: Vec<u32>,
}

impl Alias {
    /// Appends a distribution of these weights, worked out in f64; without any weight, an even one.
    pub(crate) fn extend(&mut self, weights: &[f64]) {
        let total: f64 = weights.iter().sum();
        let even = !(total > 0.0 && total.is_finite());
        let mut share: Vec<f64> =
            weights.iter().map(|w| if even { 1.0 } else { w / total * weights.len() as f64 }).collect();
        let start = self.stay.len();
        self.stay.resize(start + share.len(), 1.0);
        self.other.extend(0..share.len() as u32);
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..share.len()).partition(|at| share[*at] < 1.0);
        while let (Some(low), Some(high)) = (small.pop(), large.pop()) {
            self.stay[start + low] = share[low] as f32;
            self.other[start + low] = high as u32;
            share[high] = (share[high] + share[low]) - 1.0;
            if share[high] < 1.0 { small.push(high) } else { large.push(high) }
        }
        // Rounding alone leaves some over: what is nearly 1 stays, but a weight of 0 must not come up.
        let most = (0..weights.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
        for low in small {
            self.stay[start + low] = share[low] as f32;
            self.other[start + low] = most as u32;
        }
    }

    /// A place in the distribution of `count` places that begins at `start`, by two numbers in [0, 1). These have 24
    /// bits: places of a distribution of a million are an even sixteenth of the numbers more or less likely than they
    /// should be.
    #[inline(always)]
    pub(crate) fn draw<R: Real>(&self, start: R::Integer, count: usize, pick: R, accept: R) -> R::Integer {
        let last = R::Integer::splat(count as i32 - 1);
        let at = (pick * count as f32).to_integer().min(last);
        let stays = accept.lt(R::gather(&self.stay, start + at));
        let other = R::gather_integer(&self.other, start + at);
        R::select_integer(stays, at, other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::rng::Stream;

    #[test]
    fn draws_have_the_weights_shares() {
        let mut alias = Alias::default();
        let sets: [&[f64]; 4] = [&[3.0], &[0.0, 0.0, 0.0], &[1.0, 0.0, 2.0, 5.0, 0.5, 1e-3], &[1e5, 1.0, 1.0]];
        let mut start = 0;
        for weights in sets {
            alias.extend(weights);
            let mut stream = Stream::new(4, &[start as u64]);
            let mut counts = vec![0.0; weights.len()];
            let draws = 400_000.0;
            for _ in 0..draws as u32 {
                let (pick, accept) = (stream.uniform() as f32, stream.uniform() as f32);
                counts[alias.draw::<f32>(start, weights.len(), pick, accept) as usize] += 1.0;
            }
            let total: f64 = weights.iter().sum();
            for (count, weight) in counts.iter().zip(weights) {
                let expected = if total > 0.0 { weight / total } else { 1.0 / weights.len() as f64 } * draws;
                assert!((count - expected).abs() <= 5.0 * expected.sqrt() + 1e-9, "{count} {expected} of {weights:?}");
            }
            start += weights.len() as i32;
        }
    }
}
