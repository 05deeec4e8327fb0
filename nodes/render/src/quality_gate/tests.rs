//! Every reason of `quality_gate` on pictures made for it, on both sides of its threshold.

use super::*;
use tauflow_data::{Image, records::REASONS};

const SIDE: usize = 64;

fn image(value: impl Fn(usize, usize) -> f32) -> Image {
    let data = (0..SIDE).flat_map(|y| (0..SIDE).flat_map(move |x| [(x, y); 3])).map(|(x, y)| value(x, y)).collect();
    Image::from_data(SIDE, SIDE, 3, data).expect("fits")
}

/// A picture that nothing is wrong with: boards of two greys, each 16 pixels wide, in light that falls off slowly.
fn good() -> Image {
    image(|x, y| if (x / 16 + y / 16) % 2 == 0 { 0.15 } else { 0.5 } + 0.001 * x as f32)
}

/// The thresholds, but for things: most pictures here show none.
fn seen() -> QualityGateParams {
    QualityGateParams { to_see: 0.0, ..QualityGateParams::default() }
}

struct Case {
    picture: Image,
    variance: f32,
    rejected: u64,
    framing: Framing,
    params: QualityGateParams,
}

fn case(picture: Image) -> Case {
    Case { picture, variance: 0.0, rejected: 0, framing: Framing::default(), params: seen() }
}

impl Case {
    fn judged(&self, ev: f64) -> (Verdict, Exposure) {
        let variance = self.picture.map(|_| self.variance);
        let preview = Preview { image: &self.picture, variance: &variance, spp: 32, rejected: self.rejected };
        judge(&preview, &self.framing, &Things::card(), ev, &self.params)
    }

    fn reasons(&self) -> Vec<String> {
        self.judged(0.0).0.reasons
    }
}

/// Holds a threshold just beside a measure: on one side the reason is told, on the other it is not.
fn both_sides(case: &mut Case, reason: &str, measure: &str, at_most: bool, set: fn(&mut QualityGateParams, f64)) {
    let value = case.judged(0.0).0.measures[measure];
    for (factor, rejected) in [(1.0 - 1e-6, at_most), (1.0 + 1e-6, !at_most)] {
        set(&mut case.params, value * factor);
        let found = case.reasons();
        assert_eq!(found.contains(&reason.to_owned()), rejected, "{reason}, {measure} {value} x {factor}: {found:?}");
    }
}

#[test]
fn nothing_is_wrong_with_a_good_picture() {
    assert_eq!(case(good()).reasons(), [""; 0]);
    // Nor with it at another exposure, of any colour scale: only ratios count.
    assert_eq!(case(good().map(|v| 1e3 * v)).reasons(), [""; 0]);
    assert_eq!(case(good().map(|v| 1e-4 * v)).reasons(), [""; 0]);
}

#[test]
fn what_is_not_finite_is_found_in_pixels_variances_and_samples() {
    let broken = case(image(|x, _| if x == 3 { f32::NAN } else { 1.0 }));
    assert_eq!(broken.reasons(), ["non_finite"]);
    assert_eq!(broken.judged(0.0).0.measures["non_finite"], 3.0 * SIDE as f64);
    assert_eq!(Case { rejected: 2, ..case(good()) }.reasons(), ["non_finite"]);
    assert_eq!(Case { variance: f32::INFINITY, ..case(good()) }.reasons(), ["non_finite"]);
}

#[test]
fn framing_is_judged_whatever_the_picture_looks_like() {
    let all = Framing { inside: 0.61, near_share: 0.96, sky_share: 0.86, surface_share: 0.99, outlines: 0.0 };
    let told = ["inside", "too_near", "mostly_sky", "one_surface"];
    assert_eq!(Case { framing: all, ..case(good()) }.reasons(), told);
    let just = Framing { inside: 0.6, near_share: 0.95, sky_share: 0.85, surface_share: 0.98, outlines: 0.0 };
    assert_eq!(Case { framing: just, ..case(good()) }.reasons(), [""; 0]);
    let mut broken = case(image(|_, _| f32::NAN));
    broken.framing = all;
    assert_eq!(broken.reasons()[1..], told);
    // A share of 1 rejects nothing.
    let whole = Framing { inside: 1.0, near_share: 1.0, sky_share: 1.0, surface_share: 1.0, outlines: 0.0 };
    let lax = QualityGateParams { inside: 1.0, near_share: 1.0, sky_share: 1.0, surface_share: 1.0, ..seen() };
    assert_eq!(Case { framing: whole, params: lax, ..case(good()) }.reasons(), [""; 0]);
}

#[test]
fn black_is_a_mean_of_next_to_nothing() {
    assert_eq!(case(image(|_, _| 0.0)).reasons(), ["black"]);
    both_sides(&mut case(good()), "black", "mean_luminance", false, |p, v| p.black = v);
}

#[test]
fn dark_is_a_frame_of_which_most_shows_black() {
    // The upper rows are lit: 20 of 64, then 40.
    let lit = |rows: usize| image(move |x, y| if y < rows { 0.2 + 0.1 * ((x / 8) % 2) as f32 } else { 0.0 });
    assert!(case(lit(20)).reasons().contains(&"dark".to_owned()));
    assert!(!case(lit(40)).reasons().contains(&"dark".to_owned()));
    assert!((case(lit(20)).judged(0.0).0.measures["dark_share"] - 44.0 / 64.0).abs() < 1e-9);
    both_sides(&mut case(lit(20)), "dark", "dark_share", true, |p, v| p.dark_share = v);
    // A lamp in view that outshines all: the rest is exposed as well as ever, and nothing is dark.
    let lamp = image(|x, y| if x < 8 && y < 8 { 1e4 } else { good().pixel(x, y)[0] });
    assert!(!case(lamp).reasons().contains(&"dark".to_owned()));
}

#[test]
fn over_exposed_is_a_frame_of_which_much_shows_white() {
    let bright =
        |columns: usize| image(move |x, y| if x < columns { 100.0 } else { 0.1 + 0.05 * ((y / 8) % 2) as f32 });
    assert!(case(bright(20)).reasons().contains(&"over_exposed".to_owned()));
    assert!(!case(bright(12)).reasons().contains(&"over_exposed".to_owned()));
    both_sides(&mut case(bright(20)), "over_exposed", "bright_share", true, |p, v| p.bright_share = v);
}

#[test]
fn near_constant_and_featureless_are_frames_with_nothing_to_see() {
    assert_eq!(case(image(|_, _| 0.3)).reasons(), ["near_constant", "featureless"]);
    both_sides(&mut case(good()), "near_constant", "contrast", false, |p, v| p.contrast = v);
    // A gradient has contrast and no edge; a horizon is one side long.
    let gradient = case(image(|_, y| 0.2 + 0.01 * y as f32));
    assert_eq!(gradient.reasons(), ["featureless"]);
    let horizon = case(image(|_, y| if y < 32 { 0.6 } else { 0.2 }));
    assert_eq!(horizon.reasons(), ["featureless"]);
    assert_eq!(horizon.judged(0.0).0.measures["edges"], 1.0);
    // A box of half the frame's side before it adds two sides.
    let block = case(image(|x, y| match (x, y) {
        (16..48, 16..48) => 0.05,
        (_, 0..32) => 0.6,
        _ => 0.2,
    }));
    assert_eq!(block.reasons(), [""; 0]);
    assert_eq!(block.judged(0.0).0.measures["edges"], 2.5);
    both_sides(&mut case(good()), "featureless", "edges", false, |p, v| p.edges = v);
}

#[test]
fn noise_is_no_edge() {
    // Bins of 0.3 and 0.45; the mean of 512 samples of variance 0.5 has a standard error of 0.03.
    let rough = |variance: f32| {
        let boards = image(|x, y| if (x / 4 + y / 4) % 2 == 0 { 0.3 } else { 0.45 });
        Case { variance, ..case(boards) }
    };
    assert_eq!((rough(0.0).reasons(), rough(0.0).judged(0.0).0.measures["edges"]), (Vec::new(), 30.0));
    assert_eq!(rough(0.5).judged(0.0).0.measures["edges"], 0.0);
    assert_eq!(rough(0.5).reasons(), ["featureless"]);
    // Where surfaces have outlines, noise may hide as many edges: a noisy picture of many things is no empty one.
    let outlined = |outlines: f64| Framing { outlines, ..Framing::default() };
    assert_eq!(Case { framing: outlined(1.2), ..rough(0.5) }.reasons(), [""; 0]);
    assert_eq!(Case { framing: outlined(1.0), ..rough(0.5) }.reasons(), ["featureless"]);
    // Outlines that nothing shows are no edges.
    assert_eq!(Case { framing: outlined(9.0), ..case(image(|_, y| 0.2 + 0.01 * y as f32)) }.reasons(), ["featureless"]);
}

#[test]
fn degenerate_is_all_light_in_few_places() {
    let one_lamp = || image(|x, y| if (x, y) == (9, 9) { 1e5 } else { good().pixel(x, y)[0] });
    assert!(case(one_lamp()).reasons().contains(&"degenerate".to_owned()));
    both_sides(&mut case(one_lamp()), "degenerate", "concentration", true, |p, v| p.concentration = v);
}

#[test]
fn little_to_see_is_a_frame_in_which_no_thing_stands_out_from_noise() {
    let card = |value: f32| image(move |x, y| if (16..32).contains(&x) && (16..32).contains(&y) { value } else { 0.2 });
    let judged = |value: f32, variance: f32| {
        let case = Case { variance, ..case(card(value)) };
        Case { params: QualityGateParams { edges: 0.0, contrast: 0.0, ..Default::default() }, ..case }
    };
    assert_eq!(judged(0.2, 0.0).reasons(), ["little_to_see"]);
    assert_eq!(judged(0.4, 0.0).reasons(), [""; 0]);
    // The mean of 512 samples of variance 0.5 has a standard error of 0.03, which is 0.15 of what most bins show.
    let (clear, grainy) = (judged(0.4, 0.0).judged(0.0).0.measures, judged(0.4, 0.5).judged(0.0).0.measures);
    assert!((grainy["noise"] - (0.5f64 / 512.0).sqrt() / 0.2).abs() < 1e-4, "{grainy:?}");
    let expected = clear["to_see"] * GRAIN / (GRAIN + grainy["noise"]);
    assert!((grainy["to_see"] - expected).abs() < 1e-9, "{grainy:?}");
    both_sides(&mut judged(0.4, 0.5), "little_to_see", "to_see", false, |p, v| p.to_see = v);
    // At any exposure the same is to be seen.
    let bright = Case { picture: card(0.4).map(|v| 1e3 * v), ..judged(0.4, 0.0) };
    assert!((bright.judged(0.0).0.measures["to_see"] / clear["to_see"] - 1.0).abs() < 1e-4);
}

#[test]
fn noisy_is_a_frame_full_of_noise_whatever_its_brightest_pixels_do() {
    // Bins of 0.15 and of 0.5 and more; a standard error of 0.1 is more than a quarter of the former alone.
    let params = QualityGateParams { edges: 0.0, ..seen() };
    let mut half = Case { variance: 0.1 * 0.1 * 512.0, params, ..case(good()) };
    let (verdict, _) = half.judged(0.0);
    assert_eq!(verdict.measures["noisy_share"], 0.5);
    assert!(verdict.reasons == ["noisy"] && verdict.measures["noise"] < 0.7, "{verdict:?}");
    both_sides(&mut half, "noisy", "noisy_share", true, |p, v| p.noisy_share = v);
    // A few pixels that fail: nothing that spoils the frame.
    let few = image(|x, y| if x < 4 && y < 16 { 512.0 } else { 0.0 });
    let picture = good();
    let preview = Preview { image: &picture, variance: &few, spp: 32, rejected: 0 };
    let (verdict, _) = judge(&preview, &Framing::default(), &Things::card(), 0.0, &seen());
    assert_eq!((verdict.measures["noisy_share"], verdict.reasons), (4.0 / 256.0, Vec::new()));
}

#[test]
fn every_reason_is_explained() {
    let all = Framing { inside: 1.0, near_share: 1.0, sky_share: 1.0, surface_share: 1.0, outlines: 0.0 };
    let mut flat = Case { framing: all, rejected: 1, variance: 1e6, ..case(image(|_, _| 0.3)) };
    flat.params = QualityGateParams::default();
    let mixed = Case { variance: 1e6, ..case(image(|x, y| if (x, y) == (9, 9) { 1e9 } else { 0.0 })) };
    let bright = case(image(|x, _| if x < 20 { 1e3 } else { 0.1 }));
    let found: Vec<String> = [flat, mixed, bright, case(image(|_, _| 0.0))].iter().flat_map(Case::reasons).collect();
    for (reason, _) in REASONS {
        assert!(found.iter().any(|of| of == reason), "`{reason}` is told by no case: {found:?}");
    }
    assert!(found.iter().all(|of| REASONS.iter().any(|(reason, _)| reason == of)), "{found:?}");
}

#[test]
fn exposure_brings_the_geometric_mean_to_mid_grey_and_no_threshold_moves_it() {
    let mut case = Case { variance: 0.1, ..case(image(|x, _| if x < 32 { 2.0 } else { 8.0 })) };
    let (verdict, exposure) = case.judged(0.0);
    assert!((exposure.mean_luminance - 4.0).abs() < 1e-5 && (exposure.factor - 0.045).abs() < 1e-7);
    assert_eq!(verdict.measures[Verdict::EXPOSURE], exposure.factor);
    case.params = QualityGateParams { contrast: 0.9, edges: 0.0, ..seen() };
    let (verdict, same) = case.judged(0.0);
    assert_eq!(same, exposure);
    assert_eq!(verdict.reasons, ["near_constant"]);
    let (_, brighter) = case.judged(1.0);
    assert!((brighter.factor / exposure.factor - 2.0).abs() < 1e-12);
}
