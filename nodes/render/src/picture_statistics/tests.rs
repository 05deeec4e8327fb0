//! Each measure on pictures whose answer is known.

use super::*;
use tauflow_data::rng::Stream;

/// A picture of 64 x 64 pixels.
fn picture(value: impl Fn(usize, usize) -> [f32; 3]) -> Image {
    let data = (0..64 * 64).flat_map(|at| value(at % 64, at / 64)).collect();
    Image::from_data(64, 64, 3, data).expect("fits")
}

fn grey(value: impl Fn(usize, usize) -> f32) -> Image {
    picture(|x, y| [value(x, y); 3])
}

fn close(found: f64, expected: f64) -> bool {
    (found - expected).abs() < 1e-6
}

#[test]
fn a_grey_board_has_edges_and_contrasts_where_squares_meet() {
    // Squares of eight pixels, one two stops brighter: one in nine of the pairs along a row, 7 of 63.
    let board = measure(&grey(|x, y| if (x / 8 + y / 8) % 2 == 0 { 0.1 } else { 0.4 }), None);
    assert!(close(board.edge_density, 7.0 / 63.0), "{board:?}");
    assert!(close(board.log_contrast, 2.0 * 7.0 / 63.0) && close(board.log_luminance_spread, 1.0), "{board:?}");
    assert_eq!((board.saturation, board.saturation_spread, board.hue_entropy), (0.0, 0.0, 0.0));
    // Stripes have edges in one direction alone.
    let stripes = measure(&grey(|x, _| if x % 2 == 0 { 0.1 } else { 0.4 }), None);
    assert!(close(stripes.edge_density, 0.5) && close(stripes.log_contrast, 1.0), "{stripes:?}");
    // Steps too small to be seen are no edges, yet contrasts.
    let faint = measure(&grey(|x, _| if x % 2 == 0 { 0.2 } else { 0.21 }), None);
    assert!(faint.edge_density == 0.0 && close(faint.log_contrast, 0.5 * log2(1.05)), "{faint:?}");
}

#[test]
fn only_ratios_of_light_count() {
    let mut stream = Stream::new(1, &[]);
    let values: Vec<f32> = (0..3 * 64 * 64).map(|_| stream.uniform() as f32 + 0.05).collect();
    let image = Image::from_data(64, 64, 3, values).expect("fits");
    // By powers of two, so that rounding is the same.
    let (found, scaled) = (measure(&image, None), measure(&image.map(|v| v * 1024.0), None));
    let numbers = |of: &PictureStatistics| {
        [
            of.edge_density,
            of.spectrum_slope.expect("detail"),
            of.saturation,
            of.saturation_spread,
            of.hue_entropy,
            of.log_luminance_spread,
            of.log_contrast,
        ]
    };
    assert!(numbers(&found).into_iter().zip(numbers(&scaled)).all(|(a, b)| close(a, b)), "{found:?} {scaled:?}");
    assert!(found.spectrum_slope.expect("detail").abs() < 0.4, "white noise: {found:?}");
}

#[test]
fn black_pictures_and_pixels_have_numbers() {
    let black = measure(&grey(|_, _| 0.0), None);
    let none = PictureStatistics {
        edge_density: 0.0,
        spectrum_slope: None,
        saturation: 0.0,
        saturation_spread: 0.0,
        hue_entropy: 0.0,
        log_luminance_spread: 0.0,
        log_contrast: 0.0,
    };
    assert_eq!(black, none);
    // Half of it black: as dark as a ten thousandth of the mean.
    let half = measure(&grey(|x, _| if x < 32 { 0.0 } else { 1.0 }), None);
    assert!(close(half.log_luminance_spread, 0.5 * log2(1.0 / 0.5e-4)), "{half:?}");
}

#[test]
fn colours_have_their_saturation_and_hue() {
    let halves = |left: [f32; 3], right: [f32; 3]| measure(&picture(|x, _| if x < 32 { left } else { right }), None);
    let (red, green, white) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0; 3]);
    let one = halves(red, red);
    assert!((one.saturation, one.saturation_spread, one.hue_entropy) == (1.0, 0.0, 0.0), "{one:?}");
    let two = halves(red, green);
    assert!(close(two.saturation, 1.0) && close(two.hue_entropy, 1.0), "{two:?}");
    let pale = halves(red, white);
    assert!(close(pale.saturation, 0.5) && close(pale.saturation_spread, 0.5) && close(pale.hue_entropy, 0.0));
    // The three colours and those between two, one column each.
    let six = [red, [1.0, 1.0, 0.0], green, [0.0, 1.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]];
    let wheel = Image::from_data(6, 8, 3, vec![six.concat(); 8].concat()).expect("fits");
    let found = measure(&wheel, None);
    assert!(close(found.hue_entropy, log2(6.0)) && found.spectrum_slope.is_none(), "{found:?}");
    assert!(close(entropy(&[0.3; HUES]), log2(12.0)));
    // Classes lie about the colours: a little more of one neighbour or the other is the same hue.
    let near = [[1.0, 0.05, 0.0], [1.0, 0.0, 0.05], [0.95, 0.0, 0.0]].map(|rgb| saturation_and_hue(rgb).1);
    assert_eq!(near, [0; 3]);
    assert_eq!(six.map(|rgb| saturation_and_hue(rgb.map(f64::from)).1), [0, 2, 4, 6, 8, 10]);
}

#[test]
fn noise_makes_no_edges() {
    let mut stream = Stream::new(2, &[]);
    // Greys of mean 0.2 whose standard error is 0.05: about a stop from pixel to pixel at most.
    let values: Vec<f32> = (0..64 * 64).map(|_| (0.2 + 0.05 * stream.normal()).max(0.0) as f32).collect();
    let noisy = grey(|x, y| values[64 * y + x]);
    let variance = grey(|_, _| 0.05 * 0.05 * 16.0);
    let known = measure(&noisy, Some(Noise { variance: &variance, spp: 16 }));
    let blind = measure(&noisy, None);
    assert!(blind.edge_density > 0.5, "{blind:?}");
    assert!(known.edge_density < 0.03, "{known:?}");
    // An edge that no noise explains stays.
    let edge = grey(|x, y| values[64 * y + x] + if x < 32 { 0.0 } else { 10.0 });
    let found = measure(&edge, Some(Noise { variance: &variance, spp: 16 }));
    assert!(found.edge_density >= 64.0 / 8064.0, "{found:?}");
}

#[test]
fn thumbnails_are_means_of_blocks() {
    let small = thumbnail(&grey(|x, y| if x < 32 { 0.1 } else { 0.4 } + if (x + y) % 2 == 0 { 0.05 } else { -0.05 }));
    assert_eq!(small.len(), 256);
    let exposure = 0.18 / (0.1f64 * 0.4).sqrt();
    let shown = [0.1, 0.4].map(|value: f64| f64::from(preview((value * exposure) as f32)));
    assert!(small.iter().enumerate().all(|(i, v)| (v - shown[usize::from(i % 16 >= 8)]).abs() < 1e-5));
}
