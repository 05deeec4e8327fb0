//! Path tracer, ladder rendering and quality gate.

pub mod accel;
pub mod accumulator;
pub mod camera;
pub mod geometry;
pub mod rng;
