//! The interface of operators.

use std::fmt::Debug;

/// A differentiable operator of `N` inputs and one output, all contiguous f32.
pub trait Operator<const N: usize>: Clone + Send + Debug + 'static {
    /// The values that the forward pass keeps for the backward pass, in addition to the inputs.
    type Saved: Clone + Send + Debug + 'static;

    /// The output of these inputs.
    fn forward(&self, inputs: [&[f32]; N]) -> (Vec<f32>, Self::Saved);

    /// The gradients of the inputs that are `wanted`; the others may be empty.
    fn backward(&self, inputs: [&[f32]; N], saved: &Self::Saved, gradient: &[f32], wanted: [bool; N]) -> [Vec<f32>; N];
}
