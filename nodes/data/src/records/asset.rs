//! Decoded assets, and what became of each file.

use super::scene::{blob_parts, export_blobs, import_blobs};
use crate::scene::{Bsdf, Texture};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Artifact, Context, Digest, KindError, Media, ReadFiles, Stored, WriteFiles, json_media, parse_json, pretty_json,
};

/// An HDRI or an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asset {
    /// Its name: the file's, extension included.
    pub name: String,
    /// Its type.
    pub body: AssetBody,
}

/// The type of an asset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum AssetBody {
    /// An environment map.
    Hdri {
        /// Its image, in the format of [`crate::mesh::Bitmap`].
        image: Digest,
        /// Its size in texels.
        size: [usize; 2],
        /// Mean luminance over the sphere, by solid angle.
        mean: f64,
        /// Share of all light in the brightest thousandth of the sphere.
        top_share: f64,
    },
    /// An object of one or more meshes, standing on y = 0 about the y axis, its robust box of largest side 1.
    Object {
        /// Its meshes.
        parts: Vec<AssetPart>,
        /// Its materials.
        materials: Vec<AssetMaterial>,
        /// Corners of its box.
        bounds: [[f64; 3]; 2],
    },
}

/// A mesh of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetPart {
    /// Its blob, in the format of [`crate::mesh::Mesh`].
    pub mesh: Digest,
    /// Index into the object's materials.
    pub material: usize,
    /// True if it encloses a volume, so that glass suits it.
    pub closed: bool,
    /// True if it has texture coordinates.
    pub uv: bool,
    /// Triangles.
    pub triangles: usize,
}

/// A material of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AssetMaterial {
    /// The file's own material.
    pub own: Bsdf,
    /// The same as a diffuse surface: base colour and opacity alone.
    pub diffuse: Bsdf,
    /// True if it lets light through other than by opacity.
    pub transmissive: bool,
    /// Emitted radiance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emission: Option<Texture>,
}

/// The import result of a file; item of the port `reports`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AssetReport {
    /// The file's name.
    pub name: String,
    /// `environment` or `object`, once that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sort: Option<String>,
    /// True if it became an asset.
    pub accepted: bool,
    /// Why not, in one line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Repairs and their number, e.g. `negative texels set to 0`.
    pub repairs: BTreeMap<String, u64>,
    /// Approximations and other notes.
    pub notes: Vec<String>,
    /// Measures: texels, triangles, meshes, mean radiance.
    pub measures: BTreeMap<String, f64>,
}

impl AssetReport {
    /// Counts a repair.
    pub fn repaired(&mut self, what: &str, count: u64) {
        if count > 0 {
            *self.repairs.entry(what.to_owned()).or_default() += count;
        }
    }

    /// Notes something once.
    pub fn note(&mut self, text: impl Into<String>) {
        let text = text.into();
        if !self.notes.contains(&text) {
            self.notes.push(text);
        }
    }

    /// Records a measure.
    pub fn measure(&mut self, name: &str, value: f64) {
        self.measures.insert(name.to_owned(), value);
    }
}

impl Asset {
    /// Every blob it reads, without repeats.
    pub fn blobs(&self) -> Vec<Digest> {
        let mut found = Vec::new();
        match &self.body {
            AssetBody::Hdri { image, .. } => found.push(*image),
            AssetBody::Object { parts, materials, .. } => {
                found.extend(parts.iter().map(|p| p.mesh));
                for material in materials {
                    material.own.images(&mut found);
                    material.diffuse.images(&mut found);
                    if let Some(emission) = &material.emission {
                        emission.images(&mut found);
                    }
                }
            }
        }
        found.sort();
        found.dedup();
        found
    }
}

const ASSET: &str = "asset.json";

impl Media for Asset {
    const NAME: &'static str = "tauflow/asset";
    const DOC: &'static str = "A decoded HDRI or object: `asset.json`, and its meshes and images as `blob/<digest>`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        ctx.json(artifact, ASSET)
    }

    /// Its blobs must be in the store already.
    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let own = (ASSET.to_owned(), ctx.put_json(self)?);
        Ok(Stored::tree(std::iter::once(own).chain(blob_parts(self.blobs()))))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let asset = Self::load(ctx, artifact)?;
        to.put(ASSET, &pretty_json(&asset)?)?;
        export_blobs(ctx, &asset.blobs(), to)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let asset: Self = parse_json(ASSET, &from.need(ASSET)?)?;
        import_blobs(ctx, from, &asset.blobs())?;
        asset.store(ctx)
    }
}

json_media! { AssetReport, "tauflow/asset-report", "What became of a file: repairs, notes, why it was refused."; }
