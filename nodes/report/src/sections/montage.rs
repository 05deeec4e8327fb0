//! Pictures: strata x methods, and methods x numbers of calls.

use crate::{
    montage::Montage,
    page::{Section, tabs},
    shelf::Viewer,
    text::{escape, fixed, plural, png_uri},
};
use std::fmt::Write as _;
use tauflow_contract::KindError;
use tauflow_data::{Stratum, image_io::encode_png};

/// The section; none without pictures.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn section(
    montages: &[Montage],
    by_calls: &[Montage],
    [nfe, nfe_gbuffer]: [u64; 2],
    viewer: Option<&Viewer>,
) -> Result<Option<Section>, KindError> {
    let Some(first) = montages.iter().find(|m| !m.rows.is_empty()) else { return Ok(None) };
    let panels = |of: &[Montage]| -> Result<Vec<(String, String)>, KindError> {
        of.iter().filter(|m| !m.rows.is_empty()).map(|m| Ok((m.title.clone(), grid(m, viewer)?))).collect()
    };
    let reduced = match first.reduced {
        1 => String::new(),
        n => format!(
            " Pictures are averaged over {n} × {n} pixels, which hides some noise; scores are for full resolution."
        ),
    };
    let calls = match nfe_gbuffer == nfe {
        true => format!("at NFE {nfe}"),
        false => format!("at NFE {nfe}, those with G-buffers at NFE {nfe_gbuffer}"),
    };
    let mut body = format!(
        "<p>The first scene of each stratum by number (not selected by quality), {calls}. Captions: HDR PSNR in \
         dB, with the best of each row in bold.{reduced}</p>{}",
        tabs("montage", &panels(montages)?)
    );
    if let Some(viewer) = viewer.filter(|viewer| viewer.left_out > 0) {
        let left = plural(viewer.left_out as u64, "scene");
        let _ = write!(
            body,
            "<p class=\"note\">The viewer omits {left}, which it has no room for; <code>tauflow view</code> writes \
             all.</p>"
        );
    }
    if let Some(row) = by_calls.iter().find_map(|m| m.rows.first()) {
        let _ = write!(
            body,
            "<h3>By number of calls</h3><p>Scene {}, whose input has the median HDR PSNR of the scenes above.</p>{}",
            escape(&row.scene),
            tabs("by-nfe", &panels(by_calls)?)
        );
    }
    Ok(Some(Section::new("pictures", "Pictures", body)))
}

/// A stratum in two lines, anything else as it is.
fn row_head(head: &str) -> String {
    let stratum = Stratum::all().map(|stratum| stratum.to_string()).find(|stratum| stratum == head);
    stratum.map_or_else(|| escape(head), |stratum| stratum.replacen('-', "<br>", 1))
}

/// A picture that leads to its frame in the viewer, if the viewer has its scene.
pub fn linked(picture: &str, viewer: Option<&Viewer>, scene: &str, frame: &str) -> String {
    match viewer.and_then(|viewer| viewer.address(scene, frame)) {
        Some(address) => format!("<a href=\"{address}\">{picture}</a>"),
        None => picture.to_owned(),
    }
}

/// The pictures as a table.
///
/// # Errors
/// If a picture cannot be encoded.
pub fn grid(montage: &Montage, viewer: Option<&Viewer>) -> Result<String, KindError> {
    // Pictures smaller than this show nothing: a narrow page scrolls. All methods are to fit on a wide one.
    let each = if montage.columns.len() > 12 { 66 } else { 84 };
    let width = 92 + each * montage.columns.len();
    let mut out =
        format!(r#"<div class="scroll"><table class="montage" style="min-width:{width}px"><thead><tr><th></th>"#);
    for (_, head) in &montage.columns {
        let _ = write!(out, "<th>{}</th>", escape(head));
    }
    out.push_str("</tr></thead><tbody>");
    for row in &montage.rows {
        let _ = write!(out, r#"<tr title="{}"><td>{}</td>"#, escape(&row.scene), row_head(&row.head));
        let best = row.pictures.iter().filter_map(|p| p.psnr).fold(f64::NEG_INFINITY, f64::max);
        for (picture, (_, head)) in row.pictures.iter().zip(&montage.columns) {
            out.push_str("<td>");
            match &picture.image {
                Some(image) => {
                    let alt = format!("{head}, {}", row.scene);
                    let (w, h) = (image.width(), image.height());
                    let shown = format!(
                        r#"<img alt="{}" width="{w}" height="{h}" src="{}">"#,
                        escape(&alt),
                        png_uri(&encode_png(image)?)
                    );
                    out.push_str(&linked(&shown, viewer, &row.scene, &picture.frame));
                }
                None => out.push_str(r#"<span class="zero">none</span>"#),
            }
            let (text, top) = match picture.psnr {
                Some(psnr) => (fixed(psnr, 2), if psnr == best { " top" } else { "" }),
                None => ("&nbsp;".into(), ""),
            };
            let _ = write!(out, r#"<div class="psnr{top}">{text}</div></td>"#);
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    Ok(out)
}
