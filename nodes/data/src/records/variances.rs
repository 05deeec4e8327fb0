//! Variances of samples at each rung of a ladder.

use super::files::{Values, count_name, counts_of, read_image};
use crate::{DataError, Image, image_io::exr_bytes};
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Artifact, Context, Digest, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

const META: &str = "meta.json";

/// For each rung of n samples, the variance of single samples as estimated from these n samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Variances {
    /// Sample counts and variances [H, W, 3] in squares of raw radiance, increasing. The variance of a rung is that of
    /// a sample divided by the count.
    pub rungs: Vec<(u64, Image)>,
}

/// What `meta.json` of an exported folder says.
#[derive(Serialize, Deserialize)]
struct Meta {
    counts: Vec<u64>,
    /// Whether images hold variances of single samples.
    per_sample: bool,
    #[serde(flatten)]
    values: Option<Values>,
}

fn part(spp: u64) -> String {
    format!("variance/{spp:08}")
}

impl Variances {
    /// The variance of single samples from the first `spp` of them.
    ///
    /// # Errors
    /// If there is no such rung, or a blob is missing or damaged.
    pub fn of(ctx: &Context<'_>, artifact: Handle<'_, Self>, spp: u64) -> Result<Image, KindError> {
        Ok(Image::from_bytes(&ctx.part(artifact.artifact(), &part(spp))?)?)
    }

    /// Variances that are in the store already, by sample count.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn of_stored(ctx: &Context<'_>, rungs: &[(u64, Digest)]) -> Result<Stored<Self>, KindError> {
        let counts: Vec<u64> = rungs.iter().map(|(spp, _)| *spp).collect();
        let meta = (META.to_owned(), ctx.put_json(&counts)?);
        Ok(Stored::tree(std::iter::once(meta).chain(rungs.iter().map(|(spp, digest)| (part(*spp), *digest)))))
    }
}

impl Media for Variances {
    const NAME: &'static str = "tauflow/variances";
    const DOC: &'static str = "Variances of single samples in raw radiance by sample count, as EXR, and `meta.json`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let handle = Handle::new(artifact)?;
        let counts: Vec<u64> = ctx.json(artifact, META)?;
        let rung = |spp: &u64| Ok((*spp, Self::of(ctx, handle, *spp)?));
        Ok(Self { rungs: counts.iter().map(rung).collect::<Result<_, KindError>>()? })
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let first = self.rungs.first().ok_or_else(|| DataError::Format("variances of no rung".into()))?;
        if self.rungs.iter().any(|(_, image)| !image.same_shape(&first.1)) {
            return Err(DataError::Format("the variances of rungs differ in size".into()).into());
        }
        let rung = |(spp, image): &(u64, Image)| Ok((*spp, ctx.put(&image.to_bytes())?));
        let rungs = self.rungs.iter().map(rung).collect::<Result<Vec<_>, KindError>>()?;
        Self::of_stored(ctx, &rungs)
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let own = Self::load(ctx, artifact)?;
        let counts = own.rungs.iter().map(|(spp, _)| *spp).collect();
        to.put(META, &pretty_json(&Meta { counts, per_sample: true, values: Some(Values::of_raw(to)) })?)?;
        own.rungs
            .iter()
            .try_for_each(|(spp, image)| to.put(&format!("{}.exr", count_name(*spp)), &exr_bytes(&[("", image)])?))
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let meta: Meta = parse_json(META, &from.need(META)?)?;
        let counts = counts_of(from)?;
        if counts != meta.counts || !meta.per_sample {
            return Err(KindError::Input(format!(
                "`{META}` must list the counts of the images, {counts:?}, and say `per_sample: true`; it has {:?} and \
                 {}",
                meta.counts, meta.per_sample
            )));
        }
        let rung = |spp: u64| Ok((spp, read_image(from, &format!("{}.exr", count_name(spp)))?));
        Self { rungs: counts.into_iter().map(rung).collect::<Result<Vec<_>, KindError>>()? }.store(ctx)
    }
}
