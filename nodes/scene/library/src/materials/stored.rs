//! The maps of the library as blobs: made once a store, then found by their names.

use super::super::textures::{Maps, Pattern, VERSION};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Artifact, Basis, Context, Digest, KindError, MemoKey};
use tauflow_data::{Image, mesh::Bitmap};

/// The metadata of maps that a material needs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// Mean albedo.
    pub mean: [f64; 3],
    /// Largest albedo of each channel.
    pub most: [f64; 3],
    /// Mean and largest roughness.
    pub rough: [f64; 2],
}

/// Maps in the store.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// Albedo.
    pub color: Digest,
    /// Perceptual roughness.
    pub roughness: Digest,
    /// Normals; none where it is flat.
    pub normal: Option<Digest>,
    /// Their content.
    pub facts: Facts,
}

/// What the store keeps of a variant's maps, and its parts: an artifact of this kind's own, which passes no port.
const MEDIA: &str = "tauflow/library-maps";
const COLOR: &str = "color";
const ROUGHNESS: &str = "roughness";
const NORMAL: &str = "normal";
const FACTS: &str = "facts";

/// Stores an image in the smallest form that keeps its bits.
///
/// # Errors
/// If a blob cannot be stored.
pub fn put_bitmap(ctx: &Context<'_>, image: &Bitmap) -> Result<Digest, KindError> {
    ctx.put(&image.to_small_bytes())
}

fn mean_and_most(image: &Image, channel: usize) -> (f64, f64) {
    let values = image.data().iter().skip(channel.min(image.channels() - 1)).step_by(image.channels());
    let (sum, most, count) = values
        .fold((0.0, 0.0f64, 0.0), |(sum, most, count), v| (sum + f64::from(*v), most.max(f64::from(*v)), count + 1.0));
    (sum / count, most)
}

impl Facts {
    /// Of maps.
    pub fn of(maps: &Maps) -> Self {
        let color = [0, 1, 2].map(|c| mean_and_most(&maps.color, c));
        let (rough, roughest) = mean_and_most(&maps.roughness, 0);
        Self { mean: color.map(|c| c.0), most: color.map(|c| c.1), rough: [rough, roughest] }
    }
}

impl Stored {
    /// The maps of a variant, made if the store has none.
    ///
    /// # Errors
    /// If a blob cannot be stored or read.
    pub fn of(ctx: &Context<'_>, pattern: &Pattern, variant: u64) -> Result<Self, KindError> {
        let params = serde_json::json!({ "pattern": pattern.name, "variant": variant });
        let basis = Basis::new("scene_generation", VERSION, "maps").with(params, None);
        let key = MemoKey { basis, inputs: Vec::new() };
        if let Some(artifact) = ctx.memo_get(&key)
            && let (Some(color), Some(roughness)) = (artifact.part(COLOR), artifact.part(ROUGHNESS))
        {
            let facts = ctx.json(&artifact, FACTS)?;
            return Ok(Self { color, roughness, normal: artifact.part(NORMAL), facts });
        }
        let maps = pattern.maps(variant);
        let facts = Facts::of(&maps);
        let stored = Self {
            color: put_bitmap(ctx, &maps.color)?,
            roughness: put_bitmap(ctx, &maps.roughness)?,
            normal: maps.normal.as_ref().map(|normal| put_bitmap(ctx, normal)).transpose()?,
            facts,
        };
        let mut parts = vec![
            (COLOR.to_owned(), stored.color),
            (ROUGHNESS.to_owned(), stored.roughness),
            (FACTS.to_owned(), ctx.put_json(&facts)?),
        ];
        parts.extend(stored.normal.map(|normal| (NORMAL.to_owned(), normal)));
        ctx.memo_put(&key, &Artifact::tree(MEDIA, parts))?;
        Ok(stored)
    }
}
