//! Vectors that are written once: filling large ones with zeros first costs as much as some operators.

use std::mem::MaybeUninit;

/// A vector of numbers, all of which `fill` writes.
///
/// # Safety
/// `fill` must write every number of its slice.
pub(crate) unsafe fn filled(len: usize, fill: impl FnOnce(&mut [MaybeUninit<f32>])) -> Vec<f32> {
    let mut values = Vec::with_capacity(len);
    fill(&mut values.spare_capacity_mut()[..len]);
    // SAFETY: there is room for so many, and the caller promises that all are written.
    unsafe { values.set_len(len) };
    values
}

/// Numbers as numbers that may be missing.
pub(crate) fn maybe(values: &mut [f32]) -> &mut [MaybeUninit<f32>] {
    // SAFETY: the same layout; all who write to such slices write numbers.
    unsafe { &mut *(std::ptr::from_mut(values) as *mut [MaybeUninit<f32>]) }
}
