use super::*;
use crate::{
    Image,
    scene::{Camera, IDENTITY},
};

fn bitmap(image: Digest) -> Texture {
    let uv = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    Texture::Bitmap { image, uv, scale: [1.0; 3], channel: None, clamp: false }
}

fn times(a: Texture, b: Texture) -> Texture {
    Texture::Product { a: Box::new(a), b: Box::new(b) }
}

/// Exports materials on a triangle; the folder's `scene.xml` and PLY.
fn exported(materials: Vec<Bsdf>) -> Result<(tempfile::TempDir, String, Vec<u8>), KindError> {
    placed(materials, IDENTITY, None)
}

/// As [`exported`], where a map puts the triangle, with vertex normals or without.
fn placed(
    materials: Vec<Bsdf>,
    to_world: Affine,
    normals: Option<Vec<[f32; 3]>>,
) -> Result<(tempfile::TempDir, String, Vec<u8>), KindError> {
    let dir = tempfile::tempdir().expect("a folder");
    let mesh = Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        triangles: vec![[0, 1, 2]],
        colors: Some(vec![[1.0, 0.5, 0.25, 0.125]; 3]),
        normals,
        ..Mesh::default()
    };
    let image = Image::from_data(1, 1, 3, vec![0.5, 0.75, 1.0]).expect("fits");
    let (mesh, image) = (mesh.to_bytes().expect("small"), image.to_bytes());
    let shape = Shape {
        geometry: Geometry::Mesh { mesh: Digest::of(&mesh) },
        to_world,
        material: 0,
        emission: None,
        flip_normals: false,
    };
    let camera = Camera { origin: [0.0, 0.0, 4.0], target: [0.0; 3], up: [0.0, 1.0, 0.0], fov_x: 40.0, near: 0.01 };
    let scene = Scene {
        version: 1,
        seed: 1,
        camera,
        max_depth: 5,
        shapes: vec![shape],
        materials,
        emitters: Vec::new(),
        hide_emitters: false,
    };
    let mut load = |digest: &Digest| Ok(if *digest == Digest::of(&mesh) { mesh.clone() } else { image.clone() });
    export(&scene, &mut load, dir.path(), Film { width: 8, height: 8, spp: 4 })?;
    let xml = fs::read_to_string(dir.path().join("scene.xml")).expect("written");
    let ply = fs::read(dir.path().join("mesh-0000.ply")).expect("written");
    Ok((dir, xml, ply))
}

#[test]
fn a_scene_becomes_a_folder() {
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
    let (_dir, xml, ply) = exported(vec![Bsdf::TwoSided { inner }]).expect("exportable");
    assert!(xml.matches("<bsdf").count() == 2 && xml.matches("</bsdf>").count() == 2, "{xml}");
    assert!(xml.contains("mesh-0000.ply") && xml.contains("face_normals"), "{xml}");
    // Nothing reads the colours.
    let head = String::from_utf8_lossy(&ply[..ply.len().min(120)]).into_owned();
    assert!(head.starts_with("ply\n") && !head.contains("c0_r"), "{head}");
}

#[test]
fn vertex_colours_become_attributes_of_meshes() {
    let colors = |channel| Texture::VertexColor { scale: [1.0; 3], channel };
    let tinted = times(Texture::rgb([0.5, 1.0, 2.0]), colors(None));
    let diffuse = |reflectance| Box::new(Bsdf::Diffuse { reflectance });
    let mask = Bsdf::Mask { opacity: times(colors(Some(3)), bitmap(Digest::of(b"i"))), inner: diffuse(tinted) };
    let (_dir, xml, ply) = exported(vec![mask]).expect("exportable");
    // A mask for each factor of the opacity, and two ways in which colours are read.
    assert_eq!(xml.matches("<bsdf type=\"mask\"").count(), 2, "{xml}");
    assert!(xml.contains("vertex_c0_color") && xml.contains("vertex_c1_color") && !xml.contains("vertex_c2"), "{xml}");
    let end = b"end_header\n";
    let at = ply.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
    let values: Vec<f32> =
        ply[at..at + 36].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four"))).collect();
    assert_eq!(values[3..], [0.125, 0.125, 0.125, 0.5, 0.5, 0.5]);
}

#[test]
fn normal_maps_are_scaled_in_their_images() {
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
    let map = bitmap(Digest::of(b"i"));
    let (dir, xml, _) = exported(vec![Bsdf::NormalMap { map, scale: 0.5, inner }]).expect("exportable");
    let name = xml.split('"').find(|part| part.ends_with(".exr")).expect("an image");
    let image = crate::image_io::read_exr(&dir.path().join(name)).expect("readable");
    // 2 t - 1 is (0, 0.5, 1): halved in its first two components.
    assert_eq!(image[""].data(), [0.5, 0.625, 1.0]);
    // Of maps that are no pictures, too; and what is flat stays flat to the bit, whatever the scale.
    let inner = Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
    let map = Texture::rgb([0.5, 0.75, 1.0]);
    let (_dir, xml, _) = exported(vec![Bsdf::NormalMap { map, scale: 0.5, inner: inner.clone() }]).expect("exportable");
    assert!(xml.contains("<rgb name=\"normalmap\" value=\"0.5, 0.625, 1.0\"/>"), "{xml}");
    let map = Texture::Checkerboard { color0: [0.5, 0.5, 1.0], color1: [0.0, 1.0, 1.0], scale: [2.0; 2] };
    let (_dir, xml, _) = exported(vec![Bsdf::NormalMap { map, scale: 0.7, inner: inner.clone() }]).expect("exportable");
    let (flat, other) = ("\"color0\" value=\"0.5, 0.5, 1.0\"", "\"color1\" value=\"0.15, 0.85, 1.0\"");
    assert!(xml.contains(flat) && xml.contains(other), "{xml}");
    let map = Texture::VertexColor { scale: [1.0; 3], channel: None };
    let error = exported(vec![Bsdf::NormalMap { map, scale: 0.5, inner }]).expect_err("refused").to_string();
    assert!(error.contains("a scaled normal map of vertex colours"), "{error}");
}

#[test]
fn what_a_map_that_mirrors_turns_there_is_turned_back() {
    let diffuse = || vec![Bsdf::Diffuse { reflectance: Texture::scalar(0.5) }];
    let mut mirror = IDENTITY;
    mirror[0][0] = -2.0;
    let flips = |to_world, normals| {
        let (_dir, xml, _) = placed(diffuse(), to_world, normals).expect("exportable");
        xml.contains("flip_normals")
    };
    let up = || Some(vec![[0.0, 0.0, 1.0]; 3]);
    assert_eq!([flips(mirror, None), flips(mirror, up()), flips(IDENTITY, None)], [true, false, false]);
}

#[test]
fn passages_through_masks_are_no_part_of_a_paths_length() {
    let diffuse = || Bsdf::Diffuse { reflectance: Texture::scalar(0.5) };
    let mask = Bsdf::Mask { opacity: Texture::scalar(0.5), inner: Box::new(diffuse()) };
    let (_dir, xml, _) = exported(vec![diffuse()]).expect("exportable");
    assert!(xml.contains("<integrator type=\"path\">"), "{xml}");
    let (_dir, xml, _) = exported(vec![Bsdf::TwoSided { inner: Box::new(mask) }]).expect("exportable");
    assert!(xml.contains("<integrator type=\"volpath\">"), "{xml}");
}

#[test]
fn normal_maps_have_no_shadowing_and_no_flips() {
    let diffuse = || Box::new(Bsdf::Diffuse { reflectance: Texture::scalar(0.5) });
    let mapped = |scale| Bsdf::NormalMap { map: bitmap(Digest::of(b"i")), scale, inner: diffuse() };
    let (_dir, xml, _) = exported(vec![mapped(1.0), mapped(0.5), *diffuse()]).expect("exportable");
    let maps: Vec<&str> = xml.split("<bsdf type=\"normalmap\"").skip(1).collect();
    assert_eq!(maps.len(), 2, "{xml}");
    for map in maps {
        let own = map.split("<bsdf").next().expect("before the inner one");
        for name in ["use_shadowing_function", "flip_invalid_normals"] {
            let line = format!("<boolean name=\"{name}\" value=\"false\"/>");
            assert_eq!(own.matches(&line).count(), 1, "{xml}");
        }
    }
    // The plain material has neither: Mitsuba refuses what a plugin does not know.
    assert_eq!((xml.matches("use_shadowing_function").count(), xml.matches("flip_invalid_normals").count()), (2, 2));
}

#[test]
fn products_that_mitsuba_cannot_express_are_refused() {
    let product = times(bitmap(Digest::of(b"i")), Texture::VertexColor { scale: [1.0; 3], channel: None });
    let error = exported(vec![Bsdf::Diffuse { reflectance: product }]).expect_err("refused").to_string();
    assert!(error.contains("`reflectance` is a product of textures"), "{error}");
}

#[test]
fn mitsubas_camera_sees_what_is_farther_than_its_own_far_clip() {
    let exported_at = |z: f64| {
        let mut map = IDENTITY;
        map[2][3] = z;
        let materials = vec![Bsdf::Diffuse { reflectance: Texture::scalar(0.5) }];
        placed(materials, map, None).expect("exportable").1
    };
    // The camera stands at z = 4 and looks down.
    for z in [-9_000.0, 1e6] {
        assert!(!exported_at(z).contains("far_clip"), "{z}");
    }
    let xml = exported_at(-1e6);
    let clip = xml.find("<float name=\"far_clip\" value=\"2000008.0\"/>").expect("it is set");
    assert!(clip > xml.find("near_clip").expect("set") && clip < xml.find("<lookat").expect("set"), "{xml}");
}
