//! The heavy operators of small image networks on a CPU, forward and backward, and their optimiser, over plain slices
//! of f32.
//!
//! Images are [N, H, W, C], channels last. Every sum is taken in an order that depends on shapes alone. In `products`
//! and in the transforms of `convolution`, every product is fused with the sum before it, and elsewhere none ever is.
//! Results therefore have the same bits for any number of threads and any [`Instructions`]. Work is split by
//! rayon over images, rows of images and rows of weights. Knows neither networks nor graphs of gradients. Slices of
//! lengths that do not fit are refused by a panic.

mod adam;
mod attention;
mod convolution;
mod elementary;
mod fold;
mod fresh;
mod group_norm;
#[cfg_attr(target_arch = "x86_64", expect(unsafe_code, reason = "calls functions for instructions that were detected"))]
mod instructions;
mod lanes;
mod local_models;

#[cfg(test)]
mod made_up;
mod memory;
mod normalisation;
mod operator;
mod products;
mod pyramid;
mod resample;
mod sums;

pub use adam::{Adam, square_sum};
pub use attention::Attention;
pub use convolution::{Conv3, Convolutions, Linear};
pub use elementary::{exp, expm1, log1p, map, map2};
pub use fold::Fold;
pub use group_norm::{GroupMoments, GroupNorm};
pub use instructions::Instructions;
pub use local_models::{FARTHEST_FITTED, LOCAL_MODELS, local_models};
pub use memory::keep as keep_memory;
pub use normalisation::{GROUP, NormSilu, Silu};
pub use operator::Operator;
pub use pyramid::{Blocks, FARTHEST, GUIDES, GuideBlocks, GuidedMean, Guides, Pyramid, SHARPNESS, WeightedMean};
pub use resample::{Beside, Fir, Nearest, Patches};
