use super::*;
use tauflow_data::rng::Stream;
use tauflow_train::Precision;

fn made_up(width: usize, height: usize, channels: usize, seed: u64) -> Image {
    let mut stream = Stream::new(seed, &[]);
    let mut data: Vec<f32> = (0..width * height * channels).map(|_| stream.range(0.0, 1.0) as f32).collect();
    // A few fireflies.
    for _ in 0..data.len() / 500 {
        let at = stream.below(data.len());
        data[at] *= if channels == 3 { 80.0 } else { 1.0 };
    }
    Image::from_data(width, height, channels, data).expect("fits")
}

fn quiet(_: usize, _: usize) -> Result<(), KindError> {
    Ok(())
}

fn frame(width: usize, height: usize) -> Frame {
    let frame = Frame::new(made_up(width, height, 3, 1)).expect("finite");
    frame.with_gbuffer(made_up(width, height, 6, 2)).expect("fits")
}

#[test]
fn bundled_models_load_and_are_local_and_need_no_count() {
    for weights in Weights::ALL {
        for conditioning in [Conditioning::Rgb, Conditioning::Gbuffer] {
            let model = weights.model(conditioning).expect("a file of this repository");
            let info = model.info();
            assert_eq!((info.conditioning, info.preset.name()), (conditioning, weights.name()));
            assert!(info.unknown_counts && model.reach().is_some_and(|reach| reach < 200), "{info:?}");
            let rounded = |precision| model.to_rounded_bytes(precision).expect("small weights");
            let same = |precision| rounded(precision) == weights.bytes(conditioning);
            assert!([Precision::Half, Precision::Integers].into_iter().any(same), "{info:?}");
        }
    }
}

/// The BLAKE3 digests of `models/README.md`, of a file and of what it makes of a fixed image.
#[test]
fn files_and_their_bits_are_those_of_the_model_card() {
    let card = include_str!("../../../../../models/README.md");
    let (frame, mut missing) = (frame(61, 47), String::new());
    for weights in Weights::ALL {
        let denoiser = Denoiser::built_in(weights).expect("bundled");
        for (conditioning, gbuffer) in [(Conditioning::Rgb, false), (Conditioning::Gbuffer, true)] {
            let settings = Settings { exposure: Some(1.0), gbuffer, ..Settings::default() };
            let image = denoiser.denoise(&frame, &settings, &mut quiet).expect("fine").image;
            let bits: Vec<u8> = image.data().iter().flat_map(|value| value.to_le_bytes()).collect();
            let short = |bytes: &[u8]| blake3::hash(bytes).to_hex()[..16].to_owned();
            let (name, file) = (weights.name(), weights.bytes(conditioning));
            let row = format!(
                "| `{name}_{}.safetensors` | {} | `{}` | `{}` |",
                conditioning.name(),
                file.len(),
                short(file),
                short(&bits)
            );
            if !card.contains(&row) {
                missing += &format!("{row}\n");
            }
        }
    }
    assert!(missing.is_empty(), "models/README.md lacks these rows:\n{missing}");
}

/// The network's convolutions are computed in squares of pixels that a tile's border cuts: sums are rounded otherwise.
#[test]
fn tiles_differ_from_the_whole_image_by_rounding_alone() {
    // Larger than a tile with all that a network looks at around it, in both directions.
    let frame = frame(330, 420);
    for weights in Weights::ALL {
        let denoiser = Denoiser::built_in(weights).expect("bundled");
        for (gbuffer, views) in [(false, 1), (true, 1), (true, 2)] {
            let of = |tile| {
                let views = Views::try_from(views).expect("a number of views");
                let settings = Settings { tile, gbuffer, views, ..Settings::default() };
                denoiser.denoise(&frame, &settings, &mut quiet).expect("fine").image
            };
            let (whole, tiled) = (of(None), of(Some(64)));
            let apart = |(a, b): (&f32, &f32)| (a - b).abs() / a.abs().max(0.01);
            let most = whole.data().iter().zip(tiled.data()).map(apart).fold(0.0f32, f32::max);
            assert!(most < 2e-5, "{most}: {weights:?}, G-buffers {gbuffer}, {views} views");
        }
    }
}

#[test]
fn an_image_denoised_in_place_has_the_bits_of_another() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let frame = frame(90, 210);
    let mut bright = frame.radiance().clone();
    bright.pixel_mut(70, 90).fill(3e30);
    let bright = Frame::new(bright).expect("finite");
    // Tiles smaller than what the network looks at, so that rows are kept from two rows of tiles; and one tile.
    for (frame, gbuffer) in [(&frame, true), (&bright, false)] {
        for (tile, strength) in [(Some(64), 1.0), (Some(96), 0.5), (None, 1.0)] {
            let settings = Settings { tile, strength, gbuffer, ..Settings::default() };
            let expected = denoiser.denoise(frame, &settings, &mut quiet).expect("fine");
            let mut calls = Vec::new();
            let mut progress = |done, of| {
                calls.push((done, of));
                Ok(())
            };
            let found = denoiser.denoise_in_place(frame.clone(), &settings, &mut progress).expect("fine");
            assert!(found.image == expected.image, "{settings:?}");
            assert_eq!((found.exposure, found.with_gbuffer), (expected.exposure, expected.with_gbuffer));
            assert!(calls.last().is_some_and(|(done, of)| done == of && *of == calls.len()), "{calls:?}");
        }
    }
    // A mix needs the whole image.
    let mixed = frame.clone().with_variance(Image::new(90, 210, 3), Some(64)).expect("fits");
    let settings = Settings { tile: Some(96), ..Settings::default() };
    let expected = denoiser.denoise(&mixed, &settings, &mut quiet).expect("fine");
    let found = denoiser.denoise_in_place(mixed, &settings, &mut quiet).expect("fine");
    assert!(found.image == expected.image && found.kept == expected.kept);
}

#[test]
fn features_in_two_images_have_the_bits_of_one() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let together = frame(75, 40);
    let gbuffer = together.features().expect("given").whole().into_owned();
    let apart = Frame::new(together.radiance().clone()).expect("finite");
    let apart = apart.with_features(gbuffer.channels_of(0..3), gbuffer.channels_of(3..6)).expect("fits");
    for (views, tile) in [(1, None), (1, Some(32)), (2, Some(32))] {
        let views = Views::try_from(views).expect("a number of views");
        let settings = Settings { tile, views, ..Settings::default() };
        let [a, b] =
            [&together, &apart].map(|frame| denoiser.denoise(frame, &settings, &mut quiet).expect("fine").image);
        assert!(a == b, "{settings:?}");
    }
}

#[test]
fn the_exposure_of_the_frame_does_not_matter() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let frame = frame(40, 24);
    let of = |frame: &Frame| denoiser.denoise(frame, &Settings::default(), &mut quiet).expect("fine").image;
    let plain = of(&frame);
    for factor in [1.0 / 1024.0, 4096.0] {
        let brighter = Frame::new(frame.radiance().map(|value| value * factor)).expect("finite");
        let gbuffer = frame.features().expect("given").whole().into_owned();
        let brighter = of(&brighter.with_gbuffer(gbuffer).expect("fits"));
        let apart = |(a, b): (&f32, &f32)| (a - b * factor).abs() <= 1e-4 * (a.abs() + factor);
        assert!(brighter.data().iter().zip(plain.data()).all(apart), "{factor}");
    }
}

#[test]
fn an_exposure_that_leaves_no_light_is_refused() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let lit = Frame::new(made_up(40, 24, 3, 1)).expect("finite");
    let of = |frame: &Frame, exposure: f64, tile| {
        let settings = Settings { exposure: Some(exposure), tile, ..Settings::default() };
        let made = denoiser.denoise(frame, &settings, &mut quiet).map(|denoised| denoised.image);
        let in_place = denoiser.denoise_in_place(frame.clone(), &settings, &mut quiet).map(|denoised| denoised.image);
        assert_eq!(made.as_ref().ok(), in_place.as_ref().ok());
        made.map_err(|error| error.to_string())
    };
    for tile in [None, Some(16)] {
        let told = of(&lit, 1e-300, tile).expect_err("nothing is left");
        assert!(told.contains("an exposure of 1e-300 makes the exposed image black; raise the exposure"), "{told}");
        let told = of(&lit, 1e300, tile).expect_err("too much");
        assert!(told.contains("values of the exposed image are not finite; lower the exposure"), "{told}");
    }
    // A part of an image may be black, and so may all of it.
    let mut half = lit.radiance().clone();
    half.data_mut()[..3 * 40 * 16].fill(0.0);
    of(&Frame::new(half).expect("finite"), 0.5, Some(16)).expect("the other half has light");
    of(&Frame::new(Image::new(40, 24, 3)).expect("finite"), 1.0, None).expect("there was none");
}

#[test]
fn a_black_background_has_no_share_in_the_exposure_which_is_four_times_as_bright() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let own = made_up(48, 32, 3, 1);
    let mut framed = Image::new(120, 80, 3);
    for (y, row) in own.data().chunks_exact(3 * 48).enumerate() {
        (0..48).for_each(|x| framed.pixel_mut(x + 24, y + 40).copy_from_slice(&row[3 * x..3 * x + 3]));
    }
    let [own, framed, black] = [own, framed, Image::new(24, 16, 3)].map(|image| {
        let frame = Frame::new(image).expect("finite");
        denoiser.denoise(&frame, &Settings::default(), &mut quiet).map(|denoised| denoised.exposure)
    });
    let (own, framed) = (own.expect("fine"), framed.expect("fine"));
    assert!((framed / own - 4.0).abs() < 1e-8, "{own} {framed}");
    assert!(black.is_ok_and(f64::is_finite));
}

#[test]
fn a_told_count_leaves_no_more_noise_than_an_unknown_one() {
    // Grey noise of 32 samples on a grey wall.
    let mut stream = Stream::new(9, &[]);
    let grey = |stream: &mut Stream| (0..32).map(|_| -(1.0 - stream.uniform()).ln()).sum::<f64>() as f32 / 32.0;
    let data = (0..96 * 96).flat_map(|_| [grey(&mut stream); 3]).collect();
    let frame = Frame::new(Image::from_data(96, 96, 3, data).expect("fits")).expect("finite");
    let denoiser = Denoiser::built_in(Weights::Best).expect("bundled");
    let error = |spp| {
        let settings = Settings { spp, ..Settings::default() };
        let image = denoiser.denoise(&frame, &settings, &mut quiet).expect("fine").image;
        image.data().iter().map(|value| f64::from(value - 1.0).powi(2)).sum::<f64>() / image.data().len() as f64
    };
    let noise = 1.0 / 32.0;
    assert!(error(Some(32)) < 0.1 * noise && error(None) < 0.1 * noise, "{} {}", error(Some(32)), error(None));
}

#[test]
fn light_of_one_colour_and_objects_before_what_is_nearly_black_are_denoised() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let noise = |width: usize, height: usize| made_up(width, height, 3, 4).map(|value| value.min(1.0));
    let spread = |image: &Image, of: &dyn Fn(usize) -> bool| {
        let values: Vec<f64> = (0..image.data().len()).filter(|i| of(*i)).map(|i| f64::from(image.data()[i])).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    };
    // One lit colour in images of sizes that are, and are not, multiples of those of the samples; and most of the image
    // at the least number of half precision.
    for (width, height) in [(96, 96), (256, 256), (260, 252)] {
        for lit in 0..3 {
            let mut image = noise(width, height);
            image.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v *= if i % 3 == lit { 1.0 } else { 1e-7 });
            let made = denoiser.denoise(&Frame::new(image.clone()).expect("finite"), &Settings::default(), &mut quiet);
            let [before, after] = [&image, &made.expect("fine").image].map(|image| spread(image, &|i| i % 3 == lit));
            assert!(after < 0.4 * before, "{width} x {height}, {lit}: {before} {after}");
        }
        for (part, most) in [(40, 0.4), (15, 0.5), (4, 0.7)] {
            let mut image = noise(width, height);
            let dark = 3 * width * ((100 - part) * height / 100);
            image.data_mut()[..dark].fill(6e-8);
            let made = denoiser.denoise(&Frame::new(image.clone()).expect("finite"), &Settings::default(), &mut quiet);
            let made = made.expect("fine");
            let [before, after] = [&image, &made.image].map(|image| spread(image, &|i| i > dark));
            let exposure = made.exposure;
            assert!(
                after < most * before && exposure < 10.0,
                "{width} x {height}, {part}%: {before} {after} {exposure}"
            );
        }
    }
}

#[test]
fn one_pixel_of_any_brightness_does_not_reach_the_others() {
    let denoiser = Denoiser::built_in(Weights::Best).expect("bundled");
    let plain = made_up(64, 64, 3, 4).map(|value| value.min(1.0));
    let far = |firefly: f32| {
        let mut image = plain.clone();
        image.pixel_mut(10, 10).fill(firefly);
        let frame = Frame::new(image).expect("finite");
        let settings = Settings::default();
        let denoised = denoiser.denoise(&frame, &settings, &mut quiet).expect("fine").image;
        (0..64usize * 64).filter(|i| i % 64 > 50 && i / 64 > 50).map(|i| denoised.data()[3 * i]).collect::<Vec<_>>()
    };
    let expected = far(0.5);
    for firefly in [1e6, 1e12, 3e38] {
        let apart = far(firefly).iter().zip(&expected).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(apart < 0.3, "{firefly}: {apart}");
    }
}

#[test]
fn strength_mixes_and_sizes_are_any() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    for (width, height) in [(1, 1), (1, 50), (3, 2), (17, 31)] {
        let frame = frame(width, height);
        let of = |strength| {
            let settings = Settings { strength, ..Settings::default() };
            denoiser.denoise(&frame, &settings, &mut quiet).expect("fine").image
        };
        assert!(of(0.0) == *frame.radiance());
        let (whole, half) = (of(1.0), of(0.5));
        assert!((whole.width(), whole.height()) == (width, height));
        for ((half, whole), noisy) in half.data().iter().zip(whole.data()).zip(frame.radiance().data()) {
            assert!((half - 0.5 * (whole + noisy)).abs() <= 1e-5 * noisy.abs().max(1.0));
        }
    }
    let settings = Settings { strength: 1.5, ..Settings::default() };
    assert!(denoiser.denoise(&frame(4, 4), &settings, &mut quiet).expect_err("above 1").to_string().contains("1.5"));
}

#[test]
fn a_noise_free_image_is_kept_where_the_variance_says_so() {
    let denoiser = Denoiser::built_in(Weights::Fast).expect("bundled");
    let (noisy, zero) = (frame(64, 48), Image::new(64, 48, 3));
    let kept = noisy.clone().with_variance(zero, Some(64)).expect("fits");
    let kept = denoiser.denoise(&kept, &Settings::default(), &mut quiet).expect("fine");
    assert!(kept.kept.expect("a variance") > 0.75, "{:?}", kept.kept);
    // As much noise as there is light.
    let large = noisy.radiance().map(|value| value * value + 1.0);
    let denoised = noisy.with_variance(large, None).expect("fits");
    let denoised = denoiser.denoise(&denoised, &Settings::default(), &mut quiet).expect("fine");
    assert!(denoised.kept.expect("a variance") < 0.05);
}
