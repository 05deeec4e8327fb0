//! Path tracer, ladder rendering and quality gate.
