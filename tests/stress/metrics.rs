//! Metrics of images at the ends of what numbers can be.

use super::{Hazard, about, held};
use tauflow_data::{
    Image,
    maths::{log10, pow},
    records::Metrics,
    rng::Stream,
};
use tauflow_eval::{PSNR_CEILING, bounded, metrics::metrics};

const AREA: &str = "Metrics";

fn noise(seed: u64, scale: f32) -> Image {
    let mut stream = Stream::new(seed, &[]);
    let data = (0..16 * 16 * 3).map(|_| scale * stream.uniform() as f32).collect();
    Image::from_data(16, 16, 3, data).expect("fits")
}

/// Errors of radiance and of previews beside those that double precision makes of the same images.
fn exact(m: &Metrics, image: &Image, reference: &Image) -> Result<(), String> {
    let preview = |v: f64| pow(v / (1.0 + v), 1.0 / 2.2);
    let errors = |f: &dyn Fn(f64) -> f64| {
        let pairs = image.data().iter().zip(reference.data()).map(|(a, b)| f(f64::from(*a)) - f(f64::from(*b)));
        let (squares, sizes) = pairs.fold((0.0, 0.0), |(squares, sizes), d| (squares + d * d, sizes + d.abs()));
        let count = image.data().len() as f64;
        ((squares / count).sqrt(), sizes / count)
    };
    let ((rmse, mae), (shown_rmse, shown_mae)) = (errors(&|v| v), errors(&preview));
    // Previews are single precision: no difference is known better than what they are.
    let brightest =
        reference.data().iter().chain(image.data()).fold(0.0f64, |most, v| most.max(preview(f64::from(*v))));
    let near = |found: f64, exact: f64| (found - exact).abs() <= 1e-5 * exact + 2.4e-7 * brightest;
    let found = pow(10.0, -m.preview_psnr / 20.0);
    let fine = (m.hdr_mae / mae - 1.0).abs() < 1e-9
        && (m.hdr_psnr + 20.0 * log10(rmse)).abs() < 1e-9
        && near(m.preview_mae, shown_mae)
        && near(found, shown_rmse);
    if fine { Ok(()) } else { Err(format!("{m:?}, not MAE {mae:e}, {shown_mae:e}, RMSE {rmse:e}, {shown_rmse:e}")) }
}

/// What the metrics are, and what means take a PSNR for where it is above the ceiling.
fn said(m: &Metrics, scale: f64) -> String {
    let psnr = |name: &str, value: f64| match bounded(name, value) {
        cut if cut < value && value.is_finite() => format!("{value:.2} dB, counted as {cut:.1} in means"),
        cut if cut < value => format!("infinite, counted as {cut:.1} in means"),
        _ => format!("{value:.2} dB"),
    };
    format!(
        "MAE {} of the scale, PSNR {}, of the maximum {}, of previews {}, SSIM {:.4}",
        about(m.hdr_mae / scale),
        psnr("hdr_psnr", m.hdr_psnr),
        psnr("hdr_psnr_max", m.hdr_psnr_max),
        psnr("preview_psnr", m.preview_psnr),
        m.ssim
    )
}

type Add<'a> = &'a mut dyn FnMut(&str, &str, Result<String, String>);

/// Images without variance, whose metrics are closed forms.
fn constants(add: Add<'_>) {
    for scale in [1e-30f32, 1e-6, 1.0, 1e6, 1e18, 1.5e38] {
        let constant = |v: f32| Image::from_data(16, 16, 3, vec![v; 768]).expect("fits");
        let (image, reference) = (constant(scale), constant(2.0 * scale));
        let by = f64::from(scale);
        let came = metrics(&image, &reference).map_err(|e| e.to_string()).and_then(|m| {
            exact(&m, &image, &reference)?;
            let preview = |v: f64| pow(v / (1.0 + v), 1.0 / 2.2);
            let (a, b) = (preview(by), preview(2.0 * by));
            let ssim = (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4);
            let fine = (m.hdr_psnr + 20.0 * log10(by)).abs() < 1e-9
                && (m.hdr_psnr_max - 20.0 * log10(2.0)).abs() < 1e-9
                && (m.hdr_mae / by - 1.0).abs() < 1e-9
                && (m.ssim - ssim).abs() < 1e-5
                && bounded("hdr_psnr", m.hdr_psnr) == m.hdr_psnr.min(PSNR_CEILING);
            held(fine, said(&m, by))
        });
        add(
            &format!("a constant image of {scale:.1e} against twice its value"),
            "MAE equal to the scale; PSNR of -20 log10 of the scale, `hdr_psnr_max` of 20 log10 2, to 1e-9 dB; limited \
             in means; previews as in double precision; SSIM of the luminances only, to 1e-5",
            came,
        );
    }
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
        held(fine, format!("infinite PSNR, counted as {PSNR_CEILING:.1} dB in means; SSIM 1"))
    });
    add("an image and itself", "infinite PSNR, no error, SSIM 1", came);
    add(
        "an infinite PSNR in a mean",
        "a finite mean",
        held(bounded("hdr_psnr", f64::INFINITY).is_finite(), "the limit of 144.49 dB".into()),
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
            exact(&m, &a, &b)?;
            // The noise is the same at all scales: one image, exposed.
            let plain = of(&noise(1, 1.0), &noise(2, 1.0))?;
            let by = f64::from(scale);
            let same = (m.hdr_mae / by / plain.hdr_mae - 1.0).abs() < 1e-6
                && (m.hdr_psnr + 20.0 * log10(by) - plain.hdr_psnr).abs() < 1e-5
                && (m.hdr_psnr_max - plain.hdr_psnr_max).abs() < 1e-5
                && (0.0..=1.0).contains(&m.ssim);
            held(same, said(&m, by))
        });
        add(
            &format!("noise of {scale:.0e} against independent noise of the same level"),
            "in proportion to the metrics of noise of 1: MAE times the scale, PSNR minus 20 log10 of the scale, \
             `hdr_psnr_max` unchanged, to 1e-5 dB; previews as in double precision; SSIM from 0 to 1",
            came,
        );
    }
    constants(&mut add);
    // What no light can be counts as none: a reference that no ladder has, and an image that a network without the law
    // may make.
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
            (Err(told), Err(_)) => held(told.contains("1 of the 768"), "refused, with their number".into()),
            _ => Err("accepted".into()),
        };
        add(&format!("a value of {value} in the image or the reference"), "refused", came);
    }
    let came = match of(&Image::new(8, 8, 3), &Image::new(8, 8, 3)) {
        Err(told) => held(told.contains("11 x 11"), "refused".into()),
        Ok(_) => Err("accepted".into()),
    };
    add("images smaller than SSIM's window", "refused", came);
    out
}
