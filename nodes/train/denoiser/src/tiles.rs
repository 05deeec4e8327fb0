//! Tiles of a large image, so that memory is bounded. Knows no network: only how far one looks.

use tauflow_data::Image;

/// Most pixels that are denoised at once; a `best` network takes some 700 bytes for each.
const WHOLE: usize = 1_600_000;

/// Side of the tiles of larger images, without what is around them.
const SIDE: usize = 896;

/// Pixels of an image, from which on tiles are smaller: most of the memory is the image then.
const HUGE: usize = 16_000_000;

/// Side of the tiles of such an image.
const SIDE_OF_HUGE: usize = 512;

/// A part of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    /// What the tile is for: left, top, right, bottom; the last two are outside.
    pub(crate) core: [usize; 4],
    /// The same with what is looked at around it.
    pub(crate) seen: [usize; 4],
}

/// The tiles of an image, row by row: one if it is small, or if a network looks at the whole image.
pub(crate) fn tiles(
    width: usize,
    height: usize,
    side: Option<usize>,
    reach: Option<usize>,
    multiple: usize,
) -> Vec<Tile> {
    let whole = [0, 0, width, height];
    let Some(reach) = reach.filter(|_| side.is_some() || width * height > WHOLE) else {
        return vec![Tile { core: whole, seen: whole }];
    };
    let side =
        side.unwrap_or(if width * height > HUGE { SIDE_OF_HUGE } else { SIDE }).max(1).next_multiple_of(multiple);
    let reach = reach.next_multiple_of(multiple);
    let rows = (0..height).step_by(side);
    let tile = |left: usize, top: usize| {
        let (right, bottom) = ((left + side).min(width), (top + side).min(height));
        let seen = [
            left.saturating_sub(reach),
            top.saturating_sub(reach),
            (right + reach).min(width),
            (bottom + reach).min(height),
        ];
        Tile { core: [left, top, right, bottom], seen }
    };
    rows.flat_map(|top| (0..width).step_by(side).map(move |left| (left, top))).map(|(l, t)| tile(l, t)).collect()
}

/// The part of an image.
pub(crate) fn part(image: &Image, [left, top, right, bottom]: [usize; 4]) -> Image {
    let channels = image.channels();
    let mut data = Vec::with_capacity((right - left) * (bottom - top) * channels);
    for y in top..bottom {
        let row = y * image.width();
        data.extend_from_slice(&image.data()[(row + left) * channels..(row + right) * channels]);
    }
    Image::from_data(right - left, bottom - top, channels, data).expect("a part that lies in the image")
}

/// Puts what was made of the part that a tile sees where the tile is.
pub(crate) fn put(image: &mut Image, tile: &Tile, made: &Image) {
    let ([left, top, right, bottom], channels, width) = (tile.core, image.channels(), image.width());
    for y in top..bottom {
        let from = ((y - tile.seen[1]) * made.width() + left - tile.seen[0]) * channels;
        let count = (right - left) * channels;
        let to = (y * width + left) * channels;
        image.data_mut()[to..to + count].copy_from_slice(&made.data()[from..from + count]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_an_image_once_and_see_what_is_around_them() {
        for (width, height, side) in [(1, 1, 16), (50, 33, 16), (64, 64, 32), (100, 20, 64)] {
            let image = Image::from_data(width, height, 1, (0..width * height).map(|i| i as f32).collect());
            let image = image.expect("fits");
            let mut out = Image::new(width, height, 1);
            let mut pixels = 0;
            for tile in tiles(width, height, Some(side), Some(20), 16) {
                let ([left, top, right, bottom], seen) = (tile.core, tile.seen);
                assert!(seen[0].is_multiple_of(16) && seen[1].is_multiple_of(16), "{tile:?}");
                assert!(seen[0] == 0 || left - seen[0] >= 20, "{tile:?}");
                assert!(seen[3] == height || seen[3] - bottom >= 20, "{tile:?}");
                pixels += (right - left) * (bottom - top);
                put(&mut out, &tile, &part(&image, seen));
            }
            assert!(pixels == width * height && out == image, "{width} x {height}");
        }
        let one = |reach, side| tiles(2000, 2000, side, reach, 16).len();
        assert_eq!((one(None, Some(64)), one(Some(100), None), one(Some(100), Some(1000))), (1, 9, 4));
        assert_eq!(tiles(1000, 1000, None, Some(100), 16).len(), 1);
    }
}
