//! Random numbers as a function of what they are for: never of thread, tile or run.
//!
//! The mixer is the finaliser of SplitMix64 (Steele, Lea, Flood 2014), applied to a running state that absorbs one
//! word at a time; each draw is an independent function of its coordinates.

/// Mixes one word into a state.
#[inline]
pub fn mix(state: u64, word: u64) -> u64 {
    let mut z = state ^ word.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// A stream of random numbers named by a seed and labels; used where a sequence is drawn in a fixed order, such as a
/// scene's parameters.
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
    index: u64,
}

impl Stream {
    /// The stream of `seed` and `labels`.
    pub fn new(seed: u64, labels: &[u64]) -> Self {
        let state = labels.iter().fold(mix(0x7461_7566_6C6F_7731, seed), |state, label| mix(state, *label));
        Self { state, index: 0 }
    }

    /// A stream of its own for a part, so that a draw more in one part leaves the others as they are.
    pub fn part(&self, label: &str) -> Self {
        let state = label.bytes().fold(mix(self.state, label.len() as u64), |state, byte| mix(state, u64::from(byte)));
        Self { state, index: 0 }
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.index += 1;
        mix(self.state, self.index)
    }

    /// Uniform in [0, 1), with 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform over 0..n; n must not be 0.
    pub fn below(&mut self, n: usize) -> usize {
        // 2^64 / n is so large that the bias of the multiply-shift is below 2^-50 for every n in use.
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.uniform() < p
    }

    /// A pick; the slice must not be empty.
    pub fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.below(from.len())]
    }

    /// A standard normal number (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        radius * libm::cos(2.0 * core::f64::consts::PI * self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_has_the_right_moments_and_streams_differ() {
        let mut stream = Stream::new(7, &[1, 2]);
        let draws: Vec<f64> = (0..100_000).map(|_| stream.uniform()).collect();
        let mean = draws.iter().sum::<f64>() / 1e5;
        let variance = draws.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / 1e5;
        // Standard errors are 9e-4 and 2.4e-4; five of them.
        assert!((mean - 0.5).abs() < 4.6e-3, "{mean}");
        assert!((variance - 1.0 / 12.0).abs() < 1.2e-3, "{variance}");
        assert_ne!(Stream::new(7, &[1]).bits(), Stream::new(7, &[2]).bits());
        assert_ne!(stream.part("a").bits(), stream.part("b").bits());
    }
}
