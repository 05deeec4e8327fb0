//! Large tables in large pages of memory.
//!
//! A processor finds the pages of about ten megabytes of memory without delay, if pages have four kilobytes. Rays that
//! have little in common read tables of a hundred megabytes, and wait for the addresses of pages as well as for what is
//! in them.

/// Bytes of tables for which large pages are asked: several of the two megabytes that a page then has.
const LARGE: usize = 8 << 20;

/// The same numbers without room to spare; in large pages, if they fill some and the system has such pages.
pub(crate) fn settled<T: Copy>(mut numbers: Vec<T>) -> Vec<T> {
    if size_of_val(&numbers[..]) >= LARGE
        && let Some(own) = moved(&numbers, numbers.len())
    {
        return own;
    }
    numbers.shrink_to_fit();
    numbers
}

/// The same numbers, with room for `count` in all, in large pages as [`settled`]. `None` if memory is lacking.
pub(crate) fn moved<T: Copy>(numbers: &[T], count: usize) -> Option<Vec<T>> {
    let mut own = Vec::new();
    own.try_reserve_exact(count.max(numbers.len())).ok()?;
    if size_of_val(own.spare_capacity_mut()) >= LARGE {
        ask_for_large_pages(own.spare_capacity_mut());
    }
    own.extend_from_slice(numbers);
    Some(own)
}

/// Asks the system for large pages. It is free to refuse.
#[cfg(target_os = "linux")]
#[expect(unsafe_code, reason = "the system is asked by a foreign function")]
fn ask_for_large_pages<T>(room: &mut [std::mem::MaybeUninit<T>]) {
    const PAGE: usize = 4096;
    let from = room.as_mut_ptr().cast::<u8>();
    let before = from.align_offset(PAGE);
    let bytes = size_of_val(room).saturating_sub(before) / PAGE * PAGE;
    // SAFETY: whole pages within the slice; the advice changes nothing that is in them.
    unsafe { libc::madvise(from.wrapping_add(before).cast(), bytes, libc::MADV_HUGEPAGE) };
}

#[cfg(not(target_os = "linux"))]
fn ask_for_large_pages<T>(_: &mut [std::mem::MaybeUninit<T>]) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stay_what_they_are() {
        for count in [0, 5, LARGE / 8 - 1, LARGE / 8, LARGE / 8 + 777] {
            let mut numbers: Vec<u64> = Vec::with_capacity(2 * count);
            numbers.extend((0..count as u64).map(|at| at * at));
            let settled = settled(numbers);
            assert_eq!(settled.len(), count);
            assert!(settled.iter().enumerate().all(|(at, number)| *number == (at * at) as u64));
        }
    }
}
