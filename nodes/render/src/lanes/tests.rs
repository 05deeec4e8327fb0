//! Every width has the bits of `f32`, and the functions are as exact as they say.

use super::*;
use tauflow_data::rng::Stream;
use tauflow_instructions::Instructions;
use tauflow_testing::{Need, skip};

#[test]
fn functions_are_within_a_few_units_in_the_last_place() {
    let mut worst = [0.0f64; 5];
    let mut stream = Stream::new(1, &[]);
    for i in 0..400_000 {
        let t = if i < 1000 { i as f32 / 1000.0 } else { stream.range(-2.0, 2.0) as f32 };
        let angle = f64::from(t) * std::f64::consts::TAU;
        let (sin, cos) = sin_cos_turn(t);
        worst[0] = worst[0].max((f64::from(sin) - libm::sin(angle)).abs());
        worst[1] = worst[1].max((f64::from(cos) - libm::cos(angle)).abs());
        let x = stream.range(-1.0, 1.0) as f32;
        worst[2] = worst[2].max((f64::from(acos(x)) - libm::acos(f64::from(x))).abs());
        let y = stream.range(-1.0, 1.0) as f32;
        worst[3] = worst[3].max((f64::from(atan2(y, x)) - libm::atan2(f64::from(y), f64::from(x))).abs());
        let e = stream.range(-30.0, 10.0) as f32;
        worst[4] = worst[4].max((f64::from(exp(e)) / libm::exp(f64::from(e)) - 1.0).abs());
    }
    println!("largest errors of sin, cos, acos, atan2, and of exp relative: {worst:?}");
    // Half a unit in the last place of 1 is 6e-8, of pi 1.2e-7.
    assert!(worst[0] < 3e-7 && worst[1] < 3e-7 && worst[2] < 5e-7 && worst[3] < 5e-7 && worst[4] < 4e-7, "{worst:?}");
    assert_eq!((acos(1.0f32), acos(2.0f32), atan2(0.0f32, 1.0), atan2(0.0f32, 0.0)), (0.0, 0.0, 0.0, 0.0));
    assert!((acos(-1.0f32) - std::f32::consts::PI).abs() < 1e-6 && exp(0.0f32) == 1.0);
}

/// Everything a lane can do, over numbers that include the odd ones.
#[inline(always)]
fn exercise<R: Real>(a: &[f32], b: &[f32], states: &[u64], table: &[f32]) -> Vec<u32> {
    let mut out = Vec::new();
    for at in (0..a.len()).step_by(R::N) {
        let (x, y) = (R::load(&a[at..]), R::load(&b[at..]));
        let (u, v) = R::draw(&states[at..], 5);
        let (sin, cos) = sin_cos_turn(u * 2.0 - v);
        let mask = x.lt(y) | (x.equals(y) & !x.finite());
        let index = (x * 3.0).to_integer().min(R::Integer::splat(40)).max(R::Integer::splat(0));
        let mixed = R::select(mask, x.floor().copysign(y), (x - y).abs().sqrt());
        let all = [
            x + y,
            x - y,
            x * y,
            x / y,
            x.min(y),
            x.max(y),
            mixed,
            sin,
            cos,
            acos(u - v),
            atan2(x, y),
            exp(u * 9.0 - 4.0),
            R::gather(table, index * R::Integer::splat(2) + R::Integer::splat(1)),
            R::of_integer(index),
            x.only(R::same(index, R::Integer::splat(3))),
            // Bits of numbers, and of whole numbers that records hold as such.
            R::of_integer(y.bits()),
        ];
        let mut rows = [[0.0f32; 16]; 16];
        for (row, value) in rows.iter_mut().zip(all) {
            value.store(row);
        }
        let mut squeezed = [0.0f32; 16];
        x.compress(mask, &mut squeezed);
        let mut kept = 0;
        for lane in 0..R::N {
            // What is no number may be so in several ways.
            out.extend(rows.iter().map(|row| if row[lane].is_nan() { 1 } else { row[lane].to_bits() }));
            if mask.bits() >> lane & 1 == 1 {
                assert_eq!(squeezed[kept].to_bits(), a[at + lane].to_bits());
                kept += 1;
            }
        }
        assert_eq!(R::Mask::from_bits(mask.bits()).bits(), mask.bits());
        // Records, written number by number and read back from the last on, which one index beyond means too.
        let mut records = [Record::default(); 16];
        for half in 0..2 {
            R::put_columns(std::array::from_fn(|k| all[k + half]), &mut records, half);
        }
        let back: [u32; 16] = std::array::from_fn(|lane| (R::N - lane.min(R::N)) as u32);
        let places = R::Integer::load(&back) * R::Integer::splat(2);
        for half in 0..2 {
            for (k, column) in
                R::columns(&records[..R::N], places + R::Integer::splat(half as i32)).into_iter().enumerate()
            {
                let mut row = [0.0f32; 16];
                column.store(&mut row);
                for (value, from) in row.iter().zip(back).take(R::N) {
                    // One beyond the last is its second half.
                    let half = if from as usize == R::N { 1 } else { half };
                    let put = rows[k + half][(from as usize).min(R::N - 1)];
                    assert!(value.to_bits() == put.to_bits() || (value.is_nan() && put.is_nan()));
                }
            }
        }
    }
    out
}

#[cfg(target_arch = "x86_64")]
#[test]
#[expect(unsafe_code, reason = "each is called where the processor has its instructions")]
fn every_width_has_the_bits_of_one_lane() {
    #[target_feature(enable = "avx2")]
    fn eight(a: &[f32], b: &[f32], states: &[u64], table: &[f32]) -> Vec<u32> {
        exercise::<F8>(a, b, states, table)
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    fn sixteen(a: &[f32], b: &[f32], states: &[u64], table: &[f32]) -> Vec<u32> {
        exercise::<F16>(a, b, states, table)
    }
    let mut stream = Stream::new(2, &[]);
    let odd = [0.0, -0.0, 1.0, -1.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1e-40, 1e38, 0.5, -2.5, 16.0];
    let mut draw = || {
        let pick = stream.below(40);
        odd.get(pick).copied().unwrap_or_else(|| stream.range(-20.0, 20.0) as f32)
    };
    let (a, b): (Vec<f32>, Vec<f32>) = (0..32_000).map(|_| (draw(), draw())).unzip();
    let states: Vec<u64> = (0..32_000u64).map(|i| tauflow_data::rng::mix(7, i)).collect();
    let table: Vec<f32> = (0..77).map(|i| i as f32 * 0.7).collect();
    let one = exercise::<f32>(&a, &b, &states, &table);
    assert!(exercise::<F4>(&a, &b, &states, &table) == one, "SSE2");
    if Instructions::most() >= Instructions::Avx2 {
        // SAFETY: the processor has them.
        assert!(unsafe { eight(&a, &b, &states, &table) } == one, "AVX2");
    } else {
        skip(Need::Avx2, "the processor has no AVX2");
    }
    if Instructions::most() >= Instructions::Avx512 {
        // SAFETY: the processor has them.
        assert!(unsafe { sixteen(&a, &b, &states, &table) } == one, "AVX-512");
    } else {
        skip(Need::Avx512, "the processor has no AVX-512");
    }
}
