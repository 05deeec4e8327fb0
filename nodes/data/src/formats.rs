//! Media types, and the blobs that scenes and records are made of.

use crate::{DataError, Image, TensorFile, scene::Recipe, scene::Scene};
use serde::{Deserialize, Serialize};
use tauflow_contract::{Artifact, Context, Digest, KindError};

/// Media type of a scene: `scene.json` ([`Scene`]), `recipe.json` ([`Recipe`]), and its blobs as `blob/<digest>`.
pub const SCENE: &str = "tauflow/scene";
/// Media type of a decoded asset: `asset.json` and its blobs as `blob/<digest>`.
pub const ASSET: &str = "tauflow/asset";
/// Media type of an exposure record, JSON of [`Exposure`].
pub const EXPOSURE: &str = "tauflow/exposure";
/// Media type of a gate verdict, JSON of [`Verdict`].
pub const VERDICT: &str = "tauflow/verdict";
/// What a scene is, measured: [`crate::statistics::SceneStatistics`] as JSON.
pub const STATISTICS: &str = "tauflow/scene-statistics";
/// Media type of a packed scene, see [`PackedScene`].
pub const PACKED: &str = "tauflow/packed-scene";
/// Media type of a trained model: one safetensors blob.
pub const MODEL: &str = "tauflow/model";
/// Media type of refined images, see [`Refined`].
pub const REFINED: &str = "tauflow/refined";
/// Media type of anything that is one JSON blob.
pub const JSON: &str = "application/json";
/// Media type of a tree of files meant for people.
pub const FILES: &str = "tauflow/files";

/// A triangle mesh blob: safetensors with `positions` [V, 3], `indices` [T, 3] (exact in f32 below 2^24, else split by
/// the maker), and optionally `normals` [V, 3], `uvs` [V, 2], `colors` [V, 4], `tangents` [V, 4].
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Vertex normals, or none for flat shading.
    pub normals: Option<Vec<[f32; 3]>>,
    /// Texture coordinates, v downwards (row 0 of the image at v = 0).
    pub uvs: Option<Vec<[f32; 2]>>,
    /// Vertex colours, linear RGBA.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Tangents and handedness.
    pub tangents: Option<Vec<[f32; 4]>>,
}

fn rows<const N: usize>(file: &TensorFile, name: &str) -> Result<Option<Vec<[f32; N]>>, DataError> {
    let Some(tensor) = file.tensors.get(name) else { return Ok(None) };
    if tensor.shape.len() != 2 || tensor.shape[1] != N {
        return Err(DataError::Format(format!("mesh tensor `{name}` has shape {:?}, expected [*, {N}]", tensor.shape)));
    }
    Ok(Some(tensor.data.chunks_exact(N).map(|c| c.try_into().expect("chunks of N")).collect()))
}

impl Mesh {
    /// Its blob.
    ///
    /// # Errors
    /// If it has 2^24 vertices or more.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DataError> {
        if self.positions.len() >= 1 << 24 {
            return Err(DataError::Format(format!("a mesh of {} vertices; split it below 2^24", self.positions.len())));
        }
        let mut file = TensorFile::default()
            .with("positions", &[self.positions.len(), 3], self.positions.concat())
            .with("indices", &[self.triangles.len(), 3], self.triangles.iter().flatten().map(|i| *i as f32).collect());
        if let Some(normals) = &self.normals {
            file = file.with("normals", &[normals.len(), 3], normals.concat());
        }
        if let Some(uvs) = &self.uvs {
            file = file.with("uvs", &[uvs.len(), 2], uvs.concat());
        }
        if let Some(colors) = &self.colors {
            file = file.with("colors", &[colors.len(), 4], colors.concat());
        }
        if let Some(tangents) = &self.tangents {
            file = file.with("tangents", &[tangents.len(), 4], tangents.concat());
        }
        file.to_bytes()
    }

    /// Reads a blob, and checks that indices and attribute lengths fit.
    ///
    /// # Errors
    /// If it is damaged or inconsistent.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let file = TensorFile::from_bytes(bytes)?;
        let missing = |name: &str| DataError::Format(format!("the mesh has no tensor `{name}`"));
        let positions = rows::<3>(&file, "positions")?.ok_or_else(|| missing("positions"))?;
        let indices = rows::<3>(&file, "indices")?.ok_or_else(|| missing("indices"))?;
        let count = positions.len();
        let mut triangles = Vec::with_capacity(indices.len());
        for triangle in indices {
            if triangle.iter().any(|i| !(*i >= 0.0 && (*i as usize) < count)) {
                return Err(DataError::Format(format!("a triangle names a vertex beyond the mesh's {count}")));
            }
            triangles.push(triangle.map(|i| i as u32));
        }
        let mesh = Self {
            triangles,
            normals: rows(&file, "normals")?,
            uvs: rows(&file, "uvs")?,
            colors: rows(&file, "colors")?,
            tangents: rows(&file, "tangents")?,
            positions,
        };
        let fits = |len: Option<usize>| len.is_none_or(|len| len == count);
        if !(fits(mesh.normals.as_ref().map(Vec::len))
            && fits(mesh.uvs.as_ref().map(Vec::len))
            && fits(mesh.colors.as_ref().map(Vec::len))
            && fits(mesh.tangents.as_ref().map(Vec::len)))
        {
            return Err(DataError::Format(format!(
                "the mesh has {count} positions but another number of an attribute"
            )));
        }
        Ok(mesh)
    }
}

/// A bitmap blob: an [`Image`] of 1, 3 or 4 channels, linear, finite and not negative; row 0 on top.
pub type Bitmap = Image;

/// Stores a scene as an artifact; its blobs must be in the store already.
///
/// # Errors
/// If the store cannot be written.
pub fn store_scene(ctx: &Context<'_>, scene: &Scene, recipe: &Recipe) -> Result<Artifact, KindError> {
    let mut parts =
        vec![("scene.json".to_owned(), ctx.put_json(scene)?), ("recipe.json".to_owned(), ctx.put_json(recipe)?)];
    parts.extend(scene.blobs().into_iter().map(|digest| (format!("blob/{digest}"), digest)));
    Ok(Artifact::tree(SCENE, parts))
}

/// The exposure of a scene: one factor for all its rungs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Multiplies linear radiance.
    pub factor: f64,
    /// Offset in stops that is part of the factor.
    pub ev: f64,
    /// Geometric mean luminance of the gate's render.
    pub mean_luminance: f64,
}

/// What the gate said of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Reasons for rejection, empty if accepted; such as `black`, `over_exposed`.
    pub reasons: Vec<String>,
    /// What was measured, by name.
    pub measures: std::collections::BTreeMap<String, f64>,
}

/// A scene packed for learning: one safetensors blob with `states` [K, H, W, 3] (exposed linear radiance, one for each
/// rung), optionally `gbuffer` [H, W, 6] (albedo, normal), and the note `counts`, a JSON list of K sample counts.
#[derive(Clone, Debug, PartialEq)]
pub struct PackedScene {
    /// Sample counts, increasing.
    pub counts: Vec<u64>,
    /// The rungs, exposed.
    pub states: Vec<Image>,
    /// Albedo and normal, 6 channels.
    pub gbuffer: Option<Image>,
}

impl PackedScene {
    /// Its blob.
    ///
    /// # Errors
    /// If the rungs have different shapes.
    pub fn to_bytes(&self) -> Result<Vec<u8>, DataError> {
        let first = self.states.first().ok_or_else(|| DataError::Format("a packed scene without rungs".into()))?;
        if self.states.iter().any(|s| !s.same_shape(first)) || self.states.len() != self.counts.len() {
            return Err(DataError::Format(
                "the rungs of a packed scene differ in shape, or in number from its counts".into(),
            ));
        }
        let shape = [self.states.len(), first.height(), first.width(), first.channels()];
        let data = self.states.iter().flat_map(|s| s.data().iter().copied()).collect();
        let mut file = TensorFile::default()
            .with("states", &shape, data)
            .note("counts", serde_json::to_string(&self.counts).expect("numbers"));
        if let Some(gbuffer) = &self.gbuffer {
            file = file.with_image("gbuffer", gbuffer);
        }
        file.to_bytes()
    }

    /// Reads its blob.
    ///
    /// # Errors
    /// If it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, DataError> {
        let file = TensorFile::from_bytes(bytes)?;
        let states = file.get("states")?;
        let [rungs, height, width, channels] = states.shape[..] else {
            return Err(DataError::Format(format!("`states` has shape {:?}, expected [K, H, W, 3]", states.shape)));
        };
        let counts: Vec<u64> = file
            .metadata
            .get("counts")
            .and_then(|json| serde_json::from_str(json).ok())
            .ok_or_else(|| DataError::Format("a packed scene without the note `counts`".into()))?;
        if counts.len() != rungs {
            return Err(DataError::Format(format!("{} counts for {rungs} rungs", counts.len())));
        }
        let stride = height * width * channels;
        let states = (0..rungs)
            .map(|k| Image::from_data(width, height, channels, states.data[k * stride..(k + 1) * stride].to_vec()))
            .collect::<Result<_, _>>()?;
        let gbuffer = file.tensors.contains_key("gbuffer").then(|| file.image("gbuffer")).transpose()?;
        Ok(Self { counts, states, gbuffer })
    }
}

/// What a refined artifact says of itself: a tree of `meta.json` and `image/<index, 4 digits>`, exposed linear radiance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refined {
    /// One for each image, in order.
    pub images: Vec<RefinedImage>,
    /// Why there are none, for people; such as a library that is missing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// One refined image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedImage {
    /// Which method made it, e.g. `mc_noise`.
    pub method: String,
    /// Sample count of the endpoint it starts from.
    pub from_spp: u64,
    /// Sample count that it aims at.
    pub to_spp: u64,
    /// Model calls.
    pub nfe: u64,
}

/// Stores refined images with what is said of each, and more parts beside them.
///
/// # Errors
/// If the store cannot be written.
pub fn store_refined(
    ctx: &Context<'_>,
    images: RefinedImages,
    note: Option<String>,
    mut parts: Vec<(String, Digest)>,
) -> Result<Artifact, KindError> {
    let mut said = Vec::with_capacity(images.len());
    for (index, (meta, image)) in images.into_iter().enumerate() {
        parts.push((refined_part(index), ctx.put(&image.to_bytes())?));
        said.push(meta);
    }
    parts.push(("meta.json".into(), ctx.put_json(&Refined { images: said, note })?));
    Ok(Artifact::tree(REFINED, parts))
}

/// Refined images, with what is said of each.
pub type RefinedImages = Vec<(RefinedImage, Image)>;

/// The images of a refined artifact, with what it says of each, and why there are none if there are none.
///
/// # Errors
/// If a part is missing, or not what it should be.
pub fn load_refined(ctx: &Context<'_>, artifact: &Artifact) -> Result<(RefinedImages, Option<String>), KindError> {
    let refined: Refined = ctx.json(artifact, "meta.json")?;
    let load = |(index, said)| Ok((said, Image::from_bytes(&ctx.part(artifact, &refined_part(index))?)?));
    let images = refined.images.into_iter().enumerate().map(load).collect::<Result<_, KindError>>()?;
    Ok((images, refined.note))
}

/// Name of a refined image's part.
pub fn refined_part(index: usize) -> String {
    format!("image/{index:04}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_round_trip_and_are_checked() {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            uvs: Some(vec![[0.0, 1.0]; 3]),
            colors: None,
            tangents: None,
        };
        let bytes = mesh.to_bytes().expect("small");
        assert_eq!(Mesh::from_bytes(&bytes).expect("own bytes"), mesh);
        let beyond = Mesh { triangles: vec![[0, 1, 3]], ..mesh.clone() };
        assert!(Mesh::from_bytes(&beyond.to_bytes().expect("small")).is_err());
        let short = Mesh { uvs: Some(vec![[0.0; 2]; 2]), ..mesh };
        assert!(Mesh::from_bytes(&short.to_bytes().expect("small")).is_err());
    }

    #[test]
    fn packed_scenes_round_trip() {
        let image = |v: f32| Image::from_data(2, 2, 3, vec![v; 12]).expect("fits");
        let packed = PackedScene {
            counts: vec![1, 2],
            states: vec![image(1.0), image(0.5)],
            gbuffer: Some(Image::new(2, 2, 6)),
        };
        let bytes = packed.to_bytes().expect("consistent");
        assert_eq!(PackedScene::from_bytes(&bytes).expect("own bytes"), packed);
        let wrong = PackedScene { counts: vec![1], ..packed };
        assert!(wrong.to_bytes().is_err());
    }
}
