//! Which instructions kernels are made of: chosen once, by what the processor has, or fewer if `TAUFLOW_INSTRUCTIONS` says
//! so. The bits do not depend on it, so that this is no param and in no key.
//!
//! Each kernel is a function of its own for each set of instructions; what it calls is inlined into it, and so made of
//! the same instructions. Hence no closures in kernels: those stay functions of their own, of the plain instructions,
//! which nothing can be inlined into.

use crate::{
    accel::{Accel, Set, Sweep},
    bsdf::Sort,
    stream::{Batch, Found, Group, Stream, trace},
};
use std::sync::OnceLock;

/// Sets of instructions that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Instructions {
    /// One number at a time: for processors other than x86-64, and to hold the others to.
    Portable,
    /// Four lanes; any x86-64 processor.
    Sse2,
    /// Eight lanes.
    Avx2,
    /// Sixteen lanes.
    Avx512,
}

impl Instructions {
    /// All that this processor has, from the narrowest; in tests one number at a time as well.
    pub fn available() -> Vec<Self> {
        #[cfg(not(target_arch = "x86_64"))]
        return vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            let mut found = if cfg!(test) { vec![Self::Portable, Self::Sse2] } else { vec![Self::Sse2] };
            let avx2 = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
                && is_x86_feature_detected!("popcnt");
            let avx512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl");
            if avx2 {
                found.push(Self::Avx2);
            }
            if avx2 && avx512 {
                found.push(Self::Avx512);
            }
            found
        }
    }

    /// The widest that this processor has, and that `TAUFLOW_INSTRUCTIONS` (`sse2`, `avx2` or `avx512`) allows.
    pub fn best() -> Self {
        static BEST: OnceLock<Instructions> = OnceLock::new();
        *BEST.get_or_init(|| {
            let most = std::env::var("TAUFLOW_INSTRUCTIONS").map_or(Self::Avx512, |name| Self::named(&name));
            Self::available().into_iter().filter(|found| *found <= most).max().unwrap_or(Self::Portable)
        })
    }

    fn named(name: &str) -> Self {
        match name {
            "sse2" => Self::Sse2,
            "avx2" => Self::Avx2,
            "avx512" => Self::Avx512,
            other => {
                eprintln!(
                    "TAUFLOW_INSTRUCTIONS is `{other}`, which is none of sse2, avx2 and avx512; it is not heeded"
                );
                Self::Avx512
            }
        }
    }

    /// Traces a batch, by narrower lanes if the processor lacks these.
    pub(crate) fn trace(self, batch: &Batch<'_>) -> Found {
        trace(batch, self.kernels())
    }

    /// Kernels of these instructions, or of fewer if the processor lacks them.
    pub(crate) fn kernels(self) -> &'static Kernels {
        #[cfg(target_arch = "x86_64")]
        match self.min(Self::best()) {
            Self::Avx512 => &avx512::KERNELS,
            Self::Avx2 => &avx2::KERNELS,
            #[cfg(test)]
            Self::Portable => &portable::KERNELS,
            _ => &sse2::KERNELS,
        }
        #[cfg(not(target_arch = "x86_64"))]
        &portable::KERNELS
    }
}

type Whole = unsafe fn(&mut Stream<'_>);
type Grouped = unsafe fn(&mut Stream<'_>, &Group);
type Swept = unsafe fn(&Accel, &mut Set<'_>, usize, &mut Sweep);

/// Functions compiled for one set of instructions.
pub(crate) struct Kernels {
    begin: Whole,
    nearest: Swept,
    stopped: Swept,
    meet_packets: Whole,
    miss: Whole,
    vertices: Grouped,
    emit: Grouped,
    textures: Grouped,
    bodies: Grouped,
    lights: Grouped,
    diffuse: Grouped,
    metal: Grouped,
    glass: Grouped,
    thin: Grouped,
    plastic: Grouped,
    principled: Grouped,
    blend: Grouped,
}

#[allow(unsafe_code, reason = "`Instructions::kernels` hands out only what the processor can run")]
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

    pub(crate) fn miss(&self, stream: &mut Stream<'_>) {
        unsafe { (self.miss)(stream) }
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
            use super::{Accel, Group, Kernels, Set, Stream, Sweep};
            use crate::bsdf::{Bsdf, Diffuse, Glass, Metal, Plastic, Principled, Thin};

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
                lights,
                diffuse,
                metal,
                glass,
                thin,
                plastic,
                principled,
                blend,
            };

            kernels!(@whole begin, begin::<$wide> $(, $feature)?);
            kernels!(@sweep nearest, false, $wide, $ray $(, $feature)?);
            kernels!(@sweep stopped, true, $wide, $ray $(, $feature)?);
            kernels!(@whole meet_packets, meet_packets::<$wide, $ray> $(, $feature)?);
            kernels!(@whole miss, miss::<$wide> $(, $feature)?);
            kernels!(@group vertices, vertices::<$wide> $(, $feature)?);
            kernels!(@group emit, emit::<$wide> $(, $feature)?);
            kernels!(@group textures, textures::<$wide> $(, $feature)?);
            kernels!(@group bodies, bodies::<$wide> $(, $feature)?);
            kernels!(@group lights, lights::<$wide> $(, $feature)?);
            kernels!(@group diffuse, scatter::<$wide, Diffuse<$wide>> $(, $feature)?);
            kernels!(@group metal, scatter::<$wide, Metal<$wide>> $(, $feature)?);
            kernels!(@group glass, scatter::<$wide, Glass<$wide>> $(, $feature)?);
            kernels!(@group thin, scatter::<$wide, Thin<$wide>> $(, $feature)?);
            kernels!(@group plastic, scatter::<$wide, Plastic<'_, $wide>> $(, $feature)?);
            kernels!(@group principled, scatter::<$wide, Principled<$wide>> $(, $feature)?);
            // Blends are rare, and shaded one by one.
            kernels!(@group blend, scatter::<f32, Bsdf<'_>> $(, $feature)?);
        }
    };
    (@whole $name:ident, $method:ident::<$($of:ty),+> $(, $feature:literal)?) => {
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
