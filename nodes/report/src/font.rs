//! Labels inside PNGs, in DejaVu Sans. Knows no layout.
//!
//! The font comes with the crate `dejavu`; its licence is that of Bitstream Vera, which allows embedding.

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};
use tauflow_data::Image;

/// Height of a line at scale 1, in pixels, without gap.
pub const HEIGHT: usize = 8;

/// Share of a line that a capital may take: a line has room for what hangs below it.
const EM: f32 = 0.95;

fn font() -> FontRef<'static> {
    FontRef::try_from_slice(dejavu::sans::regular()).expect("the font of the crate is sound")
}

/// The glyphs of a text with their places, from (0, 0), and its width.
fn layout(font: &FontRef<'static>, text: &str, scale: usize) -> (Vec<Glyph>, f32) {
    let size = PxScale::from((HEIGHT * scale) as f32 * EM);
    let scaled = font.as_scaled(size);
    let (mut x, mut before, mut glyphs) = (0.0, None, Vec::new());
    for c in text.chars() {
        let id = font.glyph_id(c);
        x += before.map_or(0.0, |before| scaled.kern(before, id));
        glyphs.push(id.with_scale_and_position(size, point(x, scaled.ascent().round())));
        x += scaled.h_advance(id);
        before = Some(id);
    }
    (glyphs, x)
}

/// Width of a text at a scale.
pub fn width(text: &str, scale: usize) -> usize {
    layout(&font(), text, scale).1.ceil() as usize
}

/// Draws a text with its top-left corner at `at`, in a grey `value`; what falls outside the image is left out.
pub fn draw(image: &mut Image, at: [usize; 2], text: &str, scale: usize, value: f32) {
    let font = font();
    for glyph in layout(&font, text, scale).0 {
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let [left, top] = [outline.px_bounds().min.x as i64, outline.px_bounds().min.y as i64];
        outline.draw(|x, y, covered| {
            let place = |at: usize, corner: i64, offset: u32| usize::try_from(at as i64 + corner + i64::from(offset));
            let (Ok(x), Ok(y)) = (place(at[0], left, x), place(at[1], top, y)) else { return };
            if x < image.width() && y < image.height() {
                // Sixteen levels, so that no last bit of a sum shows.
                let covered = (covered.clamp(0.0, 1.0) * 16.0).round() / 16.0;
                image.pixel_mut(x, y).iter_mut().for_each(|below| *below += covered * (value - *below));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_where_they_should_be() {
        let mut image = Image::new(80, 16, 3);
        draw(&mut image, [0, 0], "I .", 2, 1.0);
        let lit = |x: usize| (0..16).filter(|y| image.pixel(x, *y)[0] > 0.3).collect::<Vec<_>>();
        let columns: Vec<usize> = (0..80).filter(|x| !lit(*x).is_empty()).collect();
        // The stem of the I is a column of a capital's height; the dot is on the base line.
        let stem = columns.iter().copied().find(|x| lit(*x).len() > 8).expect("a stem");
        assert!(stem < 5 && columns.iter().all(|x| *x < width("I .", 2)), "{columns:?}");
        let dot = lit(*columns.last().expect("a dot"));
        assert_eq!(dot.last(), lit(stem).last(), "{dot:?}");
        // Signs beyond ASCII have shapes of their own.
        let drawn = |text: &str| {
            let mut image = Image::new(16, 16, 1);
            draw(&mut image, [0, 0], text, 2, 1.0);
            image
        };
        assert!(drawn("Ω") != drawn("?") && drawn("τ") != drawn("Ω"));
        assert!(width("iiii", 2) < width("mmmm", 2));
        // Beyond the edge nothing is drawn, and nothing panics.
        draw(&mut image, [70, 12], "Ωmega", 3, 1.0);
    }
}
