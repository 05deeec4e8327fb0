//! Arithmetic throughput of convolutions on one thread, GFLOP/s and as a share of what a loop of nothing but fused
//! products reaches on this processor. Both ways to convolve count the products of the definition, so that minimal
//! filtering exceeds 100%.
//!
//! ```text
//! cargo run --release -p tauflow-ops --example throughput
//! ```

#![expect(clippy::disallowed_methods, reason = "it measures")]
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "calls functions for instructions that were detected")
)]
#![expect(clippy::needless_range_loop, reason = "references would keep the sums in memory")]

use std::{hint::black_box, time::Instant};
use tauflow_ops::{Conv3, Convolutions, Instructions, Operator};

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Shortest time of some runs, in seconds.
fn shortest<T>(mut f: impl FnMut() -> T) -> f64 {
    (0..15)
        .map(|_| {
            let start = Instant::now();
            black_box(f());
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

/// GFLOP/s of independent chains of fused products in registers.
fn peak() -> f64 {
    const TIMES: usize = 2_000_000;
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;
        #[target_feature(enable = "avx512f")]
        fn wide() -> f32 {
            let (a, b) = (_mm512_set1_ps(black_box(0.999)), _mm512_set1_ps(black_box(0.001)));
            let mut sums = [_mm512_setzero_ps(); 24];
            for _ in 0..TIMES {
                for i in 0..24 {
                    sums[i] = _mm512_fmadd_ps(a, b, sums[i]);
                }
            }
            let mut total = _mm512_setzero_ps();
            for i in 0..24 {
                total = _mm512_add_ps(total, sums[i]);
            }
            _mm512_reduce_add_ps(total)
        }
        #[target_feature(enable = "avx2,fma")]
        fn narrow() -> f32 {
            let (a, b) = (_mm256_set1_ps(black_box(0.999)), _mm256_set1_ps(black_box(0.001)));
            let mut sums = [_mm256_setzero_ps(); 12];
            for _ in 0..TIMES {
                for i in 0..12 {
                    sums[i] = _mm256_fmadd_ps(a, b, sums[i]);
                }
            }
            let mut total = _mm256_setzero_ps();
            for i in 0..12 {
                total = _mm256_add_ps(total, sums[i]);
            }
            _mm_cvtss_f32(_mm256_castps256_ps128(total))
        }
        match Instructions::best() {
            // SAFETY: the processor has the instructions.
            Instructions::Avx512 => return (TIMES * 24 * 32) as f64 / shortest(|| unsafe { wide() }) / 1e9,
            // SAFETY: the processor has the instructions.
            Instructions::Avx2 => return (TIMES * 12 * 16) as f64 / shortest(|| unsafe { narrow() }) / 1e9,
            Instructions::Sse2 | Instructions::Portable => {}
        }
    }
    f64::NAN
}

/// Images, side, inputs and outputs.
const SHAPES: [[usize; 4]; 18] = [
    [8, 32, 36, 32],
    [8, 32, 32, 32],
    [8, 16, 64, 64],
    [8, 8, 96, 96],
    [4, 32, 48, 48],
    [4, 16, 96, 96],
    [4, 8, 160, 160],
    [4, 16, 192, 192],
    [4, 8, 384, 384],
    [1, 256, 28, 40],
    [1, 256, 40, 40],
    [1, 256, 40, 244],
    [1, 128, 80, 80],
    [1, 64, 96, 96],
    [1, 32, 144, 144],
    [1, 128, 48, 48],
    [1, 128, 96, 96],
    [1, 32, 384, 384],
];

fn measure([images, side, inputs, outputs]: [usize; 4], convolutions: Convolutions, peak: f64) {
    let instructions = Instructions::best();
    let conv = Conv3 { height: side, width: side, inputs, outputs, convolutions, instructions };
    let pixels = images * side * side;
    let fill = |size: usize| (0..size).map(|i| (i % 17) as f32 - 8.0).collect::<Vec<_>>();
    let (x, kernel, bias) = (fill(pixels * inputs), fill(9 * inputs * outputs), fill(outputs));
    let gradient = fill(pixels * outputs);
    let work = (2 * 9 * pixels * inputs * outputs) as f64 / 1e9;
    let inputs_of = [&x[..], &kernel, &bias];
    let told = |seconds: f64| format!("{:6.1} ({:3.0}%)", work / seconds, 100.0 * work / seconds / peak);
    let forward = shortest(|| conv.forward(inputs_of));
    let of_x = shortest(|| conv.backward(inputs_of, &(), &gradient, [true, false, false]));
    let of_kernel = shortest(|| conv.backward(inputs_of, &(), &gradient, [false, true, false]));
    println!(
        "{images} x {side:3} x {side:3}, {inputs:3} -> {outputs:3}, {:7}: forward {}, input {}, kernel {}",
        format!("{convolutions:?}").to_lowercase(),
        told(forward),
        told(of_x),
        told(of_kernel)
    );
}

fn main() -> Result<(), rayon::ThreadPoolBuildError> {
    tauflow_ops::keep_memory();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| {
        let peak = peak();
        println!("fused products alone: {peak:.0} GFLOP/s with {:?}", Instructions::best());
        for shape in SHAPES {
            for convolutions in [Convolutions::Direct, Convolutions::Minimal] {
                measure(shape, convolutions, peak);
            }
        }
    });
    Ok(())
}
