//! pbrt's files, by the features of its file format.

use super::*;
use tauflow_data::scene::{Emitter, Rgb};

/// A file of pbrt: a camera, and what stands in its world.
fn pbrt(before: &str, world: &str) -> String {
    format!(
        "LookAt 0 1 5  0 1 0  0 1 0\n{before}\nFilm \"rgb\" \"integer xresolution\" 200 \"integer yresolution\" 100\n\
         WorldBegin\n{world}\n"
    )
}

const CAMERA: &str = "Camera \"perspective\" \"float fov\" 40";

fn scene(world: &str) -> tauflow_data::scene::Scene {
    let loaded = load("a.pbrt", &pbrt(CAMERA, world), &[], false);
    loaded.unwrap_or_else(|told| panic!("{world}: {told}")).scene
}

fn near(found: Rgb, expected: [f64; 3]) {
    let close = |(a, b): (&f32, &f64)| (f64::from(*a) - b).abs() <= 1e-5 * b.abs().max(1e-3);
    assert!(found.iter().zip(&expected).all(close), "{found:?} for {expected:?}");
}

/// The radiance of the sky of a file with this camera.
fn sky(camera: &str) -> Rgb {
    let text = pbrt(camera, "LightSource \"infinite\" \"rgb L\" [1 2 4]");
    match load("a.pbrt", &text, &[], false).expect("supported").scene.emitters[0] {
        Emitter::Constant { radiance } => radiance,
        ref other => panic!("{other:?}"),
    }
}

#[test]
fn images_are_as_bright_as_shutter_and_film_make_them() {
    near(sky(CAMERA), [1.0, 2.0, 4.0]);
    let open = format!("{CAMERA} \"float shutteropen\" 0.25 \"float shutterclose\" 0.5");
    near(sky(&open), [0.25, 0.5, 1.0]);
    let closed = format!("{CAMERA} \"float shutteropen\" 1");
    let told = load("a.pbrt", &pbrt(&closed, ""), &[], false).expect_err("it never opens");
    assert!(told.contains("line 2: a shutter that is open for 0 s"), "{told}");
}

#[test]
fn lights_have_the_power_and_illuminance_that_they_are_given() {
    use core::f64::consts::PI;
    let lights = "LightSource \"point\" \"rgb I\" [1 2 4] \"float power\" 10 \"float scale\" 2\n\
                  LightSource \"distant\" \"rgb L\" [1 2 4] \"float illuminance\" 5\n\
                  LightSource \"spot\" \"rgb I\" [1 2 4] \"float power\" 3 \"float coneangle\" 60 \
                  \"float conedeltaangle\" 0\n\
                  LightSource \"infinite\" \"rgb L\" [1 2 4] \"float illuminance\" 2";
    for emitter in scene(lights).emitters {
        let (found, one) = match emitter {
            Emitter::Point { intensity, .. } => (intensity, 20.0 / (4.0 * PI)),
            Emitter::Directional { irradiance, .. } => (irradiance, 5.0),
            Emitter::Spot { intensity, .. } => (intensity, 3.0 / (2.0 * PI * 0.5)),
            Emitter::Constant { radiance } => (radiance, 2.0 / PI),
            Emitter::Envmap { .. } => panic!("no map is named"),
        };
        near(found, [one, 2.0 * one, 4.0 * one]);
    }
    let lamp = |shape: &str| format!("AreaLightSource \"diffuse\" \"rgb L\" [1 1 1] \"float power\" 8\n{shape}");
    // pbrt takes the area before the transform.
    for (shape, area) in [
        ("Scale 3 3 3 Shape \"sphere\" \"float radius\" 0.5", PI),
        ("Shape \"disk\" \"float radius\" 2", 4.0 * PI),
        ("Shape \"cylinder\" \"float radius\" 0.5 \"float zmin\" 0 \"float zmax\" 3", 3.0 * PI),
    ] {
        let Some(Texture::Constant { value }) = &scene(&lamp(shape)).shapes[0].emission else { panic!("{shape}") };
        near(*value, [8.0 / (area * PI); 3]);
    }
    let part = lamp("Shape \"sphere\" \"float phimax\" 90");
    let told = load("a.pbrt", &pbrt(CAMERA, &part), &[], false).expect_err("a part of a sphere");
    assert!(told.contains("line 5: `power` of a shape whose area is not known"), "{told}");
}

#[test]
fn a_map_has_the_illuminance_that_it_is_given() {
    let map = Image::from_data(4, 4, 3, vec![0.5; 48]).expect("fits");
    let files = [("map.exr", tauflow_data::image_io::exr_bytes(&[("", &map)]).expect("written"))];
    let light = "LightSource \"infinite\" \"string filename\" \"map.exr\" \"float illuminance\" 3";
    let loaded = load("a.pbrt", &pbrt(CAMERA, light), &files, true).expect("allowed");
    let Emitter::Envmap { image, .. } = &loaded.scene.emitters[0] else { panic!("a map") };
    let made = Image::from_bytes(&loaded.blobs[image]).expect("a picture");
    // Four texels of 16 lie above the horizon, at a cosine of 3/4, and pbrt gives each 2 pi / 16.
    let expected = 3.0 / (4.0 * 0.75 * 2.0 * core::f64::consts::PI / 16.0);
    let value = f64::from(made.data()[0]);
    assert!((value / expected - 1.0).abs() < 1e-5, "{value} for {expected}");
}

#[test]
fn attributes_stand_for_parameters_until_their_block_ends() {
    let world = "LightSource \"infinite\"\nAttributeBegin\n\
                 Attribute \"shape\" \"float radius\" 3\nAttribute \"material\" \"rgb reflectance\" [0.1 0.2 0.3]\n\
                 Material \"diffuse\"\nShape \"sphere\"\nShape \"sphere\" \"float radius\" 2\n\
                 Attribute \"shape\" \"float radius\" 4\nShape \"sphere\"\nAttributeEnd\nShape \"sphere\"";
    let scene = scene(world);
    let radius = |shape: &tauflow_data::scene::Shape| match shape.geometry {
        Geometry::Sphere { radius, .. } => radius,
        ref other => panic!("{other:?}"),
    };
    assert_eq!(scene.shapes.iter().map(radius).collect::<Vec<_>>(), [3.0, 2.0, 4.0, 1.0]);
    let Bsdf::TwoSided { inner } = &scene.materials[scene.shapes[0].material] else { panic!("two sides") };
    assert_eq!(**inner, Bsdf::Diffuse { reflectance: Texture::rgb([0.1, 0.2, 0.3]) });
    let told = load("a.pbrt", &pbrt(CAMERA, "Attribute \"lamp\" \"float x\" 1"), &[], false).expect_err("no such");
    assert!(told.contains("line 5: Attribute `lamp` is not supported"), "{told}");
    let many = "Attribute \"shape\" \"float radius\" 1\n".repeat(300);
    let told = load("a.pbrt", &pbrt(CAMERA, &many), &[], false).expect_err("too many");
    assert!(told.contains("more than 256 attributes at once"), "{told}");
}

#[test]
fn colours_are_in_the_space_that_is_named() {
    let of = |space: &str| {
        let world = format!("ColorSpace \"{space}\"\nLightSource \"infinite\" \"rgb L\" [0.2 0.5 0.3]");
        match scene(&world).emitters[0] {
            Emitter::Constant { radiance } => radiance,
            ref other => panic!("{other:?}"),
        }
    };
    near(of("srgb"), [0.2, 0.5, 0.3]);
    near(of("rec2020"), [0.016_422_68, 0.539_035_03, 0.281_699_3]);
    near(of("dci-p3"), [0.132_517_94, 0.512_617_1, 0.286_236_51]);
    let told = load("a.pbrt", &pbrt(CAMERA, "ColorSpace \"aces2065-1\""), &[], false).expect_err("another white");
    assert!(told.contains("line 5: ColorSpace `aces2065-1` is not supported; use `srgb`"), "{told}");
}

#[test]
fn windows_of_the_cameras_film_widen_the_view() {
    let sky = "LightSource \"infinite\"";
    let fov = |window: &str| {
        let camera = format!("{CAMERA} {window}");
        load("a.pbrt", &pbrt(&camera, sky), &[], false).map(|loaded| loaded.scene.camera.fov_x)
    };
    let tangent = |degrees: f64| tauflow_data::maths::tan(degrees.to_radians() * 0.5);
    let own = fov("").expect("a view");
    assert!((tangent(own) - 2.0 * tangent(40.0)).abs() < 1e-9, "{own}");
    let wide = fov("\"float screenwindow\" [-3 3 -1.5 1.5]").expect("a view");
    assert!((tangent(wide) - 3.0 * tangent(40.0)).abs() < 1e-9, "{wide}");
    for odd in ["\"float screenwindow\" [0 3 -1.5 1.5]", "\"float frameaspectratio\" 1"] {
        let told = fov(odd).expect_err("not around the middle, or stretched");
        assert!(told.contains("line 2: a window that is not around the middle"), "{told}");
    }
}

#[test]
fn roughness_along_u_and_v_is_read() {
    let world = "LightSource \"infinite\"\n\
                 Material \"dielectric\" \"float uroughness\" 0.09 \"float vroughness\" 0.25\n\
                 Shape \"sphere\"";
    let scene = scene(world);
    let Bsdf::Finish { alpha, alpha_v, inner, .. } = &scene.materials[0] else { panic!("a finish") };
    assert_eq!([alpha, alpha_v], [&Some(Texture::scalar(0.3)), &Some(Texture::scalar(0.5))]);
    assert!(matches!(**inner, Bsdf::Dielectric { .. }));
}

#[test]
fn a_missing_texture_of_pbrt_is_one_error() {
    for material in [
        "\"mix\" \"string materials\" [\"a\"] \"float amount\" .3",
        "\"conductor\" \"texture roughness\" \"none\" \"spectrum eta\" \"metal-Au-eta\" \"spectrum k\" \"metal-Au-k\"",
        "\"conductor\" \"texture reflectance\" \"none\" \"float roughness\" .1",
        "\"dielectric\" \"texture roughness\" \"none\" \"float eta\" 1.4",
        "\"diffuse\" \"texture reflectance\" \"none\"",
        "\"diffuse\" \"texture reflectance\" \"picture\"",
    ] {
        let text = format!(
            "Camera \"perspective\"\nWorldBegin\nLightSource \"point\"\nTexture \"picture\" \"spectrum\" \"imagemap\" \
             \"string filename\" \"no.png\" \"float scale\" 2\nMaterial {material}\nShape \"sphere\"\n"
        );
        let told = load("a.pbrt", &text, &[], true).expect_err(material);
        assert_eq!(told.lines().count(), 1, "{material}: {told}");
    }
}

#[test]
fn files_of_version_3_are_known_by_more_than_materials() {
    for line in [
        "Film \"image\" \"integer xresolution\" 64",
        "Sampler \"02sequence\"",
        "Sampler \"lowdiscrepancy\" \"integer pixelsamples\" 4",
        "Camera \"environment\"",
        "LightSource \"infinite\" \"string mapname\" \"sky.exr\"",
        "Shape \"hyperboloid\"",
        "WorldEnd",
        "Include \"old.pbrt\"",
    ] {
        let text = format!("Camera \"perspective\"\n{line}\nWorldBegin\nMaterial \"diffuse\"\nShape \"sphere\"\n");
        let old = [("old.pbrt", b"Material \"matte\" \"rgb Kd\" [1 0 0]\n".to_vec())];
        let told = load("a.pbrt", &text, &old, false).expect_err(line);
        assert!(told.lines().count() == 1 && told.contains("pbrt-v3; convert it by `pbrt --upgrade"), "{line}: {told}");
        let place = if line.starts_with("Include") { "old.pbrt: line 1: " } else { "a.pbrt: line 2: " };
        assert!(told.starts_with(place), "{told}");
    }
}

#[test]
fn textures_of_numbers_are_the_alpha_of_pictures_that_have_one() {
    use image::{DynamicImage, ImageFormat, Rgba, RgbaImage};
    let png = |image: DynamicImage| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).expect("in memory");
        bytes.into_inner()
    };
    let leaf =
        |alphas: [u8; 2]| DynamicImage::from(RgbaImage::from_fn(2, 1, |x, _| Rgba([255, 128, 64, alphas[x as usize]])));
    let exr = |alpha: f32| {
        let image = Image::from_data(1, 1, 4, vec![0.25, 0.5, 0.75, alpha]).expect("fits");
        tauflow_data::image_io::exr_bytes(&[("", &image)]).expect("in memory")
    };
    let read = |name: &str, bytes: Vec<u8>, encoding: &str| -> Vec<f32> {
        let world = format!(
            "LightSource \"point\"\nTexture \"a\" \"float\" \"imagemap\" \"string filename\" \"{name}\" \
             \"string encoding\" \"{encoding}\"\nShape \"bilinearmesh\" \"point3 P\" \
             [0 0 1 1 0 1 0 1 1 1 1 1] \"texture alpha\" \"a\""
        );
        let loaded = load("a.pbrt", &pbrt(CAMERA, &world), &[(name, bytes)], false).expect("supported");
        let Bsdf::Mask { opacity: Texture::Bitmap { image, .. }, .. } = &loaded.scene.materials[0] else {
            panic!("a mask")
        };
        let image = Image::from_bytes(&loaded.blobs[image]).expect("an image");
        image.data().chunks_exact(image.channels()).map(|texel| texel[0]).collect()
    };
    let near = |found: Vec<f32>, expected: &[f32]| {
        let same = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
        assert!(found.len() == expected.len() && found.iter().zip(expected).all(same), "{found:?} for {expected:?}");
    };
    near(read("a.png", png(leaf([255, 0])), "linear"), &[1.0, 0.0]);
    near(read("a.png", png(leaf([255, 51])), "linear"), &[1.0, 0.2]);
    // pbrt decodes alpha as the colours.
    near(read("a.png", png(leaf([255, 51])), "sRGB"), &[1.0, 0.033_104_766]);
    // Without alpha, or if all of it is 1, the mean of the colours; the alpha of greys is left out.
    let mean = (255.0 + 128.0 + 64.0) / 3.0 / 255.0;
    near(read("a.png", png(leaf([255, 255])), "linear"), &[mean; 2]);
    near(read("a.png", png(leaf([9, 9]).to_rgb8().into()), "linear"), &[mean; 2]);
    let grey = leaf([255, 0]).to_luma_alpha8();
    near(read("a.png", png(grey.clone().into()), "linear"), &[f32::from(grey.get_pixel(0, 0).0[0]) / 255.0; 2]);
    near(read("a.exr", exr(0.125), "linear"), &[0.125]);
    near(read("a.exr", exr(1.0), "linear"), &[0.5]);
}
