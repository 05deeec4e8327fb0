//! As many rays as there are lanes that go nearly the same way, as those of one pixel do.

use super::{SPARE, safe};
use crate::{
    geometry::{Ray, Rays, Walk},
    lanes::{Mask, Real, Triple},
};

/// Hits by lane; a primitive of -1 is none.
pub(crate) struct PacketHits<R: Real> {
    pub(crate) t: R,
    pub(crate) u: R,
    pub(crate) v: R,
    pub(crate) primitive: R::Integer,
}

/// Rays by lane, without end, and what all have in common.
pub(crate) struct Packet<R: Real> {
    pub(super) origin: Triple<R>,
    pub(super) direction: Triple<R>,
    pub(super) inverse: Triple<R>,
    pub(super) near: [usize; 3],
    pub(super) axes: [usize; 3],
    pub(super) shear: [R; 3],
}

#[inline(always)]
pub(super) fn axis<R: Real>(v: &Triple<R>, axis: usize) -> R {
    match axis {
        0 => v.x,
        1 => v.y,
        _ => v.z,
    }
}

/// 0 if no lane of `all` is in a mask, 1 if all are.
#[inline(always)]
fn side(mask: u32, all: u32) -> Option<usize> {
    match mask & all {
        0 => Some(0),
        some if some == all => Some(1),
        _ => None,
    }
}

impl<R: Real> Packet<R> {
    /// `None` if the rays of the mask differ in the signs of their directions or in the longest axis.
    #[inline(always)]
    pub(crate) fn new(origin: Triple<R>, direction: Triple<R>, mask: R::Mask) -> Option<Self> {
        let zero = R::zero();
        let size = direction.abs();
        let all = mask.bits();
        // As a single ray's walk has it: the signs of reciprocals, which those of -0 are part of.
        let one = R::one();
        let negative = [
            one.copysign(direction.x).lt(zero).bits(),
            one.copysign(direction.y).lt(zero).bits(),
            one.copysign(direction.z).lt(zero).bits(),
        ];
        let signs = [side(negative[0], all)?, side(negative[1], all)?, side(negative[2], all)?];
        let xy = side(size.x.gt(size.y).bits(), all)?;
        let xz = side(size.x.gt(size.z).bits(), all)?;
        let yz = side(size.y.gt(size.z).bits(), all)?;
        let kz = match (xy, xz, yz) {
            (1, 1, _) => 0,
            (1, 0, _) => 2,
            (_, _, 1) => 1,
            _ => 2,
        };
        let mut kx = (kz + 1) % 3;
        let mut ky = (kx + 1) % 3;
        let longest = axis(&direction, kz);
        if side(longest.lt(zero).bits(), all)? == 1 {
            std::mem::swap(&mut kx, &mut ky);
        }
        Some(Self {
            origin,
            direction,
            inverse: Triple::new(safe(direction.x), safe(direction.y), safe(direction.z)),
            near: [signs[0], 2 + signs[1], 4 + signs[2]],
            axes: [kx, ky, kz],
            shear: [axis(&direction, kx) / longest, axis(&direction, ky) / longest, one / longest],
        })
    }

    /// The rays by component.
    #[inline(always)]
    pub(super) fn rows(&self) -> Rays<SPARE> {
        let mut own = Rays { origin: [[0.0; SPARE]; 3], direction: [[0.0; SPARE]; 3] };
        let (o, d) = (self.origin, self.direction);
        for (axis, (o, d)) in [(o.x, d.x), (o.y, d.y), (o.z, d.z)].into_iter().enumerate() {
            o.store(&mut own.origin[axis]);
            d.store(&mut own.direction[axis]);
        }
        own
    }

    /// The ray of one lane.
    pub(super) fn walk(&self, lane: usize) -> Walk {
        Walk::new(&Ray::new(self.origin.lane(lane), self.direction.lane(lane)))
    }
}
