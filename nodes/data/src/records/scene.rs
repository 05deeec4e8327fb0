//! Scenes with the recipe that they were drawn by.

use crate::scene::{Recipe, Scene};
use tauflow_contract::{
    Artifact, Context, Digest, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

const SCENE: &str = "scene.json";
const RECIPE: &str = "recipe.json";

/// A scene and its recipe. The meshes and images that the scene names by digest are parts of the artifact, too.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneRecord {
    /// All that decides its image.
    pub scene: Scene,
    /// How it was drawn.
    pub recipe: Recipe,
}

impl SceneRecord {
    /// Name of the scene's file in an exported folder.
    pub const FILE: &'static str = SCENE;
    /// Name of the file beside it that says how it was drawn.
    pub const RECIPE_FILE: &'static str = RECIPE;
    /// Name of the folder beside it that holds its meshes and images by digest.
    pub const BLOB_FOLDER: &'static str = "blob";

    /// The scene alone.
    ///
    /// # Errors
    /// If its blob is missing or damaged.
    pub fn scene(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<Scene, KindError> {
        ctx.json(artifact.artifact(), SCENE)
    }

    /// The recipe alone.
    ///
    /// # Errors
    /// If its blob is missing or damaged.
    pub fn recipe(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<Recipe, KindError> {
        ctx.json(artifact.artifact(), RECIPE)
    }

    /// Content digest of the scene alone: its JSON names its blobs by digest, and so decides the image.
    ///
    /// # Errors
    /// [`KindError::Input`] if the artifact has no scene.
    pub fn scene_digest(artifact: Handle<'_, Self>) -> Result<Digest, KindError> {
        let missing = || KindError::Input(format!("a `{}` has no part `{SCENE}`; make it again", Self::NAME));
        artifact.artifact().part(SCENE).ok_or_else(missing)
    }
}

/// The blobs among the parts or files of these names, stored under the digests that they are named by.
pub(super) fn import_blobs(ctx: &Context<'_>, from: &dyn ReadFiles, needed: &[Digest]) -> Result<(), KindError> {
    for digest in needed {
        let name = format!("{}/{digest}", SceneRecord::BLOB_FOLDER);
        let stored = ctx.put(&from.need(&name)?)?;
        if stored != *digest {
            return Err(KindError::Input(format!("`{name}` holds other bytes, of digest {stored}")));
        }
    }
    Ok(())
}

/// Parts for blobs.
pub(super) fn blob_parts(digests: Vec<Digest>) -> impl Iterator<Item = (String, Digest)> {
    digests.into_iter().map(|digest| (format!("{}/{digest}", SceneRecord::BLOB_FOLDER), digest))
}

/// Writes blobs as files.
pub(super) fn export_blobs(ctx: &Context<'_>, digests: &[Digest], to: &mut dyn WriteFiles) -> Result<(), KindError> {
    digests.iter().try_for_each(|digest| to.put(&format!("{}/{digest}", SceneRecord::BLOB_FOLDER), &ctx.get(digest)?))
}

impl Media for SceneRecord {
    const NAME: &'static str = "tauflow/scene";
    const DOC: &'static str = "A scene: `scene.json`, `recipe.json`, and its meshes and images as `blob/<digest>`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Ok(Self { scene: ctx.json(artifact, SCENE)?, recipe: ctx.json(artifact, RECIPE)? })
    }

    /// Its blobs must be in the store already.
    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let own = [(SCENE.to_owned(), ctx.put_json(&self.scene)?), (RECIPE.to_owned(), ctx.put_json(&self.recipe)?)];
        Ok(Stored::tree(own.into_iter().chain(blob_parts(self.scene.blobs()))))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let record = Self::load(ctx, artifact)?;
        to.put(SCENE, &pretty_json(&record.scene)?)?;
        to.put(RECIPE, &pretty_json(&record.recipe)?)?;
        export_blobs(ctx, &record.scene.blobs(), to)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let scene: Scene = parse_json(SCENE, &from.need(SCENE)?)?;
        let recipe = parse_json(RECIPE, &from.need(RECIPE)?)?;
        import_blobs(ctx, from, &scene.blobs())?;
        Self { scene, recipe }.store(ctx)
    }
}
