//! The features of AlexNet and their distance.
//!
//! Convolutions are products of patches and kernels, whose sums have an order that depends on shapes alone, so that
//! results have the same bits on every machine. Distances are f64.
//!
//! # Source
//! The layers are those of torchvision's `alexnet` ("One weird trick for parallelizing convolutional neural networks",
//! Krizhevsky 2014); the distance is that of LPIPS 0.1.

use tauflow_contract::KindError;
use tauflow_data::{Image, TensorFile};
use tauflow_ops::{Instructions, Linear, Operator};

/// Least width and height of an image: below it, a layer of AlexNet has no pixel left.
pub const LEAST_SIDE: usize = 31;
/// Pixels whose patches are in memory at once.
const BAND: usize = 2048;
/// Mean and deviation of the values that the network was trained on, for images of [-1, 1].
const SHIFT: [f64; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f64; 3] = [0.458, 0.448, 0.450];
/// Keeps the norm of a pixel without features from being 0.
const EPSILON: f64 = 1e-10;

/// A convolution of AlexNet, which a rectifier follows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// Its number among the layers of torchvision's `features`.
    pub(crate) place: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Width and height of its kernel.
    pub(crate) side: usize,
    stride: usize,
    padding: usize,
    /// Whether its input is pooled first.
    pooled: bool,
}

/// The five convolutions.
pub(crate) const LAYERS: [Shape; 5] = [
    Shape { place: 0, inputs: 3, outputs: 64, side: 11, stride: 4, padding: 2, pooled: false },
    Shape { place: 3, inputs: 64, outputs: 192, side: 5, stride: 1, padding: 2, pooled: true },
    Shape { place: 6, inputs: 192, outputs: 384, side: 3, stride: 1, padding: 1, pooled: true },
    Shape { place: 8, inputs: 384, outputs: 256, side: 3, stride: 1, padding: 1, pooled: false },
    Shape { place: 10, inputs: 256, outputs: 256, side: 3, stride: 1, padding: 1, pooled: false },
];

/// Names of the tensors of a convolution: kernel and bias.
pub(crate) fn trunk_names(shape: &Shape) -> [String; 2] {
    ["weight", "bias"].map(|what| format!("features.{}.{what}", shape.place))
}

/// Name of the weights of a layer's features.
pub(crate) fn lin_name(layer: usize) -> String {
    format!("lin{layer}.model.1.weight")
}

/// Features: rows of pixels of channels.
#[derive(Clone, Debug, PartialEq)]
struct Grid {
    height: usize,
    width: usize,
    channels: usize,
    data: Vec<f32>,
}

impl Grid {
    fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let at = (y * self.width + x) * self.channels;
        &self.data[at..at + self.channels]
    }

    /// The maximum of 3 x 3 pixels at every second pixel.
    fn pooled(&self) -> Self {
        let (height, width) = ((self.height - 3) / 2 + 1, (self.width - 3) / 2 + 1);
        let mut data = Vec::with_capacity(height * width * self.channels);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let start = data.len();
            data.extend_from_slice(self.pixel(2 * x, 2 * y));
            for k in 1..9 {
                let most = data[start..].iter_mut().zip(self.pixel(2 * x + k % 3, 2 * y + k / 3));
                most.for_each(|(most, value)| *most = most.max(*value));
            }
        }
        Self { height, width, channels: self.channels, data }
    }
}

/// A convolution with its weights; `kernel` is [side, side, inputs, outputs].
#[derive(Clone, Debug)]
struct Layer {
    shape: Shape,
    kernel: Vec<f32>,
    bias: Vec<f32>,
}

impl Layer {
    /// The convolution and its rectifier, with zeros around the image.
    fn of(&self, x: &Grid) -> Grid {
        let Shape { inputs, outputs, side, stride, padding, .. } = self.shape;
        let size = |length: usize| (length + 2 * padding - side) / stride + 1;
        let (height, width) = (size(x.height), size(x.width));
        let map = Linear { inputs: side * side * inputs, outputs, instructions: Instructions::best() };
        let mut data = Vec::with_capacity(height * width * outputs);
        let mut patches = Vec::new();
        for first in (0..height * width).step_by(BAND) {
            let pixels = first..(first + BAND).min(height * width);
            patches.clear();
            patches.resize(pixels.len() * map.inputs, 0.0);
            for (pixel, patch) in pixels.zip(patches.chunks_exact_mut(map.inputs)) {
                let (top, left) = (pixel / width * stride, pixel % width * stride);
                for (tap, to) in patch.chunks_exact_mut(inputs).enumerate() {
                    let (row, column) = (top + tap / side, left + tap % side);
                    let inside =
                        (padding..padding + x.height).contains(&row) && (padding..padding + x.width).contains(&column);
                    if inside {
                        to.copy_from_slice(x.pixel(column - padding, row - padding));
                    }
                }
            }
            let (out, ()) = map.forward([&patches, &self.kernel, &self.bias]);
            // What is no number stays so, and is told with the distance.
            data.extend(out.into_iter().map(|value| if value < 0.0 { 0.0 } else { value }));
        }
        Grid { height, width, channels: outputs, data }
    }
}

/// AlexNet up to its last convolution, and the weights of its features.
#[derive(Clone, Debug)]
pub struct Network {
    layers: Vec<Layer>,
    lins: Vec<Vec<f32>>,
}

/// The features of an image at the five layers.
#[derive(Clone, Debug)]
pub struct Features(Vec<Grid>);

impl Network {
    /// The network with the weights of a file that [`crate::read`] made.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(file: &TensorFile) -> Result<Self, KindError> {
        let layers = LAYERS.iter().map(|shape| {
            let [kernel, bias] = trunk_names(shape);
            let theirs = tensor(file, &kernel, &kernel_shape(shape))?;
            let taps = shape.side * shape.side;
            let mut own = vec![0.0; theirs.len()];
            for (i, value) in theirs.iter().enumerate() {
                let (output, input, tap) = (i / (shape.inputs * taps), i / taps % shape.inputs, i % taps);
                own[(tap * shape.inputs + input) * shape.outputs + output] = *value;
            }
            Ok(Layer { shape: *shape, kernel: own, bias: tensor(file, &bias, &[shape.outputs])?.to_vec() })
        });
        let lins = LAYERS.iter().enumerate();
        let lins = lins.map(|(i, shape)| Ok(tensor(file, &lin_name(i), &lin_shape(shape))?.to_vec()));
        Ok(Self { layers: layers.collect::<Result<_, KindError>>()?, lins: lins.collect::<Result<_, KindError>>()? })
    }

    /// The features of a preview: an RGB image of values within [0, 1], of at least [`LEAST_SIDE`] pixels each way.
    ///
    /// # Errors
    /// If the image is smaller or has another number of channels.
    pub fn features(&self, preview: &Image) -> Result<Features, KindError> {
        let (width, height, channels) = (preview.width(), preview.height(), preview.channels());
        if channels != 3 || width < LEAST_SIDE || height < LEAST_SIDE {
            return Err(KindError::Input(format!(
                "LPIPS needs RGB images of at least {LEAST_SIDE} x {LEAST_SIDE} pixels, but this one has {width} x \
                 {height} x {channels}; increase the resolution, or remove the node of kind `lpips`"
            )));
        }
        let scaled = |(i, value): (usize, &f32)| ((2.0 * f64::from(*value) - 1.0 - SHIFT[i % 3]) / SCALE[i % 3]) as f32;
        let data = preview.data().iter().enumerate().map(scaled).collect();
        let mut grids: Vec<Grid> = Vec::with_capacity(LAYERS.len());
        let first = Grid { height, width, channels, data };
        for layer in &self.layers {
            let x = grids.last().unwrap_or(&first);
            grids.push(if layer.shape.pooled { layer.of(&x.pooled()) } else { layer.of(x) });
        }
        Ok(Features(grids))
    }

    /// LPIPS of two images of the same size.
    ///
    /// # Errors
    /// If the images differ in size, or the distance is not a number, as of features that overflow.
    pub fn distance(&self, a: &Features, b: &Features) -> Result<f64, KindError> {
        let mut sum = 0.0;
        for (layer, ((a, b), lin)) in a.0.iter().zip(&b.0).zip(&self.lins).enumerate() {
            if (a.width, a.height) != (b.width, b.height) {
                return Err(KindError::Input(
                    "LPIPS compares images of one size; render both with the same `resolution`".into(),
                ));
            }
            let pixels = a.data.chunks_exact(a.channels).zip(b.data.chunks_exact(b.channels));
            let own = pixels.map(|(a, b)| of_pixel(a, b, lin)).sum::<f64>() / (a.width * a.height) as f64;
            if !own.is_finite() {
                return Err(KindError::Input(format!(
                    "LPIPS is not finite at the features of `{}`; check that `trunk` and `lin` are the published \
                     weights, and that the image has no extreme values",
                    trunk_names(&LAYERS[layer])[0]
                )));
            }
            sum += own;
        }
        Ok(sum)
    }
}

/// The weighted squared distance of the features of a pixel, each divided by its norm.
fn of_pixel(a: &[f32], b: &[f32], lin: &[f32]) -> f64 {
    let norm = |of: &[f32]| of.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() + EPSILON;
    let (of_a, of_b) = (norm(a), norm(b));
    let square = |((a, b), weight): ((&f32, &f32), &f32)| {
        let difference = f64::from(*a) / of_a - f64::from(*b) / of_b;
        f64::from(*weight) * difference * difference
    };
    a.iter().zip(b).zip(lin).map(square).sum()
}

/// The shape of a convolution's kernel, as PyTorch has it.
pub(crate) fn kernel_shape(shape: &Shape) -> [usize; 4] {
    [shape.outputs, shape.inputs, shape.side, shape.side]
}

/// The shape of the weights of a layer's features, as PyTorch has it.
pub(crate) fn lin_shape(shape: &Shape) -> [usize; 4] {
    [1, shape.outputs, 1, 1]
}

fn tensor<'f>(file: &'f TensorFile, name: &str, shape: &[usize]) -> Result<&'f [f32], KindError> {
    let found = file.get(name)?;
    if found.shape != shape {
        let told = format!("tensor `{name}` has shape {:?}, expected {shape:?}", found.shape);
        return Err(KindError::Internal(told));
    }
    Ok(&found.data)
}

#[cfg(test)]
mod tests;
