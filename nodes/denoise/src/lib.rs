//! Baselines for solvers and the path tracer: external denoisers and renderers, and filters guided by G-buffers. Any
//! program as a node.

mod command;
mod command_kind;
mod endpoint;
mod external_denoiser;
mod external_renderer;
mod guided_filter;
mod oidn;
mod oidn_files;
mod pfm;
mod process;
mod timed;
mod trace;

pub use command_kind::{CommandKind, CommandMode, CommandParams, ImageFiles, Reproducible};
pub use external_denoiser::{ExternalDenoiser, ExternalDenoiserParams};
pub use external_renderer::{ExternalRenderer, ExternalRendererParams};
pub use guided_filter::{Average, GuidedFilter, GuidedFilterParams, filtered};
pub use oidn::{Features, Quality};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![
        Box::new(KindRow::<CommandKind>::new()),
        Box::new(KindRow::<ExternalDenoiser>::new()),
        Box::new(KindRow::<ExternalRenderer>::new()),
        Box::new(KindRow::<GuidedFilter>::new()),
    ]
}
