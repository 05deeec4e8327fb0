//! Metrics of images at the ends of what numbers can be.

use super::{Hazard, about, held};
use tauflow_data::{Image, rng::Stream};
use tauflow_eval::{PSNR_CEILING, bounded, metrics::metrics};

const AREA: &str = "Metrics";

fn noise(seed: u64, scale: f32) -> Image {
    let mut stream = Stream::new(seed, &[]);
    let data = (0..16 * 16 * 3).map(|_| scale * stream.uniform() as f32).collect();
    Image::from_data(16, 16, 3, data).expect("fits")
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add = |fed: &str, must: &str, came: Result<String, String>| out.push(Hazard::new(AREA, fed, must, came));
    let of = |a: &Image, b: &Image| metrics(a, b).map_err(|e| e.to_string());
    let image = noise(1, 1.0);
    let came = of(&image, &image).and_then(|m| {
        let fine = m.hdr_psnr.is_infinite()
            && m.preview_psnr.is_infinite()
            && m.hdr_mae == 0.0
            && (m.ssim - 1.0).abs() < 1e-12;
        held(fine, format!("infinite PSNR, which means take as {PSNR_CEILING:.1} dB; SSIM 1"))
    });
    add("an image and itself", "infinite PSNR, no error, SSIM 1", came);
    add(
        "an infinite PSNR in a mean",
        "a finite mean",
        held(bounded("hdr_psnr", f64::INFINITY).is_finite(), "the ceiling".into()),
    );
    let black = Image::new(16, 16, 3);
    let came = of(&image, &black).and_then(|m| {
        held(m.hdr_psnr.is_finite() && m.hdr_psnr_max.is_finite() && m.ssim.is_finite(), "finite".into())
    });
    add("any image against black", "finite: the peak of a black reference is 1", came);
    let came = of(&black, &black)
        .and_then(|m| held(m.hdr_psnr.is_infinite() && (m.ssim - 1.0).abs() < 1e-12, "identity".into()));
    add("black against black", "identity", came);
    for scale in [1e-30f32, 1e-6, 1e6, 1e18, 3e38] {
        let (a, b) = (noise(1, scale), noise(2, scale));
        let came = of(&a, &b).and_then(|m| {
            let relative = m.hdr_mae / f64::from(scale);
            held(
                relative > 0.2 && relative < 0.5 && !m.hdr_psnr.is_nan() && m.ssim.is_finite(),
                format!("MAE {} of the scale", about(relative)),
            )
        });
        add(
            &format!("noise of {scale:.0e} against other noise of it"),
            "errors in proportion, nothing that is no number",
            came,
        );
    }
    // What no light can be counts as none: a reference that no ladder has, and an image that a network without the law may make.
    let came = of(&image.map(|v| -v), &black).and_then(|m| {
        let fine = m.hdr_psnr.is_infinite() && m.hdr_mae == 0.0 && m.preview_psnr.is_infinite();
        held(fine, format!("identity: negative values count as 0, MAE {}", about(m.hdr_mae)))
    });
    add("a negative image against black", "identity: radiance below 0 counts as 0, in both", came);
    let mut firefly = image.clone();
    firefly.data_mut()[50] = 1e12;
    let came = of(&firefly, &image).and_then(|m| {
        let exact = 10.0 * (768.0f64 / (1e12f64 - f64::from(image.data()[50])).powi(2)).log10();
        let off = (m.hdr_psnr - exact).abs();
        held(off < 1e-6, format!("exact to {} dB", about(off)))
    });
    add("one pixel at 1e12", "the PSNR of that pixel", came);
    for value in [f32::NAN, f32::INFINITY] {
        let mut broken = image.clone();
        broken.data_mut()[5] = value;
        let came = match (of(&broken, &image), of(&image, &broken)) {
            (Err(told), Err(_)) => held(told.contains("1 of the 768"), "refused, with how many".into()),
            _ => Err("taken".into()),
        };
        add(&format!("a value of {value} on either side"), "refused", came);
    }
    let came = match of(&Image::new(8, 8, 3), &Image::new(8, 8, 3)) {
        Err(told) => held(told.contains("11 x 11"), "refused".into()),
        Ok(_) => Err("taken".into()),
    };
    add("images smaller than SSIM's window", "refused", came);
    out
}
