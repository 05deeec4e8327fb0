//! Metrics, evaluation and bridge validation.
