//! Single samples of scenes as data sets of the package `noisebase`: one ZIP file with Zarr arrays for each scene, of
//! one frame. The samples are rendered for the export; their mean is the rung of as many samples.
//!
//! # Source
//! Noisebase, sample training format v1 (<https://balint.io/noisebase/formats/sample_training_v1.html>), and Zarr
//! storage specification version 2.

use super::formats::{Put, zip};
use crate::{
    ids::Id,
    pipeline::Pipeline,
    query::Selection,
    registry::{Choices, Sample, Setup, render_samples},
};
use serde::Deserialize;
use serde_json::{Value, json};
use std::fmt::Write as _;
use tauflow_contract::{Artifact, Context, Handle, ItemKey, KindError, Media as _};
use tauflow_data::{
    Image, IntegratorKind, Resolution, SamplerKind,
    maths::{exp, log, tan},
    records::{Ladder, SceneRecord},
    rng::Stream,
    scene::Camera,
};
use tauflow_viewer::Half;

/// Planes of the view for depth, which only the projection matrix names.
const NEAR: f64 = 0.1;
const FAR: f64 = 1000.0;
/// Bytes of a file beyond which its ZIP would need another format.
const MOST: usize = 1 << 31;

/// The params of a render that its samples depend on.
#[derive(Clone, Copy, Deserialize)]
struct Rendering {
    resolution: Resolution,
    stream: u64,
    sampler: SamplerKind,
    integrator: IntegratorKind,
    choices: Choices,
}

/// Writes scenes, one after the other, and at last what describes them.
pub(super) struct Scenes {
    samples: u64,
    films: Vec<Resolution>,
    keys: Vec<ItemKey>,
}

/// The outputs that have the scenes of an output of ladders, by cell: the render, and names of selections.
pub(super) struct Origin {
    cell: String,
    rendering: Rendering,
    /// Selections of scenes, each with the text of its cell.
    pub(super) scenes: Vec<(String, String)>,
}

/// The renders of the asked output.
///
/// # Errors
/// If its items are no ladders that this program renders.
pub(super) fn origins(pipeline: &Pipeline, asked: &Selection<'_>) -> Result<Vec<Origin>, String> {
    let node = &pipeline.nodes[asked.node];
    let refusal = || {
        format!(
            "`--format noisebase` renders the samples of ladders, and `{}` renders none; name a node that renders, \
             such as one of the kind `ladder_rendering`",
            node.name
        )
    };
    let port = node.spec.inputs.iter().position(|port| port.media == SceneRecord::NAME).ok_or_else(refusal)?;
    if node.spec.outputs[asked.port.place()].media != Ladder::NAME {
        return Err(refusal());
    }
    let origin = |cell: usize| {
        let cell = &pipeline.cells[cell];
        let rendering = Rendering::deserialize(&cell.params).map_err(|_| refusal())?;
        let name = |from: &crate::pipeline::Connection| {
            let (of, text) = (&pipeline.nodes[pipeline.cells[from.cell].node], &pipeline.cells[from.cell].text);
            (format!("{}.{}", of.name, of.spec.outputs[from.port.place()].name), text.clone())
        };
        Ok(Origin { cell: cell.text.clone(), rendering, scenes: cell.inputs[port].iter().map(name).collect() })
    };
    node.cells.clone().map(origin).collect()
}

impl Origin {
    /// The scene of an item, as keys of the scenes' outputs may be: its own key, or with the text of their cell.
    pub(super) fn has(&self, key: &ItemKey) -> bool {
        key.split_cell().map_or("", |(cell, _)| cell) == self.cell
    }
}

impl Scenes {
    pub(super) fn new(samples: u64) -> Self {
        Self { samples, films: Vec::new(), keys: Vec::new() }
    }

    /// Renders the samples of a scene, and writes its file.
    pub(super) fn add(
        &mut self,
        ctx: &Context<'_>,
        (key, ladder): (&ItemKey, &Artifact),
        (origin, scene): (&Origin, &Artifact),
        put: &mut Put<'_>,
    ) -> Result<(), KindError> {
        let film = origin.rendering.resolution;
        if let Some(other) = self.films.first().filter(|other| **other != film) {
            return Err(KindError::Input(format!(
                "it has {} x {} pixels, and the scenes before it {} x {}; export them to different directories",
                film.width(),
                film.height(),
                other.width(),
                other.height()
            )));
        }
        let size = film.width() * film.height() * self.samples as usize * 40;
        if size > MOST {
            return Err(KindError::Input("its samples take more than 2 GiB; use a smaller --samples".into()));
        }
        let reference = Ladder::load(ctx, ladder)?.rungs.pop();
        let reference = reference.ok_or_else(|| KindError::Input("its ladder has no rungs".into()))?.image;
        let scene = SceneRecord::scene(ctx, Handle::new(scene)?)?;
        let Rendering { stream, sampler, integrator, choices, .. } = origin.rendering;
        let setup = Setup { sampler, integrator, choices, ..Setup::new(film) };
        let mut samples = Vec::new();
        render_samples(&scene, &mut |digest| ctx.get(digest), (setup, stream), self.samples, &mut |sample| {
            samples.push(sample);
            Ok(())
        })?;
        let name = format!("scene{:04}.zip", self.keys.len());
        put(&name, &store(&samples, &reference, &scene.camera, film))?;
        self.films.push(film);
        self.keys.push(key.clone());
        Ok(())
    }

    /// Writes the description that the package reads, and which file is of which item.
    pub(super) fn finish(&self, name: &str, put: &mut Put<'_>) -> Result<(), KindError> {
        let Some(film) = self.films.first() else { return Ok(()) };
        let crop = film.width().min(film.height());
        let text = format!(
            "# Read by noisebase: hydra.compose, or put it beside the package's own descriptions.\n\
             defaults:\n  - ./format/training_sample_v1@_here_\n  - _self_\n\n\
             name: {name:?}\n\nsrc:\n  sequences: {}\n  files: scene{{index:04d}}.zip\n  frames_per_sequence: 1\n  \
             crop: {crop}\n  samples: {}\n  rendering_height: {}\n  rendering_width: {}\n\n\
             _target_: ${{.loaders[${{.framework}}]}}\n",
            self.keys.len(),
            self.samples,
            film.height(),
            film.width()
        );
        put("noisebase.yaml", text.as_bytes())?;
        let mut rows = String::from("file,item\n");
        for (number, key) in self.keys.iter().enumerate() {
            let _ = writeln!(rows, "scene{number:04}.zip,{}", tauflow_data::tabular::csv_field(key.as_str()));
        }
        put("scenes.csv", rows.as_bytes())
    }
}

/// An array as the files of Zarr: its metadata and its only chunk.
fn array(files: &mut Vec<(String, Vec<u8>)>, name: &str, dtype: &str, shape: &[usize], bytes: Vec<u8>) {
    let meta = json!({ "zarr_format": 2, "shape": shape, "chunks": shape, "dtype": dtype, "compressor": null,
        "fill_value": 0, "order": "C", "filters": null });
    files.push((format!("{name}/.zarray"), serde_json::to_vec_pretty(&meta).expect("plain data")));
    let chunk: Vec<&str> = shape.iter().map(|_| "0").collect();
    files.push((format!("{name}/{}", chunk.join(".")), bytes));
}

fn floats(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

/// A value of each sample in the order channels, rows, columns, samples.
fn ordered<T>(film: Resolution, samples: usize, channels: usize, of: impl Fn(usize, usize, usize) -> T) -> Vec<T> {
    let pixels = film.width() * film.height();
    let places = (0..channels).flat_map(|c| (0..pixels).map(move |pixel| (c, pixel)));
    places
        .flat_map(|(c, pixel)| (0..samples).map(move |s| (c, pixel, s)))
        .map(|(c, pixel, s)| of(c, pixel, s))
        .collect()
}

/// The file of a scene.
fn store(samples: &[Sample], reference: &Image, camera: &Camera, film: Resolution) -> Vec<u8> {
    let (w, h, n) = (film.width(), film.height(), samples.len());
    let group: Value = json!({ "zarr_format": 2 });
    let mut files = vec![(".zgroup".to_owned(), group.to_string().into_bytes())];
    let (color, exposure) = rgbe(samples, film);
    array(&mut files, "color", "|u1", &[1, 4, h, w, n], color);
    array(&mut files, "exposure", "<f4", &[1, 2], floats(exposure));
    let clean = ordered(film, 1, 3, |c, pixel, _| reference.data()[3 * pixel + c]);
    array(&mut files, "reference", "<f4", &[1, 3, h, w], floats(clean));
    let shape = [1, 3, h, w, n];
    let position = ordered(film, n, 3, |c, pixel, s| samples[s].position.data()[3 * pixel + c]);
    array(&mut files, "position", "<f4", &shape, floats(position));
    // Nothing moves.
    array(&mut files, "motion", "<f4", &shape, vec![0; 4 * 3 * h * w * n]);
    type Part = fn(&Sample) -> &Image;
    let halves: [(&str, Part); 2] = [("normal", |sample| &sample.normal), ("diffuse", |sample| &sample.albedo)];
    for (name, part) in halves {
        let bits: Vec<Vec<u16>> = samples.iter().map(|sample| Half::of(part(sample)).bits).collect();
        let values = ordered(film, n, 3, |c, pixel, s| bits[s][3 * pixel + c]);
        array(&mut files, name, "<f2", &shape, values.into_iter().flat_map(u16::to_le_bytes).collect());
    }
    let vector = |v: [f64; 3]| floats(v.map(|value| value as f32));
    array(&mut files, "camera_position", "<f4", &[1, 3], vector(camera.origin));
    array(&mut files, "camera_target", "<f4", &[1, 3], vector(camera.target));
    let (up, view, projection) = matrices(camera, film);
    array(&mut files, "camera_up", "<f4", &[1, 3], vector(up));
    let matrix = |m: [[f64; 4]; 4]| floats(m.into_iter().flatten().map(|value| value as f32));
    array(&mut files, "proj_mat", "<f4", &[1, 4, 4], matrix(projection));
    // Of row vectors: the transpose of the product.
    let product = |row: usize, column: usize| (0..4).map(|k| view[k][row] * projection[column][k]).sum::<f64>();
    let both = [0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| product(row, column)));
    array(&mut files, "view_proj_mat", "<f4", &[1, 4, 4], matrix(both));
    array(&mut files, "crop_offset", "<i4", &[1, 2], vec![0; 8]);
    zip(&files)
}

/// The direction that is up on the film, the view matrix and the projection matrix, both of column vectors.
fn matrices(camera: &Camera, film: Resolution) -> ([f64; 3], [[f64; 4]; 4], [[f64; 4]; 4]) {
    let minus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] - b[k]);
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f64>();
    let cross = |a: [f64; 3], b: [f64; 3]| [1, 2, 0].map(|k: usize| a[k] * b[(k + 1) % 3] - a[(k + 1) % 3] * b[k]);
    let unit = |a: [f64; 3]| a.map(|value| value / dot(a, a).sqrt());
    let forward = unit(minus(camera.target, camera.origin));
    let right = unit(cross(forward, camera.up));
    let up = cross(right, forward);
    let row = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -dot(axis, camera.origin)];
    let view = [row(right), row(up), row(forward), [0.0, 0.0, 0.0, 1.0]];
    let half = tan(camera.fov_x * std::f64::consts::PI / 360.0);
    let (x, y) = (1.0 / half, film.width() as f64 / (half * film.height() as f64));
    let depth = FAR / (FAR - NEAR);
    let projection = [[x, 0.0, 0.0, 0.0], [0.0, y, 0.0, 0.0], [0.0, 0.0, depth, -NEAR * depth], [0.0, 0.0, 1.0, 0.0]];
    (up, view, projection)
}

/// Radiance in bytes: three mantissas and the exponent of the brightest, which divides the range of logarithms into 256
/// parts. Mantissas are dithered by numbers that depend on pixel and sample alone. Negative values become 0.
///
/// # Source
/// <https://balint.io/noisebase/algorithms/rgbe.html>
fn rgbe(samples: &[Sample], film: Resolution) -> (Vec<u8>, [f32; 2]) {
    let lit = || samples.iter().flat_map(|sample| sample.radiance.data()).copied().filter(|value| *value > 0.0);
    let (least, most) = lit().fold((f32::INFINITY, 0f32), |(low, high), value| (low.min(value), high.max(value)));
    if most == 0.0 {
        return (vec![0; 4 * film.width() * film.height() * samples.len()], [0.0; 2]);
    }
    let [low, high] = [least, most].map(|value| log(f64::from(value)) as f32);
    let span = f64::from(high) - f64::from(low);
    let encoded = |pixel: usize, s: usize| -> [u8; 4] {
        let color = [0, 1, 2].map(|c| f64::from(samples[s].radiance.data()[3 * pixel + c].max(0.0)));
        let brightest = color.into_iter().fold(0.0, f64::max);
        if brightest <= 0.0 {
            return [0; 4];
        }
        let part = if span > 0.0 { (log(brightest) - f64::from(low)) / span * 256.0 } else { 255.0 };
        let exponent = part.clamp(0.0, 255.0).floor();
        let scale = exp((exponent + 1.0) / 256.0 * span + f64::from(low));
        let mut dither = Stream::new(pixel as u64, &[s as u64]);
        let mantissa = color.map(|value| (value / scale * 255.0 + dither.uniform()).floor().clamp(0.0, 255.0) as u8);
        [mantissa[0], mantissa[1], mantissa[2], exponent as u8]
    };
    let pixels = film.width() * film.height();
    let all: Vec<[u8; 4]> = (0..pixels)
        .flat_map(|pixel| (0..samples.len()).map(move |s| (pixel, s)))
        .map(|(pixel, s)| encoded(pixel, s))
        .collect();
    (ordered(film, samples.len(), 4, |c, pixel, s| all[pixel * samples.len() + s][c]), [low, high])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(film: Resolution, value: impl Fn(usize) -> f32) -> Sample {
        let size = 3 * film.width() * film.height();
        let image = |data| Image::from_data(film.width(), film.height(), 3, data).expect("fits");
        let zero = image(vec![0.0; size]);
        Sample {
            radiance: image((0..size).map(value).collect()),
            position: zero.clone(),
            normal: zero.clone(),
            albedo: zero,
        }
    }

    #[test]
    fn radiance_is_within_a_step_of_its_bytes() {
        let film = Resolution::new(5, 4).expect("a film");
        let values = |i: usize| if i.is_multiple_of(7) { 0.0 } else { 1e-3 * 1.7f32.powi((i % 23) as i32) };
        let samples = [sample(film, values), sample(film, |i| 0.5 * values(i + 3))];
        let (bytes, [low, high]) = rgbe(&samples, film);
        for (s, sample) in samples.iter().enumerate() {
            for pixel in 0..20 {
                let at = |c: usize| f64::from(bytes[(c * 20 + pixel) * 2 + s]);
                let scale = exp((at(3) + 1.0) / 256.0 * f64::from(high - low) + f64::from(low));
                for c in 0..3 {
                    let wanted = f64::from(sample.radiance.data()[3 * pixel + c]);
                    assert!((at(c) / 255.0 * scale - wanted).abs() <= scale / 255.0 * 1.001, "{wanted}");
                }
            }
        }
        let (black, range) = rgbe(&[sample(film, |_| 0.0)], film);
        assert!(black.iter().all(|byte| *byte == 0) && range == [0.0; 2]);
        let (one, _) = rgbe(&[sample(film, |_| 2.0)], film);
        assert!(one[..60].iter().all(|byte| *byte >= 254), "one brightness has no range");
    }

    #[test]
    fn what_the_camera_looks_at_is_in_the_middle_of_the_film() {
        let film = Resolution::new(8, 4).expect("a film");
        let camera =
            Camera { origin: [1.0, 2.0, 3.0], target: [4.0, 1.0, 0.5], up: [0.0, 1.0, 0.0], fov_x: 60.0, near: 0.0 };
        let (up, view, projection) = matrices(&camera, film);
        let project = |p: [f64; 3]| {
            let seen = view.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]);
            let clip = projection.map(|row| (0..4).map(|k| row[k] * seen[k]).sum::<f64>());
            [clip[0] / clip[3], clip[1] / clip[3]]
        };
        assert!(project(camera.target).iter().all(|v| v.abs() < 1e-12));
        let above = project([0, 1, 2].map(|k| camera.target[k] + 0.1 * up[k]));
        assert!(above[1] > 0.0 && above[0].abs() < 1e-12, "{above:?}");
        // Half the field of view reaches the edge.
        let distance = (0..3).map(|k| (camera.target[k] - camera.origin[k]).powi(2)).sum::<f64>().sqrt();
        let right = [view[0][0], view[0][1], view[0][2]];
        let edge = project([0, 1, 2].map(|k| camera.target[k] + distance * tan(std::f64::consts::PI / 6.0) * right[k]));
        assert!((edge[0] - 1.0).abs() < 1e-9, "{edge:?}");
    }
}
