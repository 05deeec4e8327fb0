//! Recognises the layers of radiance, albedo and normals of an EXR file by the names that renderers give them, and
//! converts normals to what the network wants. Knows no network.

use crate::{cli::CliError, registry::mended_normals};
use std::path::{Path, PathBuf};
use tauflow_data::{
    Image,
    image_io::{exr_names, read_exr_alpha, read_exr_layers},
};

/// Names of layers of radiance, best first, in lower case. Blender keeps the noisy image beside a denoised one.
const RADIANCE: &[&str] =
    &["", "noisy image", "combined", "beauty", "rgba", "rgb", "color", "image", "hdr", "radiance"];

/// Names of layers of albedo.
const ALBEDO: &[&str] = &["albedo", "denoising albedo", "alb"];

/// Names of layers of normals. pbrt has shading normals beside those of the surface.
const NORMAL: &[&str] = &["normal", "denoising normal", "nrm", "sh_normal", "ns", "nn", "normals", "n"];

/// The layers of a file by name, and what the header says. Pixels are read when they are asked for.
pub(super) struct Layers {
    names: Vec<String>,
    /// From world to camera space, for row vectors, row by row.
    pub(super) camera: Option<[f32; 16]>,
    path: PathBuf,
}

/// The space of normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Space {
    /// Recognised by their values.
    Auto,
    /// Right, up, and towards the camera or away from it.
    Camera,
    /// Of the scene.
    World,
}

impl Layers {
    pub(super) fn read(path: &Path) -> Result<Self, CliError> {
        let (names, camera) = exr_names(path).map_err(|e| CliError::Bad(e.to_string()))?;
        Ok(Self { names, camera, path: path.to_owned() })
    }

    /// The pixels of a layer.
    pub(super) fn image(&self, name: &str) -> Result<Image, CliError> {
        let mut read = read_exr_layers(&self.path, &|layer| layer == name).map_err(|e| CliError::Bad(e.to_string()))?;
        read.remove(name).ok_or_else(|| CliError::Bad(format!("{} has changed while it was read", self.file())))
    }

    fn file(&self) -> impl std::fmt::Display + '_ {
        self.path.display()
    }

    /// The name of the layer of radiance: the one that is asked for, or the one that is recognised. `variance` names a
    /// layer that is none.
    pub(super) fn radiance(&self, asked: Option<&str>, variance: Option<&str>) -> Result<String, CliError> {
        if let Some(asked) = asked {
            return self.named(asked);
        }
        if let Some(found) = self.first(RADIANCE, |_| true) {
            return Ok(found);
        }
        let features = |name: &String| is(name, ALBEDO) || is(name, NORMAL) || Some(name.as_str()) == variance;
        let mut others = self.names.iter().filter(|name| !features(name));
        match (others.next(), others.next()) {
            (Some(name), None) => Ok(name.clone()),
            _ => Err(CliError::Bad(format!(
                "{}: no layer is recognised as radiance among {}; name it with --layer",
                self.file(),
                self.list()
            ))),
        }
    }

    /// The alpha of a layer, one channel; none if it has none.
    pub(super) fn alpha(&self, layer: &str) -> Result<Option<Image>, CliError> {
        read_exr_alpha(&self.path, layer).map_err(|e| CliError::Bad(e.to_string()))
    }

    /// A layer by its whole name.
    pub(super) fn named(&self, asked: &str) -> Result<String, CliError> {
        self.names.iter().find(|name| *name == asked).cloned().ok_or_else(|| {
            CliError::Bad(format!("{} has no layer `{asked}` of three channels, only {}", self.file(), self.list()))
        })
    }

    /// The albedo that belongs to a layer of radiance: of the same view layer, or of none.
    pub(super) fn albedo(&self, radiance: &str) -> Option<String> {
        self.beside(ALBEDO, radiance)
    }

    /// The normals that belong to a layer of radiance.
    pub(super) fn normal(&self, radiance: &str) -> Option<String> {
        self.beside(NORMAL, radiance)
    }

    fn beside(&self, names: &[&str], radiance: &str) -> Option<String> {
        let prefix = |name: &str| name.rsplit_once('.').map(|(prefix, _)| prefix.to_owned());
        let own = prefix(radiance);
        let same = self.first(names, |name| prefix(name) == own);
        same.or_else(|| self.first(names, |name| prefix(name).is_none() || own.is_none()))
    }

    /// The only layer of a file that holds one thing, or the one of these names.
    fn only(&self, names: &[&str]) -> Result<String, CliError> {
        if let Some(found) = self.first(names, |_| true) {
            return Ok(found);
        }
        match &self.names[..] {
            [name] => Ok(name.clone()),
            _ => Err(CliError::Bad(format!(
                "{}: several layers ({}), none of which is called {}; write a file with one layer",
                self.file(),
                self.list(),
                names
                    .iter()
                    .filter(|name| !name.is_empty())
                    .map(|name| format!("`{name}`"))
                    .collect::<Vec<_>>()
                    .join(", ")
            ))),
        }
    }

    pub(super) fn only_albedo(&self) -> Result<Image, CliError> {
        self.image(&self.only(ALBEDO)?)
    }

    pub(super) fn only_normal(&self) -> Result<Image, CliError> {
        self.image(&self.only(NORMAL)?)
    }

    /// The layer of the first of these names. Blender's compositor changes images, so its layers count last.
    fn first(&self, names: &[&str], may: impl Fn(&str) -> bool) -> Option<String> {
        let composite = |name: &String| name.to_ascii_lowercase().starts_with("composite.");
        names.iter().find_map(|wanted| {
            let found = self.names.iter().filter(|name| last(name) == *wanted && may(name));
            found.min_by_key(|name| composite(name)).cloned()
        })
    }

    fn list(&self) -> String {
        let name = |name: &String| if name.is_empty() { "the unnamed layer".to_owned() } else { format!("`{name}`") };
        self.names.iter().map(name).collect::<Vec<_>>().join(", ")
    }
}

fn is(name: &str, names: &[&str]) -> bool {
    names.contains(&last(name).as_str())
}

/// The last part of a layer's name: Blender puts the view layer before it.
fn last(name: &str) -> String {
    let last = name.rsplit('.').next().unwrap_or(name).to_ascii_lowercase();
    if last == "<root>" || last == "root" { String::new() } else { last }
}

/// Share of normals that must agree on something.
const MOST: f64 = 0.95;

/// Normals as the network wants them: camera space, right, up and towards the camera, of length 1, or 0 where nothing
/// was hit. Returns what was found of them, for people.
pub(super) fn camera_normals(
    mut normals: Image,
    space: Space,
    camera: Option<[f32; 16]>,
) -> Result<(Image, Vec<String>), CliError> {
    let mut notes = Vec::new();
    normals = mended_normals(normals, &mut notes);
    if encoded(&normals) {
        // Nothing was hit where the stored value is 0, or where it stands for 0.
        for pixel in normals.data_mut().chunks_exact_mut(3) {
            let none = pixel.iter().all(|value| *value == 0.0) || length(pixel, mapped) < 0.1;
            pixel.iter_mut().for_each(|value| *value = if none { 0.0 } else { mapped(*value) });
        }
        notes.push("normals are stored from 0 to 1; they are read as 2 n - 1".to_owned());
    }
    let long = unit(&mut normals);
    if long > 0.0 {
        notes.push(format!("{:.1}% of the normals are longer than 1; they are shortened", 100.0 * long));
    }
    let world = match space {
        Space::Camera => false,
        Space::World => true,
        Space::Auto => share_facing(&normals).is_some_and(|share| share > 1.0 - MOST && share < MOST),
    };
    if world {
        match camera {
            Some(matrix) => normals = rotated(&normals, rotation(&matrix, &normals)),
            None => {
                normals = rotated(&normals, facing(&normals));
                notes.push(
                    "normals are in world space, but the file has no camera matrix; they are turned so that most face \
                     the camera"
                        .to_owned(),
                );
            }
        }
    }
    // Cameras that look along +z see normals of negative z.
    if share_facing(&normals).is_some_and(|share| share < 0.5) {
        for pixel in normals.data_mut().chunks_exact_mut(3) {
            pixel[2] = -pixel[2];
        }
    }
    Ok((normals, notes))
}

/// The rotation of a matrix from world to camera space, for row vectors. OpenEXR has row vectors, whose translation is
/// in the last row; pbrt writes matrices for column vectors. Without a translation, the rotation counts by which more
/// normals face the camera.
fn rotation(matrix: &[f32; 16], normals: &Image) -> [[f32; 3]; 3] {
    let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|c| matrix[4 * row + c]));
    let columns = [0, 1, 2].map(|row| [0, 1, 2].map(|c| matrix[4 * c + row]));
    let moved = |places: [usize; 3]| places.iter().any(|at| matrix[*at] != 0.0);
    match (moved([12, 13, 14]), moved([3, 7, 11])) {
        (true, false) => rows,
        (false, true) => columns,
        _ => {
            // Cameras look along +z or -z.
            let agree = |matrix| share_facing(&rotated(normals, matrix)).map_or(0.0, |share| (share - 0.5).abs());
            if agree(columns) > agree(rows) { columns } else { rows }
        }
    }
}

/// A value that was mapped to 0 to 1.
fn mapped(value: f32) -> f32 {
    2.0 * value - 1.0
}

fn length(pixel: &[f32], f: fn(f32) -> f32) -> f32 {
    pixel.iter().map(|value| f(*value).powi(2)).sum::<f32>().sqrt()
}

/// Whether values are of normals that were mapped to 0 to 1.
fn encoded(normals: &Image) -> bool {
    let hit = |pixel: &&[f32]| pixel.iter().any(|value| *value != 0.0) && length(pixel, mapped) > 0.1;
    let pixels = || normals.data().chunks_exact(3).filter(hit);
    let count = pixels().count();
    let near = |length: f32| (length - 1.0).abs() < 0.1;
    let mapped = pixels().filter(|pixel| near(length(pixel, mapped))).count();
    let plain = pixels().filter(|pixel| near(length(pixel, |value| value))).count();
    count > 0
        && normals.data().iter().all(|value| (0.0..=1.0).contains(value))
        && mapped as f64 > MOST * count as f64
        && (plain as f64) < 0.5 * count as f64
}

/// Shortens what is longer than 1 by more than a little; returns the share of such pixels.
fn unit(normals: &mut Image) -> f64 {
    let mut long = 0;
    let count = normals.data().len() / 3;
    for pixel in normals.data_mut().chunks_exact_mut(3) {
        let length = pixel.iter().map(|value| value * value).sum::<f32>().sqrt();
        if length > 1.01 {
            long += 1;
            pixel.iter_mut().for_each(|value| *value /= length);
        }
    }
    long as f64 / count.max(1) as f64
}

/// Share of normals with positive z, of those whose z is clear; none if there are none.
fn share_facing(normals: &Image) -> Option<f64> {
    let clear: Vec<f32> = normals.data().chunks_exact(3).map(|pixel| pixel[2]).filter(|z| z.abs() > 0.1).collect();
    let facing = clear.iter().filter(|z| **z > 0.0).count();
    (!clear.is_empty()).then(|| facing as f64 / clear.len() as f64)
}

/// Row vectors times a matrix, scaled back to their lengths.
fn rotated(normals: &Image, matrix: [[f32; 3]; 3]) -> Image {
    let mut out = normals.clone();
    for pixel in out.data_mut().chunks_exact_mut(3) {
        let length = pixel.iter().map(|value| value * value).sum::<f32>().sqrt();
        let turned = [0, 1, 2].map(|c| (0..3).map(|row| pixel[row] * matrix[row][c]).sum::<f32>());
        let now = turned.iter().map(|value| value * value).sum::<f32>().sqrt();
        let scale = if now > 0.0 { length / now } else { 0.0 };
        pixel.iter_mut().zip(turned).for_each(|(value, turned)| *value = scale * turned);
    }
    out
}

/// A rotation for row vectors that turns the mean normal to +z.
fn facing(normals: &Image) -> [[f32; 3]; 3] {
    let mut mean = [0.0f64; 3];
    for pixel in normals.data().chunks_exact(3) {
        mean.iter_mut().zip(pixel).for_each(|(mean, value)| *mean += f64::from(*value));
    }
    let length = mean.iter().map(|value| value * value).sum::<f64>().sqrt();
    if length < 1e-9 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    let back = mean.map(|value| value / length);
    // The axis that is least along it.
    let axis = if back[1].abs() < 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let right = cross(axis, back);
    let length = right.iter().map(|value| value * value).sum::<f64>().sqrt();
    let right = right.map(|value| value / length);
    let up = cross(back, right);
    [0, 1, 2].map(|row| [right[row] as f32, up[row] as f32, back[row] as f32])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layers(names: &[&str]) -> Layers {
        // As the names come from a file: in order.
        let mut names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        names.sort();
        Layers { names, camera: None, path: "x.exr".into() }
    }

    #[test]
    fn layers_of_renderers_are_recognised() {
        for (names, radiance, albedo, normal) in [
            (vec!["", "albedo", "normal"], "", "albedo", "normal"),
            (
                vec![
                    "ViewLayer.Combined",
                    "ViewLayer.Noisy Image",
                    "ViewLayer.Denoising Albedo",
                    "ViewLayer.Denoising Normal",
                ],
                "ViewLayer.Noisy Image",
                "ViewLayer.Denoising Albedo",
                "ViewLayer.Denoising Normal",
            ),
            (vec!["", "Albedo", "N", "Ns", "P", "Variance"], "", "Albedo", "Ns"),
            (vec!["<root>", "albedo", "sh_normal"], "<root>", "albedo", "sh_normal"),
            (vec!["path", "albedo", "nn"], "path", "albedo", "nn"),
            (
                vec!["Composite.Combined", "A.Denoising Albedo", "A.Denoising Normal", "B.Noisy Image"],
                "B.Noisy Image",
                "",
                "",
            ),
            (vec!["Composite.Combined", "View.Combined"], "View.Combined", "", ""),
        ] {
            let layers = layers(&names);
            let name = Option::<String>::unwrap_or_default;
            assert_eq!(layers.radiance(None, None).expect("recognised"), radiance, "{names:?}");
            assert_eq!(
                (name(layers.albedo(radiance)), name(layers.normal(radiance))),
                (albedo.into(), normal.into()),
                "{names:?}"
            );
        }
        let unknown = layers(&["first", "second"]);
        let CliError::Bad(told) = unknown.radiance(None, None).expect_err("two that could be") else {
            panic!("wrong sort")
        };
        assert!(told.contains("`first`, `second`") && told.contains("--layer"), "{told}");
        assert_eq!(unknown.radiance(None, Some("first")).expect("one is the variance"), "second");
        assert_eq!(unknown.radiance(Some("second"), None).expect("named"), "second");
        assert!(unknown.radiance(Some("third"), None).is_err());
        assert!(layers(&["first", "second"]).only(ALBEDO).is_err() && layers(&["any"]).only(ALBEDO).is_ok());
    }

    /// Normals of a sphere that a camera sees, right, up and towards it.
    fn sphere() -> Image {
        let side = 24;
        let pixel = |i: usize| {
            let of = |at: usize| (at as f32 + 0.5) / side as f32 * 2.2 - 1.1;
            let (x, y) = (of(i % side), -of(i / side));
            let left = 1.0 - x * x - y * y;
            if left > 0.0 { [x, y, left.sqrt()] } else { [0.0; 3] }
        };
        Image::from_data(side, side, 3, (0..side * side).flat_map(pixel).collect()).expect("fits")
    }

    fn near(a: &Image, b: &Image) -> bool {
        a.data().iter().zip(b.data()).all(|(a, b)| (a - b).abs() < 1e-5)
    }

    #[test]
    fn normals_of_any_convention_become_those_of_the_camera() {
        let camera = |normals: &Image, space, matrix| camera_normals(normals.clone(), space, matrix).expect("normals");
        let plain = sphere();
        assert!(near(&camera(&plain, Space::Auto, None).0, &plain));
        assert!(camera(&plain, Space::Auto, None).1.is_empty());
        // Away from the camera, and mapped to 0 to 1.
        let mut away = plain.clone();
        away.data_mut().chunks_exact_mut(3).for_each(|pixel| pixel[2] = -pixel[2]);
        assert!(near(&camera(&away, Space::Auto, None).0, &plain));
        let hits = |image: &Image| {
            let filled =
                |pixel: &[f32]| if pixel == [0.0; 3] { [0.0, 0.0, 1.0] } else { [pixel[0], pixel[1], pixel[2]] };
            let data = image.data().chunks_exact(3).flat_map(filled).collect();
            Image::from_data(image.width(), image.height(), 3, data).expect("fits")
        };
        let whole = hits(&plain);
        let (found, notes) = camera(&whole.map(|value| 0.5 * value + 0.5), Space::Auto, None);
        assert!(near(&found, &whole) && notes[0].contains("2 n - 1"), "{notes:?}");
        // A background that was mapped, too, or left at 0.
        for background in [0.5, 0.0] {
            let stored = |pixel: &[f32]| {
                if pixel == [0.0; 3] { [background; 3] } else { [0, 1, 2].map(|c| 0.5 * pixel[c] + 0.5) }
            };
            let data = plain.data().chunks_exact(3).flat_map(stored).collect();
            let stored = Image::from_data(plain.width(), plain.height(), 3, data).expect("fits");
            let (found, notes) = camera(&stored, Space::Auto, None);
            assert!(near(&found, &plain) && notes.len() == 1, "{background}: {notes:?}");
        }
        let mut broken = plain.clone();
        broken.pixel_mut(12, 12)[1] = f32::NAN;
        let (found, notes) = camera(&broken, Space::Auto, None);
        assert!(found.data().iter().all(|value| value.is_finite()), "{notes:?}");
        assert!(notes[0].starts_with("1 of 576 pixels of the normals are not finite"), "{notes:?}");
        // World space: seen from above, where y is towards the camera.
        let turned = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
        let world = rotated(&plain, turned);
        let matrix = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 5.0, 1.0];
        assert!(near(&camera(&world, Space::Auto, Some(matrix)).0, &plain));
        // The same for column vectors, as pbrt writes it, and without a translation.
        let columns = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 5.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        assert!(near(&camera(&world, Space::Auto, Some(columns)).0, &plain));
        let still = |mut matrix: [f32; 16]| {
            (matrix[7], matrix[14]) = (0.0, 0.0);
            matrix
        };
        assert!(near(&camera(&world, Space::Auto, Some(still(matrix))).0, &plain));
        let (found, notes) = camera(&world, Space::Auto, None);
        assert!(notes[0].contains("world space") && share_facing(&found).is_some_and(|share| share > MOST));
        assert!(!near(&camera(&plain, Space::World, Some(matrix)).0, &plain));
        let (found, notes) = camera(&plain.map(|value| 3.0 * value), Space::Camera, None);
        assert!(notes[0].contains("longer than 1") && near(&found, &plain), "{notes:?}");
    }
}
