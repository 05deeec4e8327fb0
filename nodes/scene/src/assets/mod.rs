//! Assets.
pub mod asset;
