//! `tauflow denoise`: images of any renderer, by the layers that they have.

use crate::Place;
use std::fs;
use tauflow_data::{
    Image,
    image_io::{ExrLayer, exr_file, read_exr},
    rng::Stream,
};

const WIDTH: usize = 40;
const HEIGHT: usize = 24;

/// A striped wall under noise; radiance, albedo and normal.
fn layers() -> [Image; 3] {
    let mut stream = Stream::new(5, &[]);
    let mut images = [0, 1, 2].map(|_| Image::new(WIDTH, HEIGHT, 3));
    for i in 0..WIDTH * HEIGHT {
        let albedo = if (i % WIDTH / 8).is_multiple_of(2) { 0.2 } else { 0.8 };
        let at = (i % WIDTH, i / WIDTH);
        images[0].pixel_mut(at.0, at.1).fill((albedo * -(1.0 - stream.uniform()).ln()) as f32);
        images[1].pixel_mut(at.0, at.1).fill(albedo as f32);
        images[2].pixel_mut(at.0, at.1).copy_from_slice(&[0.0, 0.0, 1.0]);
    }
    images
}

fn write(place: &Place, name: &str, layers: &[(&str, &[&str], &Image)]) {
    let layers: Vec<ExrLayer<'_>> =
        layers.iter().map(|(name, letters, image)| ExrLayer { name, letters, image }).collect();
    fs::write(place.path(name), exr_file(&layers).expect("fits")).expect("writable");
}

const RGB: &[&str] = &["R", "G", "B"];
const XYZ: &[&str] = &["X", "Y", "Z"];

fn read(place: &Place, name: &str) -> Image {
    read_exr(&place.path(name)).expect("an EXR").remove("").expect("unnamed")
}

/// Mean squared distance to what was drawn.
fn error(image: &Image, albedo: &Image) -> f64 {
    let apart = image.data().iter().zip(albedo.data()).map(|(a, b)| f64::from(a - b).powi(2));
    apart.sum::<f64>() / image.data().len() as f64
}

#[test]
fn images_of_any_renderer_are_denoised_by_the_layers_that_they_have() {
    let place = Place::new();
    let [noisy, albedo, normal] = layers();
    let away = normal.map(|value| -value);
    write(&place, "ours.exr", &[("", RGB, &noisy), ("albedo", RGB, &albedo), ("normal", XYZ, &normal)]);
    write(
        &place,
        "blender.exr",
        &[
            ("ViewLayer.Noisy Image", RGB, &noisy),
            ("ViewLayer.Combined", RGB, &albedo),
            ("ViewLayer.Denoising Albedo", RGB, &albedo),
            ("ViewLayer.Denoising Normal", XYZ, &away),
        ],
    );
    write(&place, "alone.exr", &[("", RGB, &noisy)]);
    write(&place, "oidn.hdr.exr", &[("", RGB, &noisy)]);
    write(&place, "oidn.alb.exr", &[("", RGB, &albedo)]);
    write(&place, "oidn.nrm.exr", &[("", RGB, &normal)]);
    let denoise = |image: &str, more: &[&str]| place.tauflow(&[&["denoise", image], more].concat());
    let of = |image: &str, more: &[&str], part: &str| {
        let said = denoise(image, &[&["-o", "out.exr"], more].concat()).ends(0);
        assert!(said.out == "out.exr\n" && said.err.contains(part), "{}", said.err);
        read(&place, "out.exr")
    };
    let whole = of("ours.exr", &[], "albedo and normals");
    assert!(error(&whole, &albedo) < 0.25 * error(&noisy, &albedo), "{}", error(&whole, &albedo));
    assert!(of("blender.exr", &[], "the layer `ViewLayer.Noisy Image`") == whole);
    assert!(of("oidn.hdr.exr", &[], "albedo and normals") == whole);
    let parts = ["--albedo", "oidn.alb.exr", "--normal", "oidn.nrm.exr"];
    assert!(of("alone.exr", &parts, "albedo and normals") == whole);
    let rgb = of("alone.exr", &[], "RGB alone");
    assert!(of("ours.exr", &["--rgb"], "RGB alone") == rgb && rgb != whole);
    assert!(of("ours.exr", &["--tile", "16"], "albedo and normals") == whole);
    let fast = of("ours.exr", &["--weights", "fast"], "albedo and normals");
    assert!(fast != whole && of("ours.exr", &["--mirrors", "8"], "albedo") != whole);
    assert!(of("ours.exr", &["--strength", "0"], "albedo") == noisy);
    of("ours.exr", &["--spp", "4", "--exposure", "0.5"], "exposure 0.5000");
    let alpha = Image::from_data(WIDTH, HEIGHT, 1, (0..WIDTH * HEIGHT).map(|i| i as f32).collect()).expect("fits");
    let cut_out = noisy.beside(&alpha).expect("as large");
    write(&place, "alpha.exr", &[("", &["R", "G", "B", "A"], &cut_out)]);
    assert!(of("alpha.exr", &[], "RGB alone") == rgb);
    let kept = fs::read(place.path("out.exr")).expect("written");
    let channels =
        exr::meta::MetaData::read_from_buffered(&kept[..], false).expect("own").headers[0].channels.list.len();
    let kept = exr::prelude::read_first_flat_layer_from_file(place.path("out.exr")).expect("own");
    let kept = kept.layer_data.channel_data.list.iter().find(|c| c.name.to_string() == "A").expect("alpha");
    assert!(channels == 4 && kept.sample_data.values_as_f32().eq(alpha.data().iter().copied()));
    denoise("ours.exr", &["-o", "out.png"]).ends(0);
    assert!(fs::read(place.path("out.png")).expect("written").starts_with(b"\x89PNG"));

    assert!(denoise("ours.exr", &["-o", "x.exr", "--model", "x", "--weights", "fast"]).ends(2).err.contains("--model"));

    // The variance: noise-free by what it says, or of single samples.
    let zero = Image::new(WIDTH, HEIGHT, 3);
    let layers = [("", RGB, &noisy), ("variance", RGB, &zero), ("Variance", RGB, &albedo)];
    write(&place, "variance.exr", &layers);
    let kept = of("variance.exr", &["--variance", "variance"], "% of the noisy image kept");
    assert!(error(&kept, &noisy) < 0.1 * error(&rgb, &noisy));
    of("variance.exr", &["--variance", "Variance", "--per-sample", "--spp", "4"], "kept");
    let error = denoise("variance.exr", &["-o", "x.exr", "--variance", "Variance", "--per-sample"]).ends(2).err;
    assert!(error.contains("--spp"), "{error}");
    let one = ["--variance", "variance", "--per-sample", "--spp", "1", "-o", "x.exr"];
    let error = denoise("variance.exr", &one).ends(2).err;
    assert!(error.contains("one sample per pixel has no variance; leave --variance and --per-sample out"), "{error}");
    assert!(!place.path("x.exr").exists());
}

#[test]
fn folders_are_denoised_and_one_bad_image_does_not_stop_the_others() {
    let place = Place::new();
    let [noisy, albedo, normal] = layers();
    fs::create_dir(place.path("frames")).expect("writable");
    write(&place, "frames/b.exr", &[("", RGB, &noisy)]);
    write(&place, "frames/a.hdr.exr", &[("", RGB, &noisy)]);
    write(&place, "frames/a.alb.exr", &[("", RGB, &albedo)]);
    write(&place, "frames/a.nrm.exr", &[("", RGB, &normal)]);
    let said = place.tauflow(&["denoise", "frames", "-o", "clean"]).ends(0);
    assert_eq!(said.out, "clean/a.hdr.exr\nclean/b.exr\n");
    fs::write(place.path("frames/c.exr"), b"no picture").expect("writable");
    let said = place.tauflow(&["denoise", "frames", "-o", "clean"]).ends(1);
    assert!(said.out.ends_with("clean/b.exr\n"), "{}", said.out);
    assert!(said.err.contains("frames/c.exr: ") && said.err.contains("1 of 3 images failed"), "{}", said.err);
    let told = |args: &[&str], part: &str| {
        let error = place.tauflow(&[&["denoise"], args].concat()).ends(2).err;
        assert!(error.contains(part), "{error}");
    };
    told(&["frames", "-o", "frames"], "would be overwritten");
    told(&["frames/b.exr", "-o", "frames/b.exr"], "would be overwritten");
    told(&["frames", "-o", "new.exr"], "names one image");
    told(&["frames/b.exr", "clean/b.exr", "-o", "all"], "have the same name");
    told(&["clean", "-o", "frames/c.exr"], "is a file");
    fs::create_dir(place.path("none")).expect("writable");
    told(&["none", "-o", "clean"], "no .exr files");
    told(&["frames/b.exr", "-o", "x.txt"], "must end in .exr or .png");
    told(&["frames/b.exr", "-o", "x.exr", "--layer", "beauty"], "no layer `beauty`");
    told(&["frames/none.exr", "-o", "x.exr"], "frames/none.exr");
    told(&["frames/b.exr", "-o", "x.exr", "--model", "frames/c.exr"], "not a model file");
}

#[test]
fn no_file_that_is_read_is_written_over() {
    let place = Place::new();
    let [noisy, albedo, normal] = layers();
    for (name, image) in [("ok.exr", &noisy), ("A.exr", &albedo), ("N.exr", &normal)] {
        write(&place, name, &[("", RGB, image)]);
    }
    for (name, image) in [("o.hdr.exr", &noisy), ("o.alb.exr", &albedo), ("o.nrm.exr", &normal)] {
        write(&place, name, &[("", RGB, image)]);
    }
    fs::create_dir(place.path("out")).expect("writable");
    for (link, to) in [("link.exr", "A.exr"), ("out/ok.exr", "../N.exr")] {
        std::os::unix::fs::symlink(to, place.path(link)).expect("writable");
    }
    let parts = ["--albedo", "A.exr", "--normal", "N.exr"];
    for (image, more, out, read) in [
        ("ok.exr", &parts[..], "A.exr", "A.exr"),
        ("ok.exr", &parts, "N.exr", "N.exr"),
        ("ok.exr", &parts, "link.exr", "A.exr"),
        ("o.hdr.exr", &[], "o.alb.exr", "o.alb.exr"),
        ("ok.exr", &[], "ok.exr", "ok.exr"),
    ] {
        let before = fs::read(place.path(out)).expect("written");
        let said = place.tauflow(&[&["denoise", image, "-o", out], more].concat()).ends(2);
        assert!(said.err.contains(&format!("{read} is read, and would be overwritten")), "{}", said.err);
        assert!(fs::read(place.path(out)).expect("still there") == before, "{out}");
    }
    // A result is not written over another one's image, either.
    let said = place.tauflow(&["denoise", "ok.exr", "N.exr", "-o", "out"]).ends(2);
    assert!(said.err.contains("N.exr is read, and would be overwritten by the result out/ok.exr"), "{}", said.err);
}

#[test]
fn odd_images_are_told_of() {
    let place = Place::new();
    let [mut noisy, albedo, normal] = layers();
    noisy.pixel_mut(3, 2).fill(f32::NAN);
    noisy.pixel_mut(4, 4)[0] = -0.5;
    noisy.pixel_mut(5, 5)[1] = 65504.0;
    let mapped = normal.map(|value| 0.5 * value + 0.5);
    write(&place, "odd.exr", &[("", RGB, &noisy), ("albedo", RGB, &albedo), ("normal", XYZ, &mapped)]);
    let said = place.tauflow(&["denoise", "odd.exr", "-o", "out.exr"]).ends(0);
    for part in ["1 of 960 pixels of radiance", "1 values are negative", "1 values are 65504", "2 n - 1"] {
        assert!(said.err.contains(part), "{part}: {}", said.err);
    }
    assert!(read(&place, "out.exr").data().iter().all(|value| value.is_finite()));
    write(&place, "half.exr", &[("", RGB, &albedo), ("albedo", RGB, &albedo)]);
    let said = place.tauflow(&["denoise", "half.exr", "-o", "out.exr"]).ends(0);
    assert!(said.err.contains("it has albedo, but no normals") && said.err.contains("RGB alone"), "{}", said.err);
    let small = Image::new(8, 8, 3);
    write(&place, "small.exr", &[("", RGB, &small)]);
    let parts = ["denoise", "half.exr", "-o", "x.exr", "--albedo", "small.exr", "--normal", "small.exr"];
    let error = place.tauflow(&parts).ends(2).err;
    assert!(error.contains("8 x 8 pixels, but the radiance has 40 x 24"), "{error}");
    write(&place, "nothing.exr", &[("", RGB, &albedo.map(|_| f32::NAN))]);
    let error = place.tauflow(&["denoise", "nothing.exr", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("nothing.exr: ") && error.contains("no finite pixel"), "{error}");
    // An exposure of which nothing is left.
    let error = place.tauflow(&["denoise", "half.exr", "--exposure", "1e-300", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("half.exr: ") && error.contains("raise the exposure"), "{error}");
    let error = place.tauflow(&["denoise", "half.exr", "--exposure", "1e300", "-o", "x.exr"]).ends(2).err;
    assert!(error.contains("values of the exposed image are not finite; lower the exposure"), "{error}");
    assert!(!place.path("x.exr").exists());
    // All black: nothing to see, and nothing to divide by.
    write(&place, "black.exr", &[("", RGB, &small)]);
    place.tauflow(&["denoise", "black.exr", "-o", "out.exr"]).ends(0);
    assert!(read(&place, "out.exr").data().iter().all(|value| value.abs() < 1e-6));
}
