//! The paired montage: frozen, adapted, their difference, and the controls, sample by sample.

use super::{album::image_of, samples::ByBackbone};
use crate::{
    font,
    montage::{centred, paste, reduce},
    page::{Section, tabs},
    sections::montage::linked,
    shelf::Viewer,
    text::{escape, plural, png_uri},
};
use std::fmt::Write as _;
use tauflow_contract::{Context, KindError};
use tauflow_data::{
    Image,
    image_io::encode_png,
    records::{Generated, Variant},
};

/// How much differences are enlarged.
const GAIN: f32 = 4.0;

/// The samples of a backbone as rows of pictures.
pub(super) struct Montage {
    /// Name of the backbone.
    pub(super) backbone: String,
    /// Name of its PNG.
    pub(super) file: String,
    heads: Vec<&'static str>,
    rows: Vec<Row>,
}

/// The pictures of a sample.
struct Row {
    /// Key of its item.
    key: String,
    /// Its number.
    sample: u64,
    /// Each with its frame in the viewer.
    pictures: Vec<(Image, String)>,
}

/// By how much a picture is reduced.
pub(super) fn factor(image: &Image, pixels: usize) -> usize {
    image.width().max(image.height()).div_ceil(pixels.max(1))
}

/// Montages of the first samples of each backbone.
///
/// # Errors
/// If an image is missing from the store or damaged.
pub(super) fn montages(
    ctx: &Context<'_>,
    all: &ByBackbone<'_>,
    samples: usize,
    pixels: usize,
) -> Result<Vec<Montage>, KindError> {
    let mut out = Vec::new();
    for (backbone, of) in all {
        let (mut heads, mut rows) = (Vec::new(), Vec::new());
        for sample in of.iter().take(samples) {
            ctx.check_cancelled()?;
            let variants: Vec<Variant> = sample.meta.variants.iter().map(|its| its.variant).collect();
            let images: Vec<Image> =
                variants.iter().map(|v| Generated::image(ctx, sample.item, *v)).collect::<Result<_, KindError>>()?;
            let (mut own, mut row) = (Vec::new(), Vec::new());
            for (variant, image) in variants.iter().zip(&images) {
                let by = factor(image, pixels);
                own.push(variant.label());
                row.push((reduce(image, by), image_of(*variant)));
                if *variant == Variant::Adapted {
                    own.push("difference");
                    row.push((reduce(&difference(&images[0], image), by), image_of(*variant)));
                }
            }
            if heads.len() < own.len() {
                heads = own;
            }
            rows.push(Row { key: sample.key.clone(), sample: sample.meta.sample, pictures: row });
        }
        let file = format!("montage-{backbone}.png");
        out.push(Montage { backbone: backbone.clone(), file, heads, rows });
    }
    Ok(out)
}

/// Grey where both are equal.
fn difference(frozen: &Image, adapted: &Image) -> Image {
    let mut out = adapted.clone();
    for (value, base) in out.data_mut().iter_mut().zip(frozen.data()) {
        *value = (0.5 + GAIN * (*value - base)).clamp(0.0, 1.0);
    }
    out
}

impl Montage {
    /// The montage as one labelled PNG on white.
    ///
    /// # Errors
    /// If it cannot be encoded.
    pub(super) fn png(&self) -> Result<Vec<u8>, KindError> {
        const GAP: usize = 8;
        const LINE: usize = font::HEIGHT * 2 + 6;
        let images = self.rows.iter().flat_map(|row| &row.pictures);
        let size = images.fold((1, 1), |(w, h), (i, _)| (w.max(i.width()), h.max(i.height())));
        let zoom = (192 / size.0.max(size.1)).max(1);
        let (cell_w, cell_h) = (size.0 * zoom, size.1 * zoom);
        let width = GAP + self.heads.len() * (cell_w + GAP);
        let height = GAP + LINE + self.rows.len() * (cell_h + GAP);
        let mut sheet = Image::new(width, height, 3).map(|_| 1.0);
        for (c, head) in self.heads.iter().enumerate() {
            centred(&mut sheet, GAP + c * (cell_w + GAP), cell_w, GAP / 2, head);
        }
        for (r, row) in self.rows.iter().enumerate() {
            for (c, (image, _)) in row.pictures.iter().enumerate() {
                paste(&mut sheet, image, [GAP + c * (cell_w + GAP), GAP + LINE + r * (cell_h + GAP)], zoom);
            }
        }
        Ok(encode_png(&sheet)?)
    }
}

/// The section; none without pictures.
///
/// # Errors
/// If a picture cannot be encoded.
pub(super) fn section(montages: &[Montage], viewer: Option<&Viewer>) -> Result<Option<Section>, KindError> {
    if montages.is_empty() {
        return Ok(None);
    }
    let panels = montages
        .iter()
        .map(|montage| Ok((montage.backbone.clone(), grid(montage, viewer)?)))
        .collect::<Result<Vec<_>, KindError>>()?;
    let open = viewer.map_or_else(String::new, |viewer| {
        let more = match viewer.left_out {
            0 => String::new(),
            left => format!(" It omits {}, which it has no room for.", plural(left as u64, "sample")),
        };
        format!(
            "<p><a href=\"{}\">Open the viewer</a> to compare and zoom; every picture is a link to it.{more}</p>",
            Viewer::FILE
        )
    });
    let body = format!(
        "<p>The first samples by number (not selected by quality). Each row has one seed. The difference is 0.5 + \
         {GAIN} (adapted − frozen); grey means no change.</p>{open}{}",
        tabs("montage", &panels)
    );
    Ok(Some(Section::new("pictures", "Paired samples", body)))
}

fn grid(montage: &Montage, viewer: Option<&Viewer>) -> Result<String, KindError> {
    let mut out =
        String::from(r#"<div class="scroll"><table class="montage" style="min-width:640px"><thead><tr><th></th>"#);
    for head in &montage.heads {
        let _ = write!(out, "<th>{}</th>", escape(head));
    }
    out.push_str("</tr></thead><tbody>");
    for Row { key, sample, pictures } in &montage.rows {
        let _ = write!(out, "<tr><td>sample {sample}</td>");
        for ((image, frame), head) in pictures.iter().zip(&montage.heads) {
            let shown = picture(image, &format!("{head}, sample {sample} of {}", montage.backbone))?;
            let _ = write!(out, "<td>{}</td>", linked(&shown, viewer, key, frame));
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    Ok(out)
}

/// A picture as an element.
pub(super) fn picture(image: &Image, alt: &str) -> Result<String, KindError> {
    let (alt, width, height) = (escape(alt), image.width(), image.height());
    let source = png_uri(&encode_png(image)?);
    Ok(format!(r#"<img alt="{alt}" width="{width}" height="{height}" src="{source}">"#))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_enlarged_about_grey() {
        let image = |v: f32| Image::from_data(1, 1, 3, vec![v; 3]).expect("fits");
        assert_eq!(difference(&image(0.5), &image(0.5)).data(), [0.5; 3]);
        assert_eq!(difference(&image(0.5), &image(0.5625)).data(), [0.75; 3]);
        assert_eq!(difference(&image(1.0), &image(0.0)).data(), [0.0; 3]);
    }
}
