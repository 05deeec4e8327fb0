//! Two products of matrices, of which everything else is made, on one thread.
//!
//! Rows of the left matrix may overlap. A row of an image with C channels, read from every pixel on for 3 C numbers, is
//! a matrix of the patches of three pixels side by side. A convolution therefore needs no unfolding.
//!
//! Every number of a result is summed one product after the other, from the first on, each product fused with the sum
//! before it; panels, tiles and lanes decide only which results are worked on side by side.

#![expect(unsafe_code, reason = "kernels by pointers; sizes are checked before they are called")]

mod kernels;

use crate::{fresh::maybe, instructions::Instructions};
use kernels::{Outer, Product, kernels};
use std::mem::MaybeUninit;

/// Columns of a unit; a panel has one to [`MOST`] units.
const UNIT: usize = 16;
const MOST: usize = 3;
/// Rows of a panel that are worked on at once: they stay in the first cache.
const DEPTH: usize = 160;

/// Rows of a left matrix and the rows that they meet: of the result in [`add_products`], of the right matrix in
/// [`add_outer_products`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    /// Where in the left data the first row starts.
    pub(crate) left: usize,
    /// Where in the other data the first row starts.
    pub(crate) other: usize,
    /// How many rows.
    pub(crate) rows: usize,
}

/// The left matrix: rows of which one starts `stride` numbers after the other.
#[derive(Clone, Copy)]
pub(crate) struct Left<'a> {
    pub(crate) data: &'a [f32],
    pub(crate) stride: usize,
}

impl Left<'_> {
    /// Panics unless all rows of the runs have `columns` numbers, and `other` holds as many rows of `width`.
    fn check(&self, runs: &[Run], columns: usize, other: usize, width: usize) {
        for run in runs.iter().filter(|run| run.rows > 0) {
            let end = |from: usize, rows: usize, stride: usize, last: usize| {
                rows.checked_mul(stride)?.checked_add(from)?.checked_add(last)
            };
            let left = end(run.left, run.rows - 1, self.stride, columns);
            assert!(left.is_some_and(|end| end <= self.data.len()), "the left matrix has the rows of {run:?}");
            let there = end(run.other, run.rows, width, 0);
            assert!(there.is_some_and(|end| end <= other), "the other matrix has the rows of {run:?}");
        }
    }
}

/// Columns that are worked on together.
#[derive(Clone, Copy)]
struct Panel {
    first: usize,
    units: usize,
}

impl Panel {
    fn width(self) -> usize {
        self.units * UNIT
    }

    /// So many columns in panels as even as they can be.
    fn all(columns: usize) -> impl Iterator<Item = Self> {
        let units = columns.div_ceil(UNIT);
        let count = units.div_ceil(MOST);
        (0..count).map(move |i| {
            let (from, to) = (i * units / count, (i + 1) * units / count);
            Self { first: from * UNIT, units: to - from }
        })
    }
}

/// The right matrix of a product, [depth, columns]: each panel's rows one after the other, zeros beyond the last
/// column.
pub(crate) struct Packed {
    depth: usize,
    columns: usize,
    data: Vec<f32>,
}

impl Packed {
    /// Packs a matrix of which row `i` starts at `row(i)` of `data`, and whose columns are `stride` apart.
    pub(crate) fn new(
        (depth, columns): (usize, usize),
        data: &[f32],
        row: impl Fn(usize) -> usize,
        stride: usize,
    ) -> Self {
        let extent = (0..depth).map(|i| row(i) + (columns - 1) * stride + 1).max().unwrap_or(0);
        assert!(extent <= data.len(), "the matrix is as large as it should be");
        let mut packed = vec![0.0; depth * columns.next_multiple_of(UNIT)];
        for panel in Panel::all(columns) {
            let there = panel.width().min(columns - panel.first);
            for (i, to) in packed[depth * panel.first..].chunks_exact_mut(panel.width()).take(depth).enumerate() {
                let from = &data[row(i) + panel.first * stride..];
                if stride == 1 {
                    to[..there].copy_from_slice(&from[..there]);
                } else {
                    to[..there].iter_mut().zip(from.iter().step_by(stride)).for_each(|(to, from)| *to = *from);
                }
            }
        }
        Self { depth, columns, data: packed }
    }

    /// A matrix of one panel, [depth, columns], whose rows already lie one after the other.
    pub(crate) fn of_panel((depth, columns): (usize, usize), data: Vec<f32>) -> Self {
        assert!(columns.is_multiple_of(UNIT) && columns <= MOST * UNIT, "one panel of whole units");
        assert_eq!(data.len(), depth * columns, "the matrix is as large as it should be");
        Self { depth, columns, data }
    }
}

/// The initial value of the sums.
#[derive(Clone, Copy)]
pub(crate) enum Start<'a> {
    /// A row of as many numbers as the result has columns.
    Row(&'a [f32]),
    /// The initial content of the result.
    There,
}

/// Adds to rows of `out`, [.., columns], the products of left rows with rows `first..first + depth` of `right`.
///
/// # Safety
/// If sums start with what is there, the rows of `out` must have been written.
pub(crate) unsafe fn add_products(
    (out, start): (&mut [MaybeUninit<f32>], Start<'_>),
    left: Left<'_>,
    right: &Packed,
    (first, depth): (usize, usize),
    runs: &[Run],
    instructions: Instructions,
) {
    assert!(first + depth <= right.depth, "the right matrix has these rows");
    if let Start::Row(row) = start {
        assert!(row.len() == right.columns && depth > 0, "a start for each column");
    }
    left.check(runs, depth, out.len(), right.columns);
    let parts = depth.div_ceil(DEPTH);
    let mut ragged = Vec::new();
    for panel in Panel::all(right.columns) {
        let (kernel, width) = (kernels(instructions).product[panel.units - 1], panel.width());
        let packed = &right.data[right.depth * panel.first..][..right.depth * width];
        let there = width.min(right.columns - panel.first);
        let row = match start {
            Start::Row(row) => Some(&row[panel.first..][..there]),
            Start::There => None,
        };
        for part in 0..parts {
            let (from, to) = (part * depth / parts, (part + 1) * depth / parts);
            let packed = &packed[(first + from) * width..(first + to) * width];
            // Only the first part starts anew.
            let row = row.filter(|_| part == 0);
            for run in runs {
                let mut product = Product {
                    left: &left.data[run.left + from..],
                    left_stride: left.stride,
                    right: packed,
                    depth: to - from,
                    start: row,
                    out: &mut out[run.other + panel.first..],
                    out_stride: right.columns,
                    rows: run.rows,
                };
                if there == width {
                    // SAFETY: left rows of `depth` and result rows are there, `check` has seen to it; the panel lies
                    // within the result's columns; the caller promises what is read to be written; `kernels` gives what
                    // the processor has.
                    unsafe { kernel(&mut product) };
                    continue;
                }
                // A last panel that is wider than what is left of the result: worked on beside it.
                ragged.clear();
                ragged.resize(run.rows * width, 0.0);
                let rows = run.rows;
                for (i, beside) in ragged.chunks_exact_mut(width).enumerate() {
                    let before = &product.out[i * right.columns..][..there];
                    match row {
                        Some(row) => beside[..there].copy_from_slice(row),
                        None => beside[..there].iter_mut().zip(before).for_each(|(to, v)| {
                            // SAFETY: the caller promises that they were written.
                            *to = unsafe { v.assume_init() };
                        }),
                    }
                }
                // SAFETY: as above, with room for whole panels; kernels write numbers.
                unsafe {
                    let out = maybe(&mut ragged);
                    kernel(&mut Product { start: None, out, out_stride: width, ..product });
                }
                for (i, row) in ragged.chunks_exact(width).take(rows).enumerate() {
                    let to = &mut out[run.other + panel.first + i * right.columns..][..there];
                    to.iter_mut().zip(row).for_each(|(to, v)| _ = to.write(*v));
                }
            }
        }
    }
}

/// Adds to `out`, [depth, columns], the sums over the rows of the runs of left row times right row: what left columns
/// `from..from + depth` have in common with those of `right`, [.., columns], a multiple of 16. No run may be empty.
pub(crate) fn add_outer_products(
    out: &mut [f32],
    left: Left<'_>,
    from: usize,
    (right, columns): (&[f32], usize),
    runs: &[Run],
    instructions: Instructions,
) {
    assert!(columns > 0 && columns.is_multiple_of(UNIT), "columns come in units");
    let depth = out.len() / columns;
    assert_eq!(out.len(), depth * columns, "rows are whole");
    assert!(runs.iter().all(|run| run.rows > 0), "runs have rows");
    left.check(runs, from + depth, right.len(), columns);
    for panel in Panel::all(columns) {
        let mut outer = Outer {
            left: &left.data[from.min(left.data.len())..],
            left_stride: left.stride,
            right: &right[panel.first.min(right.len())..],
            columns,
            runs,
            out: &mut out[panel.first..],
            depth,
        };
        // SAFETY: the rows of the runs are there, `check` has seen to it; the panel lies within the columns; `kernels`
        // gives what the processor has.
        unsafe { kernels(instructions).outer[panel.units - 1](&mut outer) };
    }
}
