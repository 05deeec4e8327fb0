//! Sums whose order depends on shapes alone.

use crate::instructions::wide;
use rayon::prelude::*;

/// Rows of a band.
pub(crate) const BAND: usize = 512;
/// Rows that are summed in f32 before they go into the total in f64.
const RUN: usize = 64;

/// Sums of each column of rows of `columns` values.
pub(crate) fn columns(data: &[f32], columns: usize) -> Vec<f32> {
    all(data, columns, |_, value| value).into_iter().map(|v| v as f32).collect()
}

/// Sums of `f(column, value)` over the rows: over bands of them side by side, and over the bands in their order.
pub(crate) fn all(data: &[f32], columns: usize, f: impl Fn(usize, f32) -> f32 + Sync) -> Vec<f64> {
    assert!(data.len().is_multiple_of(columns), "whole rows");
    let bands = data.par_chunks(BAND * columns).map(|band| {
        wide(
            #[inline(always)]
            || by_column(band, columns, &f),
        )
    });
    added(bands.collect(), columns)
}

/// The sum of rows of so many values, in their order.
pub(crate) fn added(rows: Vec<Vec<f64>>, columns: usize) -> Vec<f64> {
    let mut total = vec![0.0; columns];
    rows.into_iter().for_each(|row| total.iter_mut().zip(row).for_each(|(total, value)| *total += value));
    total
}

/// Sums of `f(column, value)` over the rows.
#[inline(always)]
fn by_column(data: &[f32], columns: usize, f: impl Fn(usize, f32) -> f32) -> Vec<f64> {
    let mut total = vec![0.0f64; columns];
    let mut run = vec![0.0f32; columns];
    for rows in data.chunks(RUN * columns) {
        run.fill(0.0);
        for row in rows.chunks_exact(columns) {
            for (column, (run, value)) in run.iter_mut().zip(row).enumerate() {
                *run += f(column, *value);
            }
        }
        for (total, run) in total.iter_mut().zip(&run) {
            *total += f64::from(*run);
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_sums_keep_their_small_parts() {
        let data: Vec<f32> = (0..200_000).map(|i| if i % 2 == 0 { 0.1 } else { 1.0 }).collect();
        let sums = columns(&data, 2);
        assert!((sums[0] - 10_000.0).abs() < 0.01 && sums[1] == 100_000.0, "{sums:?}");
    }
}
