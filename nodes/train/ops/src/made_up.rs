//! Numbers for tests.

/// Numbers between -1 and 1 (Knuth's multiplicative generator).
pub(crate) fn numbers(seed: u64, size: usize) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..size).map(|_| next()).collect()
}
