//! Images that a method made of an endpoint, or of a scene.

use super::files::{Described, Values, put_image, read_image};
use crate::{DataError, Image, SamplerKind, methods::MethodName};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use tauflow_contract::{
    Artifact, Context, Digest, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

const META: &str = "meta.json";

/// The metadata of a refined image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedImage {
    /// Which method made it, e.g. `mc_noise`.
    pub method: String,
    /// Sample count of the endpoint it starts from.
    pub from_spp: u64,
    /// Sample count that it aims at.
    pub to_spp: u64,
    /// Network calls.
    pub nfe: u64,
}

impl RefinedImage {
    /// Name, without its ending, of its file when it is exported.
    ///
    /// # Errors
    /// If the method's name cannot be part of a file name.
    fn file(&self) -> Result<String, DataError> {
        MethodName::new(self.method.as_str()).map_err(|error| DataError::Format(error.to_string()))?;
        Ok(format!("{}-{}-to-{}-nfe-{}", self.method, self.from_spp, self.to_spp, self.nfe))
    }
}

/// Refined images, with what is said of each.
pub type RefinedImages = Vec<(RefinedImage, Image)>;

/// Images of exposed linear radiance, in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Refined {
    /// The images.
    pub images: RefinedImages,
    /// Why there are none, for people; such as a library that is missing.
    pub note: Option<String>,
    /// How the samples were drawn of the endpoints that they were made from.
    pub sampler: SamplerKind,
}

/// The metadata of the artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedMeta {
    /// One for each image, in order.
    pub images: Vec<RefinedImage>,
    /// Why there are none, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    /// How the samples were drawn of the endpoints that they were made from.
    #[serde(default = "SamplerKind::unsaid", skip_serializing_if = "SamplerKind::is_independent")]
    pub sampler: SamplerKind,
}

fn part(index: usize) -> String {
    format!("image/{index:04}")
}

impl Refined {
    /// The metadata, without pixels.
    ///
    /// # Errors
    /// If the blob is missing or damaged.
    pub fn meta(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<RefinedMeta, KindError> {
        ctx.json(artifact.artifact(), META)
    }

    /// One image.
    ///
    /// # Errors
    /// If there is none of this number, or its blob is missing or damaged.
    pub fn image(ctx: &Context<'_>, artifact: Handle<'_, Self>, index: usize) -> Result<Image, KindError> {
        Ok(Image::from_bytes(&ctx.part(artifact.artifact(), &part(index))?)?)
    }

    pub(super) fn load_tree(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let meta: RefinedMeta = ctx.json(artifact, META)?;
        let load = |(index, said)| Ok((said, Image::from_bytes(&ctx.part(artifact, &part(index))?)?));
        let images = meta.images.into_iter().enumerate().map(load).collect::<Result<_, KindError>>()?;
        Ok(Self { images, note: meta.note, sampler: meta.sampler })
    }

    pub(super) fn parts(
        ctx: &Context<'_>,
        images: &RefinedImages,
        (note, sampler): (Option<&str>, SamplerKind),
    ) -> Result<Vec<(String, Digest)>, KindError> {
        let mut parts = Vec::with_capacity(images.len() + 1);
        let mut files = BTreeSet::new();
        for (index, (said, image)) in images.iter().enumerate() {
            let file = said.file()?;
            if !files.insert(file.clone()) {
                return Err(KindError::Input(format!(
                    "two images have the name `{file}`; use different sample counts"
                )));
            }
            parts.push((part(index), ctx.put(&image.to_bytes())?));
        }
        let said = images.iter().map(|(said, _)| said.clone()).collect();
        parts.push((META.into(), ctx.put_json(&RefinedMeta { images: said, note: note.map(str::to_owned), sampler })?));
        Ok(parts)
    }

    pub(super) fn write(&self, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let values = Values::of_exposed(to)?;
        let said = self.images.iter().map(|(said, _)| said.clone()).collect();
        let meta = RefinedMeta { images: said, note: self.note.clone(), sampler: self.sampler };
        to.put(META, &pretty_json(&Described { meta, values: Some(values) })?)?;
        self.images.iter().try_for_each(|(said, image)| put_image(to, &said.file()?, &values.written(image)))
    }

    pub(super) fn read(from: &dyn ReadFiles) -> Result<Self, KindError> {
        let Described::<RefinedMeta> { meta, values } = parse_json(META, &from.need(META)?)?;
        let read = |said: RefinedImage| {
            let image = read_image(from, &format!("{}.exr", said.file()?))?;
            Ok((said, values.map_or_else(|| Ok(image.clone()), |values| values.exposed(image.clone()))?))
        };
        let images = meta.images.into_iter().map(read).collect::<Result<_, KindError>>()?;
        Ok(Self { images, note: meta.note, sampler: meta.sampler })
    }
}

impl Media for Refined {
    const NAME: &'static str = "tauflow/refined";
    const DOC: &'static str = "Images as EXR and PNG, named by method and counts; `meta.json` lists them.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        Self::load_tree(ctx, artifact)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        Ok(Stored::tree(Self::parts(ctx, &self.images, (self.note.as_deref(), self.sampler))?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        Self::load(ctx, artifact)?.write(to)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        Self::read(from)?.store(ctx)
    }
}
