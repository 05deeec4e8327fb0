//! Which window of which scene an example is, and how it is turned.

use tauflow_data::{Image, rng::Stream};

/// One example: which scene, rung, window and turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pick {
    pub(super) scene: usize,
    /// The scene that the target is taken from: `scene`, unless targets are shuffled.
    pub(super) target: usize,
    pub(super) rung: usize,
    pub(super) t: f64,
    pub(super) left: usize,
    pub(super) top: usize,
    /// 0..8: quarter turns, and a flip from 4 on.
    pub(super) turn: usize,
    /// The exposure factor.
    pub(super) scale: f32,
    /// Which of the six orders of the colours.
    pub(super) colours: usize,
    /// Whether the network is told the sample count.
    pub(super) told: bool,
    /// Whether the target leaves out the samples of the input.
    pub(super) apart: bool,
    /// The seed of the patches that partly cover the window, if there are any.
    pub(super) patches: Option<u64>,
    /// Where the state is that of a different rung; none if all of it is of `rung`.
    pub(super) tiles: Option<Tiles>,
}

/// Square tiles of two rungs, like a chessboard: an image of uneven sample counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tiles {
    /// The rung of every second tile.
    pub(super) rung: usize,
    /// Pixels of a tile's side.
    side: usize,
    /// Where the first tile begins, left of and above the window.
    offset: [usize; 2],
}

/// The smallest and the largest side of tiles, in pixels.
const TILES: [usize; 2] = [8, 32];

impl Tiles {
    pub(super) fn draw(stream: &mut Stream, rungs: usize) -> Self {
        let side = TILES[0] + stream.below(TILES[1] - TILES[0] + 1);
        Self { rung: stream.below(rungs), side, offset: [0, 1].map(|_| stream.below(2 * side)) }
    }

    /// Whether a pixel of the window is in a tile of the different rung.
    pub(super) fn has(&self, x: usize, y: usize) -> bool {
        ((x + self.offset[0]) / self.side + (y + self.offset[1]) / self.side) % 2 == 1
    }
}

/// Orders of the colours; the first leaves them.
pub(super) const COLOURS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

impl Pick {
    /// For each pixel of the turned window, where it lies in an image of this width and height; the window is moved in
    /// where another scene's image is smaller.
    pub(super) fn places(&self, (width, height): (usize, usize), side: usize) -> Vec<usize> {
        let (left, top) = (self.left.min(width - side), self.top.min(height - side));
        let place = |x: usize, y: usize| {
            let x = if self.turn >= 4 { side - 1 - x } else { x };
            let (x, y) = match self.turn % 4 {
                0 => (x, y),
                1 => (y, side - 1 - x),
                2 => (side - 1 - x, side - 1 - y),
                _ => (side - 1 - y, x),
            };
            (top + y) * width + left + x
        };
        (0..side * side).map(|i| place(i % side, i / side)).collect()
    }

    /// The first three channels of the pixels at these places, in this pick's order.
    pub(super) fn colours(&self, image: &Image, places: &[usize]) -> impl Iterator<Item = [f32; 3]> {
        let (data, channels, order) = (image.data(), image.channels(), COLOURS[self.colours]);
        places.iter().map(move |at| {
            let pixel = &data[at * channels..at * channels + 3];
            order.map(|c| pixel[c])
        })
    }

    /// Pixels of a G-buffer at these places, colours in order, normals (right, up, back) turned as the places are.
    pub(super) fn turned(&self, gbuffer: &Image, places: &[usize]) -> Vec<f32> {
        let normals = places.iter().map(|at| {
            let [right, up, back] = [3, 4, 5].map(|c| gbuffer.data()[6 * at + c]);
            let [right, up] = match self.turn % 4 {
                0 => [right, up],
                1 => [up, -right],
                2 => [-right, -up],
                _ => [-up, right],
            };
            [if self.turn >= 4 { -right } else { right }, up, back]
        });
        let pixels: Vec<[[f32; 3]; 2]> = self.colours(gbuffer, places).zip(normals).map(<[_; 2]>::from).collect();
        pixels.into_flattened().into_flattened()
    }
}
