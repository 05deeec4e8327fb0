//! The weights of a network as plain numbers with names: how they are drawn, kept and given to burn.

use burn::tensor::{Device, Tensor, TensorData};
use tauflow_contract::KindError;
use tauflow_data::{TensorFile, rng::Stream};
use tauflow_ops::square_sum;

/// How a weight matrix starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// Zeros: biases, and what ends a residual branch.
    Zero,
    /// Ones: what normalised values are multiplied with.
    One,
    /// Normal numbers of variance `gain`/rows (He et al. 2015, with gain 2 before rectifiers).
    Normal(f64),
}

/// One weight matrix: what it is called, its shape, how it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// What it is called.
    pub name: String,
    /// Rows and columns.
    pub shape: [usize; 2],
    /// The equal parts that rows and columns consist of, each with all channels: nine of the rows of a 3x3 kernel.
    pub parts: [usize; 2],
    /// How it starts.
    pub start: Start,
}

impl Slot {
    /// Where a row (axis 0) or column (axis 1) of this slot lies in one whose parts are of so many channels or more.
    fn place(&self, axis: usize, at: usize, wider: &Self) -> usize {
        let [own, wide] = [self, wider].map(|slot| slot.shape[axis] / slot.parts[axis]);
        at / own * wide + at % own
    }
}

/// The matrices of a network in the order in which it names them.
#[derive(Clone, Debug, Default)]
pub struct Slots(Vec<Slot>);

impl Slots {
    /// Adds one; returns its index.
    pub fn add(&mut self, name: String, shape: [usize; 2], start: Start) -> usize {
        self.add_parts(name, [1, 1], shape, start)
    }

    /// Adds one whose rows and columns consist of so many equal parts, each with all channels; returns its index.
    ///
    /// # Panics
    /// If the shape cannot be parted so.
    pub fn add_parts(&mut self, name: String, parts: [usize; 2], shape: [usize; 2], start: Start) -> usize {
        assert!(shape.iter().zip(parts).all(|(size, parts)| size.is_multiple_of(parts)), "`{name}` in equal parts");
        self.0.push(Slot { name, shape, parts, start });
        self.0.len() - 1
    }

    /// Names and shapes.
    pub fn shapes(&self) -> Vec<(String, [usize; 2])> {
        self.0.iter().map(|slot| (slot.name.clone(), slot.shape)).collect()
    }

    /// Number of weights.
    pub fn count(&self) -> usize {
        self.0.iter().map(|s| s.shape[0] * s.shape[1]).sum()
    }

    /// Starting weights: each matrix from a stream of its own name, so that no order or library decides them.
    pub fn draw(&self, seed: u64) -> Weights {
        let root = Stream::new(seed, &[]).part("weights");
        let values = self.0.iter().map(|slot| {
            let size = slot.shape[0] * slot.shape[1];
            match slot.start {
                Start::Zero => vec![0.0; size],
                Start::One => vec![1.0; size],
                Start::Normal(gain) => {
                    let mut stream = root.part(&slot.name);
                    let deviation = (gain / slot.shape[0] as f64).sqrt();
                    (0..size).map(|_| (stream.normal() * deviation) as f32).collect()
                }
            }
        });
        Weights(values.collect())
    }

    /// The weights of another network for this one, by name. Matrices that the other lacks start as zeros. Channels
    /// that it lacks start as in [`Slots::draw`], but all weights that multiply them are zero.
    ///
    /// # Panics
    /// If it lacks a matrix that does not start as zeros, has one that this network does not use, or has more channels.
    pub fn adopt(&self, other: &Self, weights: &Weights, seed: u64) -> Weights {
        let mut adopted = 0;
        let matrices = self.0.iter().zip(self.draw(seed).0).map(|(slot, drawn)| {
            let Some(at) = other.0.iter().position(|own| own.name == slot.name && own.parts == slot.parts) else {
                assert_eq!(slot.start, Start::Zero, "`{}` is new", slot.name);
                return drawn;
            };
            adopted += 1;
            let own = &other.0[at];
            assert!((0..2).all(|axis| own.shape[axis] <= slot.shape[axis]), "`{}` has fewer channels", slot.name);
            if own.shape == slot.shape {
                return weights.0[at].clone();
            }
            let columns: Vec<usize> = (0..own.shape[1]).map(|column| own.place(1, column, slot)).collect();
            let mut matrix = drawn;
            for row in matrix.chunks_exact_mut(slot.shape[1]) {
                columns.iter().for_each(|column| row[*column] = 0.0);
            }
            for (row, values) in weights.0[at].chunks_exact(own.shape[1]).enumerate() {
                let first = own.place(0, row, slot) * slot.shape[1];
                columns.iter().zip(values).for_each(|(column, value)| matrix[first + column] = *value);
            }
            matrix
        });
        let matrices = matrices.collect();
        assert_eq!(adopted, other.0.len(), "each matrix has its place");
        Weights(matrices)
    }

    /// Adds weights to a tensor file under `prefix`.
    pub fn write(&self, mut file: TensorFile, prefix: &str, weights: &Weights) -> TensorFile {
        for (slot, values) in self.0.iter().zip(&weights.0) {
            file = file.with(&format!("{prefix}{}", slot.name), &slot.shape, values.clone());
        }
        file
    }

    /// Reads what [`Slots::write`] wrote.
    ///
    /// # Errors
    /// If a matrix is missing, has another shape, or holds a number that is not finite.
    pub fn read(&self, file: &TensorFile, prefix: &str) -> Result<Weights, KindError> {
        let matrices = self.0.iter().map(|slot| {
            let name = format!("{prefix}{}", slot.name);
            let tensor = file.get(&name)?;
            if tensor.shape != slot.shape {
                return Err(KindError::Input(format!(
                    "weight `{name}` has shape {:?}, but the network needs {:?}; the model was trained by a different \
                    version, train it again",
                    tensor.shape, slot.shape
                )));
            }
            if tensor.data.iter().any(|v| !v.is_finite()) {
                return Err(KindError::Input(format!(
                    "weight `{name}` contains a number that is not finite; the model is damaged, train it again"
                )));
            }
            Ok(tensor.data.clone())
        });
        Ok(Weights(matrices.collect::<Result<_, _>>()?))
    }

    /// The weights as burn's tensors; on a device with autodiff they are tracked.
    pub fn tensors(&self, weights: &Weights, device: &Device) -> Vec<Tensor<2>> {
        let tensors = self.0.iter().zip(&weights.0).map(|(slot, values)| {
            let tensor = Tensor::from_data(TensorData::new(values.clone(), slot.shape), device);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        });
        tensors.collect()
    }
}

/// Numbers in the order and the shapes of [`Slots`]: weights, their gradients or their moments.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights(
    /// One vector for each slot.
    pub Vec<Vec<f32>>,
);

impl Weights {
    /// The root of the sum of all squares.
    pub fn norm(&self) -> f64 {
        self.0.iter().map(|values| square_sum(values)).sum::<f64>().sqrt()
    }

    /// Zeros of the same shapes.
    pub fn zeros(&self) -> Self {
        Self(self.0.iter().map(|v| vec![0.0; v.len()]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slots(inputs: usize, outputs: usize) -> Slots {
        let mut slots = Slots::default();
        slots.add_parts("kernel".into(), [2, 3], [2 * inputs, 3 * outputs], Start::Normal(1.0));
        slots.add_parts("bias".into(), [1, 3], [1, 3 * outputs], Start::Zero);
        slots
    }

    #[test]
    fn weights_of_fewer_channels_are_in_their_parts_of_wider_matrices() {
        let (narrow, wide) = (slots(1, 1), slots(2, 2));
        let weights = Weights(vec![vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], vec![7.0, 8.0, 9.0]]);
        let found = wide.adopt(&narrow, &weights, 5);
        let drawn = wide.draw(5);
        // Rows: two parts of an old and a new channel. Columns: three such parts.
        for (at, (value, drawn)) in found.0[0].iter().zip(&drawn.0[0]).enumerate() {
            let (row, column) = (at / 6, at % 6);
            let expected = match (row % 2, column % 2) {
                (0, 0) => weights.0[0][row / 2 * 3 + column / 2],
                (1, 0) => 0.0,
                _ => *drawn,
            };
            assert!(*value == expected && (column % 2 == 0 || *value != 0.0), "{row} {column}: {value}");
        }
        assert_eq!(found.0[1], [7.0, 0.0, 8.0, 0.0, 9.0, 0.0]);
        assert!(narrow.adopt(&narrow, &weights, 5) == weights);
    }

    #[test]
    #[should_panic(expected = "fewer channels")]
    fn weights_of_more_channels_are_refused() {
        slots(1, 1).adopt(&slots(2, 1), &slots(2, 1).draw(1), 1);
    }
}
