//! Sums whose order depends on shapes alone.

use crate::instructions::wide;

/// Rows that are summed in f32 before they go into the total in f64.
const RUN: usize = 64;

/// Sums of each column of rows of `columns` values.
pub(crate) fn columns(data: &[f32], columns: usize) -> Vec<f32> {
    let sums = wide(
        #[inline(always)]
        || by_column(data, columns, |_, value| value),
    );
    sums.into_iter().map(|v| v as f32).collect()
}

/// Sums of `f(column, value)` over the rows.
#[inline(always)]
pub(crate) fn by_column(data: &[f32], columns: usize, f: impl Fn(usize, f32) -> f32) -> Vec<f64> {
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
