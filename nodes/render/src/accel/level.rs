//! The two levels of a hierarchy: the world's tree, some of whose leaves are placed meshes, and the trees of these,
//! which have none.
//!
//! Kernels are generic over the level that they traverse, so that each is one straight function. A ray in a mesh's
//! space has the distances of the ray in the world but for a power of two, so that hits compare without rounding.

use super::{
    Accel,
    best::Best,
    packet::{Packet, PacketHits},
    set::{Set, Sweep},
};
use crate::{geometry::Walk, lanes::Real};

/// The action at a placed mesh.
pub(super) trait Level {
    /// Whether there are any.
    const HAS_PLACED: bool;

    /// One ray's nearest hit.
    fn closest<T: Real>(accel: &Accel, which: u32, walk: &Walk, best: &mut Best, stack: &mut [(u32, f32)]);

    /// Whether one ray meets anything.
    fn occluded<T: Real>(accel: &Accel, which: u32, walk: &Walk, t_max: f32, stack: &mut [(u32, f32)]) -> bool;

    /// A list of rays.
    fn sweep<R: Real, T: Real, const ANY: bool>(
        accel: &Accel,
        which: u32,
        list: &[u32],
        set: &mut Set<'_>,
        memory: &mut Sweep,
    );

    /// Rays that go nearly the same way.
    fn packet<R: Real, T: Real>(
        accel: &Accel,
        which: u32,
        rays: &Packet<R>,
        mask: R::Mask,
        best: &mut PacketHits<R>,
        stack: &mut [(u32, f32)],
    );
}

/// The world's tree.
pub(super) struct WorldTree;

/// The tree of a placed mesh.
pub(super) struct MeshTree;
