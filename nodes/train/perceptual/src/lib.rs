//! LPIPS, a learned perceptual distance between images: features of AlexNet, compared with learned weights.
//!
//! Knows images, their references and the files of weights that the user names; neither contains weights nor downloads
//! any. Source: Zhang, Isola, Efros, Shechtman, Wang, "The Unreasonable Effectiveness of Deep Features as a Perceptual
//! Metric", CVPR 2018, version 0.1.

mod lpips;
mod lpips_weights;
mod network;
mod weights;

pub use lpips::{Lpips, LpipsParams};
pub use lpips_weights::{LpipsWeights, LpipsWeightsParams};
pub use network::{Features, LEAST_SIDE, Network};
pub use weights::{File, read};

use tauflow_contract::{KindRow, NodeKind};

/// The kinds of this crate.
pub fn kinds() -> Vec<Box<dyn NodeKind>> {
    vec![Box::new(KindRow::<LpipsWeights>::new()), Box::new(KindRow::<Lpips>::new())]
}
