//! Leaves: four or eight primitives each, side by side.

use super::{CURVED, NONE, WIDE};
use crate::{
    geometry::{EIGHT, FOUR, Triangles},
    lanes::{Record, ask_for},
    pages::{moved, settled},
};

/// A flag in the place of a block that has room for [`FEW`] primitives only. About two thirds of the leaves of large
/// meshes need no more.
const NARROW: u32 = 1 << 29;
/// Primitives of narrow blocks.
const FEW: usize = 4;
/// Numbers in a line of the cache.
const LINE: usize = 16;
/// Numbers for each primitive: three coordinates of three vertices, and which primitive it is.
const ROWS: usize = 10;
/// Turns whole numbers into bits of floating-point numbers that are not tiny: lanes that are not used read them, too,
/// and calculations with tiny numbers are slow.
const PLAIN: u32 = 0x4000_0000;

/// Blocks one after another, each from the beginning of a line of the cache. A block has a row of each vertex and axis,
/// and a row of primitives.
#[derive(Default)]
pub(super) struct Blocks {
    lines: Vec<Record>,
    /// Places of the blocks that have curved primitives.
    with_curved: Vec<u32>,
    /// Whether there is room for about as many as there will be.
    reserved: bool,
}

/// Up to four or eight primitives, curved ones first. Rows of triangles hold NaN for what is curved, and in lanes that
/// are not used.
#[derive(Clone, Copy)]
pub(super) struct Block<'a, const LEN: usize> {
    pub(super) triangles: Triangles<'a, LEN>,
}

/// A block of either width.
pub(super) enum AnyBlock<'a> {
    Narrow(Block<'a, FOUR>),
    Wide(Block<'a, EIGHT>),
}

impl Blocks {
    /// Adds the blocks of a piece, whose curved primitives have places from `curved` on. Returns how much larger their
    /// places are. The first place is that of an empty block: lanes of nodes that are not used have it.
    pub(super) fn append(&mut self, mut piece: Self, curved: u32) -> u32 {
        if self.lines.is_empty() {
            self.push(&[], &[], false);
        }
        let from = self.lines.len() as u32;
        for place in &piece.with_curved {
            let (rows, last) = if place & NARROW == 0 { (9 * WIDE, WIDE) } else { (9 * FEW, FEW) };
            let numbers: &mut [f32] = bytemuck::cast_slice_mut(&mut piece.lines[(place & !NARROW) as usize..]);
            for number in &mut numbers[rows..rows + last] {
                let primitive = number.to_bits() ^ PLAIN;
                if primitive != NONE && primitive & CURVED != 0 {
                    *number = f32::from_bits((primitive + curved) ^ PLAIN);
                }
            }
        }
        self.lines.append(&mut piece.lines);
        from
    }

    /// Adds a block of at most eight primitives, curved ones first; a small one where that is asked for and enough.
    /// Returns its place.
    pub(super) fn push(&mut self, primitives: &[u32], vertices: &[[[f32; 3]; 3]], small: bool) -> u32 {
        let (width, narrow) = if small && primitives.len() <= FEW { (FEW, NARROW) } else { (WIDE, 0) };
        let mut numbers = [f32::NAN; WIDE * ROWS];
        let (rows, last) = numbers.split_at_mut(9 * width);
        for (lane, of) in vertices.iter().enumerate() {
            for (at, coordinate) in of.as_flattened().iter().enumerate() {
                rows[at * width + lane] = *coordinate;
            }
        }
        for (lane, number) in last[..width].iter_mut().enumerate() {
            *number = f32::from_bits(primitives.get(lane).unwrap_or(&NONE) ^ PLAIN);
        }
        let place = self.lines.len() as u32;
        debug_assert!(place < NARROW);
        for part in numbers[..width * ROWS].chunks(LINE) {
            let mut line = Record::default();
            line.0[..part.len()].copy_from_slice(part);
            self.lines.push(line);
        }
        if primitives.first().is_some_and(|first| first & CURVED != 0) {
            self.with_curved.push(place | narrow);
        }
        place | narrow
    }

    /// Lines so far.
    pub(super) fn len(&self) -> usize {
        self.lines.len()
    }

    /// Makes room for so many lines in all, if there is so much memory.
    pub(super) fn reserve(&mut self, lines: usize) {
        if lines > self.lines.capacity()
            && let Some(own) = moved(&self.lines, lines)
        {
            (self.lines, self.reserved) = (own, true);
        }
    }

    /// Lets go of room that is not used, if that is much, and asks for large pages.
    pub(super) fn finish(&mut self) {
        let used = self.lines.len();
        if !self.reserved || used + used / 3 < self.lines.capacity() {
            self.lines = settled(std::mem::take(&mut self.lines));
        }
    }

    /// Bytes of all blocks.
    pub(super) fn bytes(&self) -> usize {
        self.lines.len() * size_of::<Record>()
    }

    /// The block at a place.
    #[inline(always)]
    pub(super) fn at(&self, place: u32) -> AnyBlock<'_> {
        let numbers: &[f32] = bytemuck::cast_slice(&self.lines);
        let numbers = numbers.get(LINE * (place & !NARROW) as usize..).unwrap_or_default();
        if place & NARROW == 0 {
            AnyBlock::Wide(Block { triangles: Triangles(numbers.first_chunk().unwrap_or(&[f32::NAN; EIGHT])) })
        } else {
            AnyBlock::Narrow(Block { triangles: Triangles(numbers.first_chunk().unwrap_or(&[f32::NAN; FOUR])) })
        }
    }

    /// Asks the memory for the block at a place.
    #[inline(always)]
    pub(super) fn ask_for(&self, place: u32) {
        let (from, lines) = ((place & !NARROW) as usize, if place & NARROW == 0 { 5 } else { 3 });
        for line in 0..lines {
            ask_for(&self.lines, from + line);
        }
    }
}

impl<const LEN: usize> Block<'_, LEN> {
    /// Lanes that it has.
    pub(super) const WIDTH: usize = Triangles::<'_, LEN>::COUNT;

    /// Bits of its lanes; those beyond mean nothing.
    pub(super) const LANES: u32 = (1 << Self::WIDTH) - 1;

    /// A primitive; with [`CURVED`], a place in [`super::Accel::curved`]; [`NONE`] in lanes that are not used.
    #[inline(always)]
    pub(super) fn primitive(&self, lane: usize) -> u32 {
        self.triangles.row(3, 0, lane)[0].to_bits() ^ PLAIN
    }

    /// The place in [`super::Accel::curved`] of a primitive that is curved.
    #[inline(always)]
    pub(super) fn curved(&self, lane: usize) -> Option<usize> {
        if lane >= Self::WIDTH {
            return None;
        }
        let place = self.primitive(lane);
        if place != NONE && place & CURVED != 0 { Some((place & !CURVED) as usize) } else { None }
    }

    /// Whether anything in it is curved: that comes first.
    #[inline(always)]
    pub(super) fn has_curved(&self) -> bool {
        self.primitive(0) & CURVED != 0
    }
}
