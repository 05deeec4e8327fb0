//! Toy kinds, and a workshop with a store of its own to run small pipelines in.

mod kinds;
mod media;
mod workshop;

pub use kinds::registry;
pub use workshop::{Ran, Workshop, resolve};
