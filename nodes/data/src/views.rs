//! Views of an image: its mirror images and quarter turns, with its G-buffer. A method that predicts from several views
//! averages their errors.

use crate::Image;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use tauflow_contract::KindError;

/// How many views of an image a prediction is the mean of, written as that number. 1 is the image alone; 2 adds its
/// mirror image from left to right, 4 both upside down, and 8 all four with rows for columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u64", into = "u64")]
pub struct Views(u8);

impl Views {
    /// The image alone.
    pub const ONE: Self = Self(1);

    /// The supported numbers.
    const COUNTS: [u8; 4] = [1, 2, 4, 8];
}

impl Views {
    /// The views that are averaged, the image itself first.
    pub fn all(self) -> impl Iterator<Item = View> {
        (0..usize::from(self.0)).map(View)
    }
}

impl Default for Views {
    fn default() -> Self {
        Self::ONE
    }
}

impl TryFrom<u64> for Views {
    type Error = KindError;

    fn try_from(views: u64) -> Result<Self, KindError> {
        let found = Self::COUNTS.into_iter().find(|count| u64::from(*count) == views);
        found.map(Self).ok_or_else(|| KindError::Input(format!("{views} views are not supported; use 1, 2, 4 or 8")))
    }
}

impl From<Views> for u64 {
    fn from(views: Views) -> Self {
        u64::from(views.0)
    }
}

impl JsonSchema for Views {
    fn schema_name() -> Cow<'static, str> {
        "Views".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "integer", "enum": Self::COUNTS })
    }
}

/// Which sides change places: left and right if the first bit is set, top and bottom if the second is; then, if the
/// third is, rows and columns. Together the eight are what training turns its windows by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View(usize);

impl View {
    fn sides(self) -> bool {
        self.0 & 1 == 1
    }

    fn ends(self) -> bool {
        self.0 & 2 == 2
    }

    fn rows_for_columns(self) -> bool {
        self.0 & 4 == 4
    }

    /// The view that undoes this one: once rows stand for columns, the left is what the top was.
    pub fn inverse(self) -> Self {
        if self.rows_for_columns() { Self(4 | (self.0 & 1) << 1 | (self.0 & 2) >> 1) } else { self }
    }

    /// The image [H, W, C] in this view.
    ///
    /// # Errors
    /// None for images that are whole.
    pub fn image(self, image: &Image) -> Result<Image, KindError> {
        let (width, height) = (image.width(), image.height());
        let (across, down) = if self.rows_for_columns() { (height, width) } else { (width, height) };
        let mut data = Vec::with_capacity(image.data().len());
        for y in 0..down {
            for x in 0..across {
                let (column, row) = if self.rows_for_columns() { (y, x) } else { (x, y) };
                let from_x = if self.sides() { width - 1 - column } else { column };
                let from_y = if self.ends() { height - 1 - row } else { row };
                data.extend_from_slice(image.pixel(from_x, from_y));
            }
        }
        Ok(Image::from_data(across, down, image.channels(), data)?)
    }

    /// The G-buffer [H, W, 6] of albedo and normal in this view. Normals (right, up, back) turn along.
    ///
    /// # Errors
    /// None for images that are whole.
    pub fn gbuffer(self, gbuffer: &Image) -> Result<Image, KindError> {
        let mut out = self.image(gbuffer)?;
        for pixel in out.data_mut().chunks_exact_mut(6) {
            if self.sides() {
                pixel[3] = -pixel[3];
            }
            if self.ends() {
                pixel[4] = -pixel[4];
            }
            if self.rows_for_columns() {
                // What was down is right now, and what was right is down.
                (pixel[3], pixel[4]) = (-pixel[4], -pixel[3]);
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    fn image(channels: usize, seed: u64) -> Image {
        let mut stream = Stream::new(seed, &[]);
        let data = (0..16 * 8 * channels).map(|_| stream.range(0.0, 1.0) as f32).collect();
        Image::from_data(16, 8, channels, data).expect("fits")
    }

    fn square() -> Image {
        let mut stream = Stream::new(7, &[]);
        Image::from_data(8, 8, 3, (0..192).map(|_| stream.range(0.0, 1.0) as f32).collect()).expect("fits")
    }

    #[test]
    fn a_view_is_undone_and_normals_turn_with_it() {
        for view in (0..8).map(View) {
            let (state, gbuffer) = (image(3, 1), image(6, 2));
            let seen = view.image(&state).expect("fits");
            let turned = if view.rows_for_columns() { (8, 16) } else { (16, 8) };
            assert_eq!((seen.width(), seen.height()), turned);
            let again = view.inverse().gbuffer(&view.gbuffer(&gbuffer).expect("fits")).expect("fits");
            assert_eq!((view.inverse().image(&seen).expect("fits"), again), (state, gbuffer));
        }
        // All of them are different.
        let seen: Vec<_> = (0..8).map(|view| View(view).image(&square()).expect("fits")).collect();
        assert!((0..8).all(|a| (0..a).all(|b| seen[a] != seen[b])));
        // A bump seen from the front, whose normals lean away from its middle, looks the same from all sides.
        let bump = |i: usize| [0.1, 0.2, 0.3, (i % 6) as f32 - 2.5, 2.5 - (i / 6) as f32, 1.0];
        let bump = Image::from_data(6, 6, 6, (0..36).flat_map(bump).collect()).expect("fits");
        assert!((0..8).all(|view| View(view).gbuffer(&bump).expect("fits") == bump));
    }

    #[test]
    fn views_are_1_2_4_or_8() {
        for views in [1, 2, 4, 8] {
            let read: Views = serde_json::from_value(views.into()).expect("a number of views");
            assert_eq!(serde_json::to_value(read).expect("plain"), views);
        }
        for views in [0u64, 3, 16, 257] {
            let error = serde_json::from_value::<Views>(views.into()).expect_err("none").to_string();
            assert!(error.contains("1, 2, 4 or 8"), "{error}");
        }
    }
}
