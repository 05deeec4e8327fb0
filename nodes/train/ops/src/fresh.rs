//! Vectors that are written once: filling large ones with zeros first costs as much as some operators.

#![expect(unsafe_code, reason = "numbers that are not written yet; callers promise to write them")]

use std::mem::MaybeUninit;

/// A vector of numbers, all of which `fill` writes.
///
/// # Safety
/// `fill` must write every number of its slice.
pub(crate) unsafe fn filled(len: usize, fill: impl FnOnce(&mut [MaybeUninit<f32>])) -> Vec<f32> {
    let mut values = Vec::with_capacity(len);
    let free = &mut values.spare_capacity_mut()[..len];
    if cfg!(test) {
        free.fill(MaybeUninit::new(f32::from_bits(UNWRITTEN)));
    }
    fill(free);
    // SAFETY: there is room for so many, and the caller promises that all are written.
    unsafe { values.set_len(len) };
    if cfg!(test) {
        assert!(values.iter().all(|value: &f32| value.to_bits() != UNWRITTEN), "all numbers are written");
    }
    values
}

/// In tests, what unwritten numbers are: a NaN that no arithmetic gives.
const UNWRITTEN: u32 = 0x7fc0_dead;

/// Numbers as numbers that may be missing.
///
/// # Safety
/// Nothing but numbers may be written to them.
pub(crate) unsafe fn maybe(values: &mut [f32]) -> &mut [MaybeUninit<f32>] {
    // SAFETY: the same layout, and the caller's promise.
    unsafe { &mut *(std::ptr::from_mut(values) as *mut [MaybeUninit<f32>]) }
}
