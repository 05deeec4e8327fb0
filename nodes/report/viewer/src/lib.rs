//! The viewer of images: a page in plain JavaScript and WebGL2 with all its data, which needs no server and no network.
//! Up to a limit it is one file; beyond, its data are scripts in a folder beside it.
//!
//! Knows images, and frames and scenes by name. Knows neither kinds nor pipelines.

mod half;
mod page;
mod thumb;

pub use half::{Half, LARGEST};
pub use page::{Page, Written};

use serde::Serialize;
use std::{collections::BTreeMap, path::PathBuf};
use tauflow_data::Image;

/// Bytes up to which a page is one file.
pub const ONE_FILE: usize = 30 << 20;

/// A page that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    /// A file cannot be written.
    #[error("cannot write {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// An image that no browser shows.
    #[error("{scene}, {frame}: the image has {width} x {height} pixels of {channels} values; a viewer needs 1 or 3")]
    Image {
        /// The scene.
        scene: String,
        /// The frame.
        frame: String,
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
        /// Values in a pixel.
        channels: usize,
    },
}

/// What is said of the whole page.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Head {
    /// Title, such as `quickstart, refined`.
    pub title: String,
    /// Version and origin, for the foot of the page.
    pub provenance: String,
    /// The command that makes the page.
    pub command: String,
    /// The frame that is shown first.
    pub first: usize,
    /// Meanings of the reasons of a gate, by name.
    pub reasons: BTreeMap<String, String>,
}

/// What the values of a frame are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Content {
    /// Linear radiance.
    Radiance,
    /// Albedo.
    Albedo,
    /// Normals.
    Normal,
    /// Variance of samples.
    Variance,
    /// Display values in [0, 1]: images that never were radiance, such as samples of generative models.
    Display,
}

/// States of the same origin, such as the rungs of a ladder or a solver's images.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Track {
    /// Its name.
    pub name: String,
    /// The space of its values, for people.
    pub space: String,
    /// Whether its values are raw radiance, which has no exposure.
    pub raw: bool,
    /// For the states of a solver, which nobody rendered: the track of the rungs that they lie between.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between: Option<usize>,
}

/// A kind of image that scenes have: a rung, the result of a solver, a G-buffer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frame {
    /// Its name in links.
    pub id: String,
    /// Its track.
    pub track: usize,
    /// Its name within the track.
    pub label: String,
    /// What its values are.
    pub content: Content,
    /// Its place in the track: small numbers come first.
    pub order: u64,
    /// Its variance time.
    pub tau: Option<f64>,
    /// The frame that it was made from, or the one before it: their difference is a direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub before: Option<usize>,
}

/// A scene with its images.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// Its key.
    pub key: String,
    /// Its stratum; empty for none.
    pub stratum: String,
    /// The reasons for which a gate rejected it; none if no gate judged it.
    pub reasons: Option<Vec<String>>,
    /// Measurements of the gate.
    pub measures: BTreeMap<String, f64>,
    /// The factor between raw radiance and its images.
    pub exposure: Option<f64>,
    /// The frame that others are compared with.
    pub reference: Option<usize>,
    /// Its images by frame.
    pub images: Vec<(usize, Image)>,
}
