//! Environment maps: repairs texels and measures light. Knows no file format.

use super::refusal::{Refusal, damaged};
use tauflow_data::{Image, image::luminance, maths, records::AssetReport};

/// Measures of a map's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Mean luminance over the sphere, by solid angle.
    pub mean: f64,
    /// Share of all light in the brightest thousandth of the sphere.
    pub top_share: f64,
}

/// The largest finite half-precision number: what brighter light is cut to in many files.
const HALF_CAP: f32 = 65504.0;

/// Sets NaN and negative values to 0 and infinite ones to the largest finite, counting each, and measures the light.
///
/// # Errors
/// If no light is left.
pub fn finish(mut image: Image, report: &mut AssetReport) -> Result<(Image, Light), Refusal> {
    let largest = image.data().iter().copied().filter(|v| v.is_finite()).fold(0.0f32, f32::max);
    let (mut nan, mut negative, mut infinite, mut texels, mut capped) = (0, 0, 0, 0, 0);
    for texel in image.data_mut().chunks_exact_mut(3) {
        let mut changed = false;
        capped += u64::from(texel.contains(&HALF_CAP));
        for value in texel {
            let (count, set) = if value.is_nan() {
                (&mut nan, 0.0)
            } else if *value < 0.0 {
                (&mut negative, 0.0)
            } else if value.is_infinite() {
                (&mut infinite, largest)
            } else {
                continue;
            };
            *count += 1;
            *value = set;
            changed = true;
        }
        texels += u64::from(changed);
    }
    report.repaired("NaN values set to 0", nan);
    report.repaired("negative values set to 0", negative);
    report.repaired("infinite values set to the largest finite", infinite);
    report.repaired("texels repaired", texels);
    if capped > 0 {
        report.note(format!("{capped} texels at 65504, the cap of half precision: brighter light may have been cut"));
    }
    let light = measure(&image).ok_or_else(|| damaged("texels", "no texel holds any light"))?;
    let (width, height) = (image.width(), image.height());
    if width != 2 * height {
        report.note(format!("{width} x {height} texels are not 2 : 1; stretched over the whole sphere"));
    }
    report.measure("texels", (width * height) as f64);
    report.measure("width", width as f64);
    report.measure("height", height as f64);
    report.measure("max_luminance", image.data().chunks_exact(3).fold(0.0, |m, t| f64::from(luminance(t)).max(m)));
    report.measure("mean_luminance", light.mean);
    report.measure("top_share", light.top_share);
    Ok((image, light))
}

/// Mean luminance and top share; none for a black map.
fn measure(image: &Image) -> Option<Light> {
    let area = |y: usize| maths::sin(core::f64::consts::PI * (y as f64 + 0.5) / image.height() as f64);
    let areas: Vec<f64> = (0..image.height()).map(area).collect();
    // Luminance and row: half the memory of luminance and area.
    let mut texels: Vec<(f32, u32)> = Vec::with_capacity(image.width() * image.height());
    for y in 0..image.height() {
        texels.extend((0..image.width()).map(|x| (luminance(image.pixel(x, y)), y as u32)));
    }
    let of = |texel: &(f32, u32)| (f64::from(texel.0), areas[texel.1 as usize]);
    let area: f64 = texels.iter().map(|t| of(t).1).sum();
    let total: f64 = texels.iter().map(of).map(|(light, part)| light * part).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    texels.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut top, mut seen) = (0.0, 0.0);
    for (light, part) in texels.iter().map(of) {
        let left = 0.001 * area - seen;
        if left <= 0.0 {
            break;
        }
        top += light * part.min(left);
        seen += part;
    }
    Some(Light { mean: total / area, top_share: top / total })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_texels_are_repaired_and_counted() {
        let values = vec![f32::NAN, -1.0, 2.0, f32::INFINITY, 0.5, -0.25, 65504.0, 1.0, 1.0, 0.0, 0.0, -0.0];
        let image = Image::from_data(4, 1, 3, values).expect("fits");
        let mut report = AssetReport::default();
        let (image, _) = finish(image, &mut report).expect("there is light");
        assert_eq!(image.data(), &[0.0, 0.0, 2.0, 65504.0, 0.5, 0.0, 65504.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        let count = |name: &str| report.repairs.get(name).copied().unwrap_or(0);
        assert_eq!(count("NaN values set to 0"), 1);
        assert_eq!(count("negative values set to 0"), 2);
        assert_eq!(count("infinite values set to the largest finite"), 1);
        assert_eq!(count("texels repaired"), 2);
        assert!(report.notes.iter().any(|n| n.contains("65504")), "{:?}", report.notes);
        assert!(finish(Image::new(2, 1, 3), &mut AssetReport::default()).is_err());
    }

    #[test]
    fn an_even_map_has_its_mean_and_no_top() {
        let image = Image::from_data(64, 32, 3, vec![3.0; 64 * 32 * 3]).expect("fits");
        let light = measure(&image).expect("light");
        assert!((light.mean - 3.0).abs() < 1e-6 && (light.top_share - 0.001).abs() < 1e-9, "{light:?}");
    }
}
