//! Nested SPP ladders: I_n is the mean of samples 0..n of each pixel.

use super::files::{Described, Values, count_name, counts_of, put_image, read_image};
use crate::{
    Image,
    rungs::{IntegratorKind, SamplerKind},
};
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Artifact, Context, Digest, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

const META: &str = "meta.json";
const VARIANCE: &str = "variance";

/// The metadata of a ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LadderMeta {
    /// Sample counts, increasing.
    pub counts: Vec<u64>,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Contributions that were rejected as non-finite, over all samples.
    pub rejected: u64,
    /// Mean number of path segments, over all samples of the last rung.
    pub mean_path_length: f64,
    /// How its samples were drawn.
    #[serde(default = "SamplerKind::unsaid", skip_serializing_if = "SamplerKind::is_independent")]
    pub sampler: SamplerKind,
    /// What estimated radiance.
    #[serde(default = "IntegratorKind::unsaid", skip_serializing_if = "IntegratorKind::is_path")]
    pub integrator: IntegratorKind,
    /// Root mean square of the relative errors that the last rung is to be expected to have, as samples of other
    /// streams say that decided where it ends; none if nothing had to be decided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimated_error: Option<f64>,
}

/// One rung: a sample count and the mean of that many samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// Samples per pixel.
    pub spp: u64,
    /// Linear radiance, [H, W, 3].
    pub image: Image,
}

/// A ladder in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Ladder {
    /// Its metadata.
    pub meta: LadderMeta,
    /// Its rungs, increasing.
    pub rungs: Vec<Rung>,
    /// Per-pixel sample variance of single samples, from the last rung's samples.
    pub variance: Image,
}

fn rung_part(spp: u64) -> String {
    format!("rung/{spp:08}")
}

impl Ladder {
    /// The metadata of a ladder.
    ///
    /// # Errors
    /// If the blob is missing or damaged.
    pub fn meta(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<LadderMeta, KindError> {
        ctx.json(artifact.artifact(), META)
    }

    /// One rung.
    ///
    /// # Errors
    /// If the ladder has no such rung, or a blob is missing or damaged.
    pub fn rung(ctx: &Context<'_>, artifact: Handle<'_, Self>, spp: u64) -> Result<Image, KindError> {
        Ok(Image::from_bytes(&ctx.part(artifact.artifact(), &rung_part(spp))?)?)
    }

    /// The variance of samples.
    ///
    /// # Errors
    /// If a blob is missing or damaged.
    pub fn variance(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<Image, KindError> {
        Ok(Image::from_bytes(&ctx.part(artifact.artifact(), VARIANCE)?)?)
    }

    /// Content digest of the variance of samples: the same only for the same samples.
    pub fn variance_digest(artifact: Handle<'_, Self>) -> Option<Digest> {
        artifact.artifact().part(VARIANCE)
    }

    /// A ladder of rungs that are in the store already, by sample count.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn of_stored(
        ctx: &Context<'_>,
        meta: &LadderMeta,
        variance: &Image,
        rungs: impl IntoIterator<Item = (u64, Digest)>,
    ) -> Result<Stored<Self>, KindError> {
        let own = [(META.to_owned(), ctx.put_json(meta)?), (VARIANCE.to_owned(), ctx.put(&variance.to_bytes())?)];
        Ok(Stored::tree(own.into_iter().chain(rungs.into_iter().map(|(spp, digest)| (rung_part(spp), digest)))))
    }
}

impl Media for Ladder {
    const NAME: &'static str = "tauflow/ladder";
    const DOC: &'static str = "Rungs and the variance of samples in raw radiance, as EXR and PNG, and `meta.json`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let handle = Handle::new(artifact)?;
        let meta = Self::meta(ctx, handle)?;
        let rung = |spp: &u64| Ok(Rung { spp: *spp, image: Self::rung(ctx, handle, *spp)? });
        let rungs = meta.counts.iter().map(rung).collect::<Result<_, KindError>>()?;
        let variance = Self::variance(ctx, handle)?;
        Ok(Self { meta, rungs, variance })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let rung = |rung: &Rung| Ok((rung.spp, ctx.put(&rung.image.to_bytes())?));
        let rungs = self.rungs.iter().map(rung).collect::<Result<Vec<_>, KindError>>()?;
        Self::of_stored(ctx, &self.meta, &self.variance, rungs)
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let ladder = Self::load(ctx, artifact)?;
        let values = Some(Values::of_raw(to));
        to.put(META, &pretty_json(&Described { meta: ladder.meta.clone(), values })?)?;
        for rung in &ladder.rungs {
            put_image(to, &count_name(rung.spp), &rung.image)?;
        }
        to.put(&format!("{VARIANCE}.exr"), &crate::image_io::exr_bytes(&[("", &ladder.variance)])?)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let meta: LadderMeta = parse_json(META, &from.need(META)?)?;
        let counts = counts_of(from)?;
        if counts != meta.counts {
            return Err(KindError::Input(format!(
                "`{META}` lists the rungs {:?}, and there are images of {counts:?}",
                meta.counts
            )));
        }
        let rung = |spp: u64| Ok(Rung { spp, image: read_image(from, &format!("{}.exr", count_name(spp)))? });
        let rungs = counts.into_iter().map(rung).collect::<Result<Vec<_>, KindError>>()?;
        let variance = read_image(from, &format!("{VARIANCE}.exr"))?;
        let fits = |image: &Image| (image.width(), image.height()) == (meta.width, meta.height);
        if !rungs.iter().all(|rung| fits(&rung.image)) || !fits(&variance) {
            let (width, height) = (meta.width, meta.height);
            return Err(KindError::Input(format!("an image is not of the {width} x {height} pixels of `{META}`")));
        }
        Self { meta, rungs, variance }.store(ctx)
    }
}
