//! Path tracer, ladder rendering and quality gate.

pub mod geometry;
