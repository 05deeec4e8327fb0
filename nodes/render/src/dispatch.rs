//! Kernels for each set of instructions, and the choice among them at run time.
//!
//! Each kernel is a function of its own for each set of instructions; what it calls is inlined into it, and so made of
//! the same instructions. Hence no closures in kernels: those stay functions of their own, of the plain instructions,
//! which nothing can be inlined into.

use crate::{
    accel::{Accel, Set, Sweep},
    bsdf::{Interface, Sort},
    stream::{Group, Stream},
};
use tauflow_instructions::Instructions;

/// Kernels of these instructions, or of fewer if the processor lacks them.
pub(crate) fn kernels(instructions: Instructions) -> &'static Kernels {
    #[cfg(target_arch = "x86_64")]
    match instructions.min(Instructions::most()) {
        Instructions::Avx512 => &avx512::KERNELS,
        Instructions::Avx2 => &avx2::KERNELS,
        #[cfg(test)]
        Instructions::Portable => &portable::KERNELS,
        _ => &sse2::KERNELS,
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = instructions;
        &portable::KERNELS
    }
}

type StreamKernel = unsafe fn(&mut Stream<'_>);
type GroupKernel = unsafe fn(&mut Stream<'_>, &Group);
type SharesKernel = unsafe fn(&Interface<'_>, &[f32], &mut [f32]);
type SweepKernel = unsafe fn(&Accel, &mut Set<'_>, usize, &mut Sweep);

/// Functions compiled for one set of instructions.
pub(crate) struct Kernels {
    begin: StreamKernel,
    nearest: SweepKernel,
    stopped: SweepKernel,
    meet_packets: StreamKernel,
    miss: GroupKernel,
    vertices: GroupKernel,
    emit: GroupKernel,
    textures: GroupKernel,
    bodies: GroupKernel,
    normal_maps: GroupKernel,
    lights: GroupKernel,
    diffuse: GroupKernel,
    metal: GroupKernel,
    glass: GroupKernel,
    thin: GroupKernel,
    plastic: GroupKernel,
    principled: GroupKernel,
    blend: GroupKernel,
    shares: SharesKernel,
}

#[expect(
    unsafe_code,
    clippy::undocumented_unsafe_blocks,
    reason = "one invariant for all: `kernels` hands out only what the processor can run"
)]
impl Kernels {
    pub(crate) fn begin(&self, stream: &mut Stream<'_>) {
        unsafe { (self.begin)(stream) }
    }

    /// Nearest hits of rays.
    pub(crate) fn nearest(&self, accel: &Accel, set: &mut Set<'_>, count: usize, memory: &mut Sweep) {
        unsafe { (self.nearest)(accel, set, count, memory) }
    }

    /// Whether rays meet anything; those that do end below 0.
    pub(crate) fn stopped(&self, accel: &Accel, set: &mut Set<'_>, count: usize, memory: &mut Sweep) {
        unsafe { (self.stopped)(accel, set, count, memory) }
    }

    pub(crate) fn meet_packets(&self, stream: &mut Stream<'_>) {
        unsafe { (self.meet_packets)(stream) }
    }

    pub(crate) fn miss(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.miss)(stream, group) }
    }

    pub(crate) fn vertices(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.vertices)(stream, group) }
    }

    pub(crate) fn emit(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.emit)(stream, group) }
    }

    pub(crate) fn textures(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.textures)(stream, group) }
    }

    pub(crate) fn lights(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.lights)(stream, group) }
    }

    pub(crate) fn bodies(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.bodies)(stream, group) }
    }

    pub(crate) fn normal_maps(&self, stream: &mut Stream<'_>, group: &Group) {
        unsafe { (self.normal_maps)(stream, group) }
    }

    /// As [`Interface::shares`].
    pub(crate) fn shares(&self, interface: &Interface<'_>, cosines: &[f32], shares: &mut [f32]) {
        unsafe { (self.shares)(interface, cosines, shares) }
    }

    pub(crate) fn scatter(&self, sort: Sort, stream: &mut Stream<'_>, group: &Group) {
        let kernel = match sort {
            Sort::Diffuse => self.diffuse,
            Sort::Metal => self.metal,
            Sort::Glass => self.glass,
            Sort::Thin => self.thin,
            Sort::Plastic => self.plastic,
            Sort::Principled => self.principled,
            Sort::Blend => self.blend,
        };
        unsafe { kernel(stream, group) }
    }
}

macro_rules! kernels {
    ($name:ident, $wide:ty, $ray:ty $(, $feature:literal)?) => {
        mod $name {
            use super::{Accel, Group, Interface, Kernels, Set, Stream, Sweep};
            use crate::bsdf::{Blend, Diffuse, Glass, Metal, Plastic, Principled, Thin};

            pub(super) static KERNELS: Kernels = Kernels {
                begin,
                nearest,
                stopped,
                meet_packets,
                miss,
                vertices,
                emit,
                textures,
                bodies,
                normal_maps,
                lights,
                diffuse,
                metal,
                glass,
                thin,
                plastic,
                principled,
                blend,
                shares,
            };

            kernels!(@stream begin, begin::<$wide> $(, $feature)?);
            kernels!(@sweep nearest, false, $wide, $ray $(, $feature)?);
            kernels!(@sweep stopped, true, $wide, $ray $(, $feature)?);
            kernels!(@stream meet_packets, meet_packets::<$wide, $ray> $(, $feature)?);
            kernels!(@group miss, miss::<$wide> $(, $feature)?);
            kernels!(@group vertices, vertices::<$wide> $(, $feature)?);
            kernels!(@group emit, emit::<$wide> $(, $feature)?);
            kernels!(@group textures, textures::<$wide> $(, $feature)?);
            kernels!(@group bodies, bodies::<$wide> $(, $feature)?);
            kernels!(@group normal_maps, normal_maps::<$wide> $(, $feature)?);
            kernels!(@group lights, lights::<$wide> $(, $feature)?);
            kernels!(@group diffuse, scatter::<$wide, Diffuse<$wide>> $(, $feature)?);
            kernels!(@group metal, scatter::<$wide, Metal<$wide>> $(, $feature)?);
            kernels!(@group glass, scatter::<$wide, Glass<$wide>> $(, $feature)?);
            kernels!(@group thin, scatter::<$wide, Thin<$wide>> $(, $feature)?);
            kernels!(@group plastic, scatter::<$wide, Plastic<'_, $wide>> $(, $feature)?);
            kernels!(@group principled, scatter::<$wide, Principled<$wide>> $(, $feature)?);
            // Blends are shaded one by one.
            kernels!(@group blend, scatter::<f32, Blend<'_>> $(, $feature)?);

            $(#[target_feature(enable = $feature)])?
            fn shares(interface: &Interface<'_>, cosines: &[f32], shares: &mut [f32]) {
                interface.shares::<$wide>(cosines, shares);
            }
        }
    };
    (@stream $name:ident, $method:ident::<$($of:ty),+> $(, $feature:literal)?) => {
        $(#[target_feature(enable = $feature)])?
        fn $name(stream: &mut Stream<'_>) {
            stream.$method::<$($of),+>();
        }
    };
    (@sweep $name:ident, $any:literal, $wide:ty, $ray:ty $(, $feature:literal)?) => {
        $(#[target_feature(enable = $feature)])?
        fn $name(accel: &Accel, set: &mut Set<'_>, count: usize, memory: &mut Sweep) {
            accel.sweep::<$wide, $ray, $any>(set, count, memory);
        }
    };
    (@group $name:ident, $method:ident::<$($of:ty),+> $(, $feature:literal)?) => {
        $(#[target_feature(enable = $feature)])?
        fn $name(stream: &mut Stream<'_>, group: &Group) {
            stream.$method::<$($of),+>(group);
        }
    };
}

#[cfg(any(test, not(target_arch = "x86_64")))]
kernels!(portable, f32, f32);
#[cfg(target_arch = "x86_64")]
kernels!(sse2, crate::lanes::F4, crate::lanes::F4);
#[cfg(target_arch = "x86_64")]
kernels!(avx2, crate::lanes::F8, crate::lanes::F8, "avx2,bmi1,bmi2,lzcnt,popcnt");
#[cfg(target_arch = "x86_64")]
kernels!(avx512, crate::lanes::F16, crate::lanes::F8, "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512bw,avx512vl");
