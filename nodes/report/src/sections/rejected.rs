//! Rejected scenes by reason, with images.

use crate::{
    gate_sheets::{Sheet, explained},
    montage::reduce,
    page::{Section, tabs},
    sections::montage::linked,
    shelf::Viewer,
    text::{count, escape, png_uri},
};
use std::fmt::Write as _;
use tauflow_contract::KindError;
use tauflow_data::image_io::encode_png;

/// Pictures of a reason that the page shows; the files hold all.
const SHOWN: usize = 12;

/// The section; none without sheets.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn section(sheets: &[Sheet], pixels: usize, viewer: Option<&Viewer>) -> Result<Option<Section>, KindError> {
    if sheets.is_empty() {
        return Ok(None);
    }
    let panel = |sheet: &Sheet| -> Result<(String, String), KindError> {
        let name = sheet.reason.as_ref().map_or("accepted".to_owned(), |reason| reason.replace('_', " "));
        Ok((format!("{name} ({})", count(sheet.of)), grid(sheet, pixels, viewer)?))
    };
    let panels = sheets.iter().map(panel).collect::<Result<Vec<_>, _>>()?;
    let body = format!(
        "<p>Previews by the first reason of their verdict, evenly spaced by scene number, each at the exposure that \
         the gate computed. The files <code>gate-…png</code> contain more.</p>{}",
        tabs("gate", &panels)
    );
    let title =
        if sheets.iter().any(|sheet| sheet.reason.is_some()) { "Rejected scenes" } else { "Scenes after the gate" };
    Ok(Some(Section::new("rejected", title, body)))
}

fn grid(sheet: &Sheet, pixels: usize, viewer: Option<&Viewer>) -> Result<String, KindError> {
    let mut out = String::new();
    if let Some(reason) = &sheet.reason {
        let what = explained(reason);
        let mut chars = what.chars();
        let capital = chars.next().map_or_else(String::new, |c| c.to_uppercase().collect::<String>() + chars.as_str());
        let _ = write!(out, "<p>{}.</p>", escape(&capital));
    }
    out.push_str("<div class=\"sheet\">");
    let step = sheet.pictures.len().div_ceil(SHOWN).max(1);
    for shot in sheet.pictures.iter().step_by(step) {
        let longest = shot.image.width().max(shot.image.height());
        let image = reduce(&shot.image, longest.div_ceil(pixels.max(1)));
        let (w, h) = (image.width(), image.height());
        let also = match shot.also.len() {
            0 => String::new(),
            _ => format!("; also {}", shot.also.join(", ").replace('_', " ")),
        };
        let (scene, also) = (escape(&shot.scene), escape(&also));
        let source = png_uri(&encode_png(&image)?);
        let shown = format!("<img alt=\"{scene}{also}\" width=\"{w}\" height=\"{h}\" src=\"{source}\">");
        let shown = linked(&shown, viewer, &shot.scene, "");
        let _ = write!(out, "<div title=\"{scene}{also}\">{shown}<div class=\"psnr\">{scene}</div></div>");
    }
    out.push_str("</div>");
    Ok(out)
}
