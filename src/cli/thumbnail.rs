//! Small pictures in a terminal: two pixels in a character, one above the other.

use super::terminal::{self, Palette};
use std::{fmt::Write as _, io::Cursor};

/// Width and height of a thumbnail, in pixels. A character is one wide and two high.
const MOST: usize = 48;
/// The exponent of the display transform. Pixels are averaged as light.
const GAMMA: f32 = 2.2;

/// An 8-bit RGB picture, rows from the top.
struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    /// Reads a PNG of 8-bit RGB, as all previews are; none for any other.
    fn read(png: &[u8]) -> Option<Self> {
        let mut reader = png::Decoder::new(Cursor::new(png)).read_info().ok()?;
        let mut bytes = vec![0; reader.output_buffer_size()?];
        let info = reader.next_frame(&mut bytes).ok()?;
        let rgb = (info.color_type, info.bit_depth) == (png::ColorType::Rgb, png::BitDepth::Eight);
        let pixels = rgb.then(|| bytes[..info.buffer_size()].as_chunks().0.to_vec())?;
        Some(Self { width: info.width as usize, height: info.height as usize, pixels })
    }

    /// The picture at most [`MOST`] pixels wide and high, each the mean of those that it covers.
    fn small(&self) -> Self {
        let longest = self.width.max(self.height).max(1);
        let size = |own: usize| if longest > MOST { (own * MOST / longest).max(1) } else { own };
        let (width, height) = (size(self.width), size(self.height));
        let mean = |i: usize| {
            let covered = |at: usize, own: usize, of: usize| at * own / of..((at + 1) * own).div_ceil(of);
            let (rows, columns) = (covered(i / width, self.height, height), covered(i % width, self.width, width));
            let count = (rows.len() * columns.len()) as f32;
            let mut sum = [0.0f32; 3];
            for pixel in rows.flat_map(|y| columns.clone().map(move |x| self.pixels[y * self.width + x])) {
                for (sum, value) in sum.iter_mut().zip(pixel) {
                    *sum += (f32::from(value) / 255.0).powf(GAMMA);
                }
            }
            sum.map(|sum| ((sum / count).powf(1.0 / GAMMA) * 255.0).round() as u8)
        };
        Self { width, height, pixels: (0..width * height).map(mean).collect() }
    }

    /// Lines of characters, whose upper half has the colour of the text and whose lower half that of the background.
    fn lines(&self, palette: Palette, indent: &str) -> String {
        let mut out = String::new();
        for rows in self.pixels.chunks(2 * self.width) {
            out += indent;
            let (upper, lower) = rows.split_at(self.width);
            for (x, above) in upper.iter().enumerate() {
                let _ = write!(out, "\u{1b}[38;{}", palette.colour(*above));
                let _ = match lower.get(x) {
                    Some(below) => write!(out, ";48;{}m▀", palette.colour(*below)),
                    None => write!(out, "m▀"),
                };
            }
            out += "\u{1b}[0m\n";
        }
        out
    }
}

impl Palette {
    /// A colour in an order to the terminal.
    fn colour(self, [r, g, b]: [u8; 3]) -> String {
        match self {
            Self::All => format!("2;{r};{g};{b}"),
            Self::Few => format!("5;{}", nearest([r, g, b])),
        }
    }
}

/// The nearest of the colours that terminals with 256 of them agree on: a cube of six levels, and 24 greys.
fn nearest(colour: [u8; 3]) -> u8 {
    const LEVELS: [u8; 6] = [0, 95, 135, 175, 215, 255];
    let distance = |of: [u8; 3]| -> u32 { of.iter().zip(colour).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum() };
    let level = |value: u8| (0..6u8).min_by_key(|i| LEVELS[usize::from(*i)].abs_diff(value)).unwrap_or_default();
    let [r, g, b] = colour.map(level);
    let cube = (distance([r, g, b].map(|i| LEVELS[usize::from(i)])), 16 + 36 * r + 6 * g + b);
    let greys = (0..24u8).map(|i| (distance([8 + 10 * i; 3]), 232 + i));
    greys.chain([cube]).min().map_or(16, |(_, place)| place)
}

/// A preview as text of a terminal that shows colours on stdout; none elsewhere, and of a file that is no preview.
pub(super) fn thumbnail(png: &[u8], indent: &str) -> Option<String> {
    let palette = terminal::pictures()?;
    Some(Picture::read(png)?.small().lines(palette, indent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_data::{Image, image_io::encode_png};

    fn picture(width: usize, height: usize, values: Vec<f32>) -> Picture {
        let image = Image::from_data(width, height, 3, values).expect("fits");
        Picture::read(&encode_png(&image).expect("three channels")).expect("a preview")
    }

    #[test]
    fn two_rows_make_a_line_and_an_odd_row_is_half_of_one() {
        let text = picture(1, 3, vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]).small().lines(Palette::All, "  ");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "  \u{1b}[38;2;255;0;0;48;2;0;255;0m▀\u{1b}[0m");
        assert_eq!(lines[1], "  \u{1b}[38;2;0;0;255m▀\u{1b}[0m");
        assert_eq!(lines.len(), 2);
    }

    #[test]
    fn large_pictures_become_small_by_means_of_light() {
        let checks = (0..96 * 64).flat_map(|i| [if (i + i / 96) % 2 == 0 { 1.0 } else { 0.0 }; 3]).collect();
        let small = picture(96, 64, checks).small();
        assert_eq!((small.width, small.height, small.pixels.len()), (48, 32, 48 * 32));
        assert!(small.pixels.iter().all(|pixel| *pixel == [186; 3]), "half of the light: {:?}", small.pixels[0]);
        let wide = picture(200, 1, vec![0.5; 600]).small();
        assert_eq!((wide.width, wide.height), (48, 1));
    }

    #[test]
    fn the_nearest_of_few_colours_is_taken() {
        assert_eq!([[0; 3], [255; 3], [255, 0, 0], [128; 3], [95, 135, 175]].map(nearest), [16, 231, 196, 244, 67]);
        assert_eq!(Palette::Few.colour([0, 0, 255]), "5;21");
    }

    #[test]
    fn what_is_no_preview_has_no_thumbnail() {
        assert!(Picture::read(b"no picture").is_none() && Picture::read(b"").is_none());
    }
}
