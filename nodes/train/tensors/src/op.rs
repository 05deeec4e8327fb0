//! Operators over plain slices in burn's autodiff graph.
//!
//! burn's stock convolution spends most of a training step in its weight gradient, and normalisation takes a pass for
//! each elementary operation; the network's heavy operators are therefore those of `tauflow-ops`. Devices that are no
//! CPU, in builds for them, do burn's own operations (`on_device`). Knows nothing of networks.

use burn::{
    backend::{
        Autodiff, Flex,
        autodiff::{
            checkpoint::{base::Checkpointer, strategy::NoCheckpointing},
            grads::Gradients,
            ops::{Backward, Ops, OpsKind},
        },
        flex::FlexTensor,
        tensor::FloatTensor,
    },
    tensor::{Tensor, TensorData},
};
use tauflow_ops::Operator;

/// Operators that can be applied: in a build for GPUs, those with an implementation for both.
#[cfg(feature = "gpu")]
use crate::on_device::OnDevice as Applicable;
#[cfg(not(feature = "gpu"))]
use tauflow_ops::Operator as Applicable;

/// A tensor's primitive, with or without its place in a graph.
pub enum Input {
    /// Of a graph.
    Tracked(FloatTensor<Autodiff<Flex>>),
    /// Of none.
    Plain(FlexTensor),
    /// A flat tensor of a device that is no CPU, with or without its place in a graph.
    #[cfg(feature = "gpu")]
    Elsewhere(Box<Tensor<1>>),
}

impl<const D: usize> From<Tensor<D>> for Input {
    fn from(tensor: Tensor<D>) -> Self {
        #[cfg(feature = "gpu")]
        if tensor.device() != burn::tensor::Device::flex() {
            return Self::Elsewhere(Box::new(tensor.reshape([-1])));
        }
        if tensor.is_autodiff() {
            Self::Tracked(tensor.try_into_primitive::<Autodiff<Flex>>().expect("the device is flex with autodiff"))
        } else {
            Self::Plain(tensor.try_into_primitive::<Flex>().expect("the device is flex"))
        }
    }
}

#[derive(Clone, Debug)]
struct Step<O>(O);

#[derive(Clone, Debug)]
struct State<const N: usize, S> {
    inputs: [FlexTensor; N],
    saved: S,
}

impl<const N: usize, O: Operator<N>> Backward<Flex, N> for Step<O> {
    type State = State<N, O::Saved>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = contiguous(grads.consume::<Flex>(&ops.node));
        let wanted = ops.parents.each_ref().map(Option::is_some);
        let inputs = ops.state.inputs.each_ref().map(values);
        let made = self.0.backward(inputs, &ops.state.saved, values(&gradient), wanted);
        for ((parent, data), input) in ops.parents.into_iter().zip(made).zip(&ops.state.inputs) {
            if let Some(parent) = parent {
                let shape = input.layout().shape().clone();
                grads.register::<Flex>(parent.id, FlexTensor::from_data(TensorData::new(data, shape)));
            }
        }
    }
}

/// Applies an operator; the output has this shape.
pub fn apply<const N: usize, const D: usize, O: Applicable<N>>(
    operator: O,
    inputs: [Input; N],
    shape: [usize; D],
) -> Tensor<D> {
    #[cfg(feature = "gpu")]
    if matches!(inputs[0], Input::Elsewhere(_)) {
        let inputs = inputs.map(|input| match input {
            Input::Elsewhere(tensor) => *tensor,
            _ => panic!("an operator got tensors of several devices"),
        });
        return operator.by_tensors(inputs).reshape(shape);
    }
    apply_on_cpu(operator, inputs, shape)
}

/// Applies an operator to tensors of the CPU; the output has this shape. For networks that run nowhere else.
pub fn apply_on_cpu<const N: usize, const D: usize, O: Operator<N>>(
    operator: O,
    inputs: [Input; N],
    shape: [usize; D],
) -> Tensor<D> {
    let tracked = inputs.iter().any(|input| matches!(input, Input::Tracked(_)));
    let mut guards = Vec::with_capacity(N);
    let primitives = inputs.map(|input| match input {
        Input::Tracked(tensor) => {
            let (primitive, guard) = tensor.into_parts();
            guards.push(guard);
            contiguous(primitive)
        }
        Input::Plain(tensor) => {
            assert!(!tracked, "an operator got tensors with and without autodiff");
            contiguous(tensor)
        }
        #[cfg(feature = "gpu")]
        Input::Elsewhere(_) => panic!("an operator got tensors of several devices"),
    });
    let (data, saved) = operator.forward(primitives.each_ref().map(values));
    let output = FlexTensor::from_data(TensorData::new(data, shape));
    if !tracked {
        return Tensor::from_primitive::<Flex>(output);
    }
    let guards = guards.try_into().expect("one guard for each input");
    let output = match Step(operator).prepare::<NoCheckpointing>(guards).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(State { inputs: primitives, saved }, output),
        OpsKind::UnTracked(prep) => prep.finish(output),
    };
    Tensor::from_primitive::<Autodiff<Flex>>(output)
}

fn contiguous(tensor: FlexTensor) -> FlexTensor {
    if tensor.is_contiguous() { tensor } else { tensor.to_contiguous() }
}

/// The numbers of a contiguous tensor, which may be a part of another: rows of an image are not copied.
fn values(tensor: &FlexTensor) -> &[f32] {
    &tensor.storage::<f32>()[tensor.layout().start_offset()..][..tensor.layout().num_elements()]
}
