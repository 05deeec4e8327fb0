//! Metrics and curve summaries against numbers of the reference implementations (scikit-image, NumPy), where the folder
//! `shared/reference` lies beside the checkout.

use std::path::PathBuf;
use tauflow_data::{Image, TensorFile};
use tauflow_eval::{curve, metrics::metrics};
use tauflow_testing::{Need, skip};

fn reference_folder() -> Option<PathBuf> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/reference"));
    if folder.is_dir() {
        return Some(folder);
    }
    skip(Need::Shared, format_args!("there is no {}", folder.display()));
    None
}

fn json(folder: &std::path::Path, name: &str) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(folder.join(name)).expect("readable")).expect("JSON")
}

fn near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{what}: {found}, expected {expected}");
}

/// An image of a tensor of shape [3, H, W].
fn planar(file: &TensorFile, name: &str) -> Image {
    let tensor = file.get(name).expect("the tensor is there");
    let (height, width) = (tensor.shape[1], tensor.shape[2]);
    let at = |i: usize| tensor.data[(i % 3) * height * width + i / 3];
    Image::from_data(width, height, 3, (0..3 * height * width).map(at).collect()).expect("fits")
}

#[test]
fn metrics_agree_with_the_reference_implementations() {
    let Some(folder) = reference_folder() else { return };
    let pairs = std::fs::read(folder.join("metric_pairs.safetensors")).expect("readable");
    let pairs = TensorFile::from_bytes(&pairs).expect("f32 tensors");
    let expected = json(&folder, "metric_expected.json");
    let expected = expected.as_array().expect("a list");
    assert_eq!(expected.len(), 4);
    for row in expected {
        let pair = row["pair"].as_u64().expect("a number");
        let found = metrics(&planar(&pairs, &format!("img{pair}")), &planar(&pairs, &format!("ref{pair}")));
        let found = found.expect("comparable");
        let names = [
            ("hdr_psnr_peak1", found.hdr_psnr),
            ("hdr_psnr_peakmax", found.hdr_psnr_max),
            ("hdr_mae", found.hdr_mae),
            ("preview_psnr", found.preview_psnr),
            ("preview_mae", found.preview_mae),
            ("preview_ssim_valid", found.ssim),
        ];
        for (name, value) in names {
            match row[name].as_f64() {
                Some(number) => near(value, number, &format!("{name} of pair {pair}")),
                None => assert!(row[name].is_null() && value == f64::INFINITY, "{name} of pair {pair}: {value}"),
            }
        }
    }
}

#[test]
fn curve_summaries_agree_with_the_reference() {
    let Some(folder) = reference_folder() else { return };
    let expected = json(&folder, "curve_expected.json");
    let nfe: Vec<u64> = serde_json::from_value(expected["nfe"].clone()).expect("counts");
    let psnr: Vec<f64> = serde_json::from_value(expected["psnr"].clone()).expect("numbers");
    let found = curve::summarise(&nfe, &psnr).expect("a curve");
    near(found.auc, expected["auc"].as_f64().expect("a number"), "auc");
    near(found.tv, expected["tv"].as_f64().expect("a number"), "tv");
}
