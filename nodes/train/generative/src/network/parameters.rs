//! The weights of a backbone: as its checkpoints name and shape them, and as networks here have them.

use tauflow_tensors::{Slots, Start};

/// How a tensor of a checkpoint lies in memory here, where every weight is a matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// [O, I, height, width] or [O, I] to [height width I, O].
    OutputsFirst,
    /// [I, O] as it is.
    InputsFirst,
    /// [C] to [1, C].
    Vector,
}

/// One weight of a network.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name in a checkpoint.
    pub name: String,
    /// Its shape in a checkpoint.
    pub shape: Vec<usize>,
    /// How it lies in memory.
    pub layout: Layout,
    /// How it starts where a network is trained.
    pub start: Start,
    /// True if no training changes it.
    pub frozen: bool,
}

impl Layout {
    fn outputs(shape: &[usize]) -> (usize, usize, usize) {
        let taps = shape.iter().skip(2).product();
        (shape.first().copied().unwrap_or(1), shape.get(1).copied().unwrap_or(1), taps)
    }

    /// Rows and columns of the matrix.
    fn matrix(self, shape: &[usize]) -> [usize; 2] {
        match self {
            Self::OutputsFirst => {
                let (outputs, inputs, taps) = Self::outputs(shape);
                [taps * inputs, outputs]
            }
            Self::InputsFirst => [shape[0], shape[1]],
            Self::Vector => [1, shape[0]],
        }
    }

    /// A checkpoint's numbers as networks here have them.
    pub(crate) fn own(self, values: &[f32], shape: &[usize]) -> Vec<f32> {
        if self != Self::OutputsFirst {
            return values.to_vec();
        }
        let (outputs, inputs, taps) = Self::outputs(shape);
        let mut own = vec![0.0; values.len()];
        for (at, value) in values.iter().enumerate() {
            let (output, input, tap) = (at / (inputs * taps), at / taps % inputs, at % taps);
            own[(tap * inputs + input) * outputs + output] = *value;
        }
        own
    }

    /// The inverse of [`Layout::own`].
    pub(crate) fn theirs(self, values: &[f32], shape: &[usize]) -> Vec<f32> {
        if self != Self::OutputsFirst {
            return values.to_vec();
        }
        let (outputs, inputs, taps) = Self::outputs(shape);
        let at = |i: usize| {
            let (output, input, tap) = (i / (inputs * taps), i / taps % inputs, i % taps);
            values[(tap * inputs + input) * outputs + output]
        };
        (0..values.len()).map(at).collect()
    }
}

/// Numbers of a network's weights, in the order of its parameters.
pub fn count(parameters: &[Parameter]) -> usize {
    parameters.iter().map(|parameter| parameter.shape.iter().product::<usize>()).sum()
}

/// The matrices of these parameters.
pub(crate) fn slots(parameters: &[Parameter]) -> Slots {
    let mut slots = Slots::default();
    for parameter in parameters {
        slots.add(parameter.name.clone(), parameter.layout.matrix(&parameter.shape), parameter.start);
    }
    slots
}

/// A convolution or a linear map: places of its matrix and its bias.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinearMap {
    pub(crate) kernel: usize,
    pub(crate) bias: usize,
}

/// A group normalisation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Norm {
    pub(crate) weight: usize,
    pub(crate) bias: usize,
    pub(crate) groups: usize,
    pub(crate) epsilon: f64,
}

/// Collects the parameters of a network in the order of its modules, which is that of unnamed averages.
#[derive(Debug, Default)]
pub(crate) struct Builder(pub(crate) Vec<Parameter>);

impl Builder {
    fn add(&mut self, name: String, shape: Vec<usize>, layout: Layout, start: Start) -> usize {
        self.0.push(Parameter { name, shape, layout, start, frozen: false });
        self.0.len() - 1
    }

    fn bias(&mut self, name: &str, size: usize) -> usize {
        self.add(format!("{name}.bias"), vec![size], Layout::Vector, Start::Zero)
    }

    /// A 3x3 convolution.
    pub(crate) fn conv3(&mut self, name: &str, inputs: usize, outputs: usize, start: Start) -> LinearMap {
        let kernel = self.add(format!("{name}.weight"), vec![outputs, inputs, 3, 3], Layout::OutputsFirst, start);
        LinearMap { kernel, bias: self.bias(name, outputs) }
    }

    /// A convolution of single pixels.
    pub(crate) fn conv1(&mut self, name: &str, inputs: usize, outputs: usize) -> LinearMap {
        let (shape, start) = (vec![outputs, inputs, 1, 1], Start::Normal(1.0));
        let kernel = self.add(format!("{name}.weight"), shape, Layout::OutputsFirst, start);
        LinearMap { kernel, bias: self.bias(name, outputs) }
    }

    /// A linear map.
    pub(crate) fn linear(&mut self, name: &str, inputs: usize, outputs: usize, start: Start) -> LinearMap {
        let kernel = self.add(format!("{name}.weight"), vec![outputs, inputs], Layout::OutputsFirst, start);
        LinearMap { kernel, bias: self.bias(name, outputs) }
    }

    /// A linear map of channels as NCSN++ names it.
    pub(crate) fn nin(&mut self, name: &str, inputs: usize, outputs: usize, start: Start) -> LinearMap {
        let kernel = self.add(format!("{name}.W"), vec![inputs, outputs], Layout::InputsFirst, start);
        let bias = self.add(format!("{name}.b"), vec![outputs], Layout::Vector, Start::Zero);
        LinearMap { kernel, bias }
    }

    /// A group normalisation.
    pub(crate) fn norm(&mut self, name: &str, channels: usize, groups: usize, epsilon: f64) -> Norm {
        let weight = self.add(format!("{name}.weight"), vec![channels], Layout::Vector, Start::One);
        Norm { weight, bias: self.bias(name, channels), groups, epsilon }
    }

    /// Random frequencies, which are never trained.
    pub(crate) fn frequencies(&mut self, name: &str, size: usize, scale: f64) -> usize {
        let at = self.add(format!("{name}.W"), vec![size], Layout::Vector, Start::Normal(scale * scale));
        self.0[at].frozen = true;
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_inverses_and_put_taps_before_inputs() {
        let shape = [2, 3, 3, 3];
        let values: Vec<f32> = (0..54).map(|i| i as f32).collect();
        let own = Layout::OutputsFirst.own(&values, &shape);
        assert_eq!(Layout::OutputsFirst.matrix(&shape), [27, 2]);
        // Output 1, input 2, tap 4 of the checkpoint is row 4 * 3 + 2, column 1 here.
        assert_eq!(own[(4 * 3 + 2) * 2 + 1], values[27 + 2 * 9 + 4]);
        assert_eq!(Layout::OutputsFirst.theirs(&own, &shape), values);
        assert_eq!(Layout::OutputsFirst.own(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], &[2, 3]), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        assert_eq!(Layout::InputsFirst.matrix(&[2, 3]), [2, 3]);
    }
}
