//! Denoisers that solvers are compared with: external programs and libraries, and a filter guided by G-buffers.

mod command;
mod external_denoiser;
mod guided_filter;
mod oidn;
mod timed;

pub use external_denoiser::{ExternalDenoiser, ExternalDenoiserParams};
pub use guided_filter::{GuidedFilter, GuidedFilterParams, filtered};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<ExternalDenoiser>::new()), Box::new(KindRow::<GuidedFilter>::new())]
}
