//! The denoiser that needs no training: bundled models for radiance with and without G-buffers, images of any size and
//! of unknown sample counts, damaged pixels, and a mix with the noisy image by estimated errors.
//!
//! ```ignore
//! let denoiser = tauflow_denoiser::Denoiser::built_in(Weights::Best)?;
//! let frame = Frame::new(radiance)?.with_gbuffer(albedo_and_normal)?;
//! let clean = denoiser.denoise(&frame, &Settings::default(), &mut |_, _| Ok(()))?.image;
//! ```
//!
//! It knows images, not files: which layers of a file are what is for its caller to say.

mod built_in;
mod denoiser;
mod denoising;
mod frame;
mod mix;
mod tiles;

pub use built_in::Weights;
pub use denoiser::{Denoised, Denoiser, Settings};
pub use denoising::{Denoising, DenoisingParams, Source};
pub use frame::{Frame, mended_normals};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<Denoising>::new())]
}
