//! Small networks with made-up weights predict and sample what PyTorch does: diffusers' `UNet2DModel` and
//! `DDPMScheduler`, and the NCSN++ of the Rectified Flow image release. The numbers lie beside the working tree, in
//! `../shared/reference`; without them these tests say so and pass.

use std::{
    fs,
    path::{Path, PathBuf},
};
use tauflow_data::Image;
use tauflow_generative::{Backbone, SCALE, Sampler};
use tauflow_testing::{Need, skip};

fn folder(name: &str) -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let folder = root.join("../shared/reference").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    skip(Need::Shared, format_args!("no reference numbers at {}", folder.display()));
    None
}

/// Tensors of a safetensors file: shapes and numbers, whole numbers too.
struct Reference(Vec<u8>);

impl Reference {
    fn get(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        let file = safetensors::SafeTensors::deserialize(&self.0).expect("a whole file");
        let view = file.tensor(name).expect("it is there");
        let values = match view.dtype() {
            safetensors::Dtype::I64 => {
                let number = |b: &[u8]| i64::from_le_bytes(b.try_into().expect("eight")) as f32;
                view.data().chunks_exact(8).map(number).collect()
            }
            _ => view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four"))).collect(),
        };
        (view.shape().to_vec(), values)
    }

    /// Images of a tensor [.., 3, H, W].
    fn images(&self, name: &str) -> Vec<Image> {
        let (shape, values) = self.get(name);
        let [height, width] = [shape[shape.len() - 2], shape[shape.len() - 1]];
        let pixels = height * width;
        let image = |planes: &[f32]| {
            let data = (0..pixels * 3).map(|i| planes[i % 3 * pixels + i / 3]).collect();
            Image::from_data(width, height, 3, data).expect("fits")
        };
        values.chunks_exact(3 * pixels).map(image).collect()
    }
}

/// The largest difference by the largest number.
fn apart(found: &Image, expected: &Image) -> f64 {
    let largest = expected.data().iter().fold(0.0f32, |m, v| m.max(v.abs()));
    let pairs = found.data().iter().zip(expected.data());
    f64::from(pairs.fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / largest)
}

fn read(folder: &Path, weights: &str) -> Backbone {
    let text = |name: &str| fs::read_to_string(folder.join(name)).ok();
    let bytes = fs::read(folder.join(weights)).expect("readable");
    let config = text("config.json").expect("it is there");
    Backbone::read(&config, text("scheduler_config.json").as_deref(), weights, &bytes).expect("a sound checkpoint")
}

/// Walks through a sampler from a start, with given noise.
fn sample(backbone: &Backbone, sampler: &Sampler, start: Image, noise: &[Image]) -> Image {
    let (mut state, mut drawn) = (start, 0);
    for step in 0..sampler.steps() {
        let prediction = backbone.predict(&[&state], &[sampler.time(step)]).expect("fits").remove(0);
        let none = Vec::new();
        let noise = if sampler.is_noisy(step) {
            drawn += 1;
            noise[drawn - 1].data()
        } else {
            &none
        };
        sampler.advance(step, state.data_mut(), prediction.data(), noise);
    }
    assert_eq!(drawn, noise.len());
    state
}

#[test]
fn ddpm_predicts_and_samples_as_diffusers_does() {
    let Some(folder) = folder("ddpm_tiny") else { return };
    let reference = Reference(fs::read(folder.join("reference.safetensors")).expect("readable"));
    for weights in ["diffusion_pytorch_model.safetensors", "old_names.bin"] {
        let backbone = read(&folder, weights);
        let times: Vec<f64> = reference.get("t").1.into_iter().map(f64::from).collect();
        let images = reference.images("x");
        let found = backbone.predict(&images.iter().collect::<Vec<_>>(), &times).expect("fits");
        for (found, expected) in found.iter().zip(reference.images("eps")) {
            let apart = apart(found, &expected);
            println!("{weights}: noise {apart:.1e}");
            assert!(apart < 1e-4, "{weights}: {apart}");
        }
    }
    let backbone = read(&folder, "diffusion_pytorch_model.safetensors");
    let sampler = backbone.sampler(20);
    let times: Vec<f32> = (0..20).map(|step| sampler.time(step) as f32).collect();
    assert_eq!(times, reference.get("timesteps").1);
    let start = reference.images("sampler_start").remove(0);
    let end = sample(&backbone, &sampler, start, &reference.images("sampler_noise"));
    let apart = apart(&end, &reference.images("sampler_end")[0]);
    println!("20 steps {apart:.1e}");
    assert!(apart < 1e-4, "{apart}");
}

#[test]
fn rectified_flow_predicts_and_samples_as_the_release_does() {
    let Some(folder) = folder("rectified_flow_tiny") else { return };
    let reference = Reference(fs::read(folder.join("reference.safetensors")).expect("readable"));
    let backbone = read(&folder, "checkpoint_tiny.pth");
    let images = reference.images("x");
    let times: Vec<f64> = reference.get("t").1.into_iter().map(f64::from).collect();
    // The numbers tell which time the network is given: 999 t.
    for (scale, fits) in [(1.0, true), (1.0 / SCALE, false)] {
        let times: Vec<f64> = times.iter().map(|time| time * scale).collect();
        let found = backbone.predict(&images.iter().collect::<Vec<_>>(), &times).expect("fits");
        for (found, expected) in found.iter().zip(reference.images("velocity")) {
            let apart = apart(found, &expected);
            println!("times {times:?}: velocity {apart:.1e}");
            assert_eq!(apart < 1e-4, fits, "{apart}");
        }
    }
    let end = sample(&backbone, &backbone.sampler(8), reference.images("sampler_start").remove(0), &[]);
    let apart = apart(&end, &reference.images("sampler_end")[0]);
    println!("8 steps {apart:.1e}");
    assert!(apart < 1e-4, "{apart}");
}
