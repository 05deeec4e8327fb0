//! Nested SPP ladders: I_n is the mean of samples 0..n of each pixel.

use crate::{DataError, Image, TensorFile};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{Artifact, Context, KindError};

/// Media type of a ladder: `meta.json`, `rung/<n, 8 digits>` for each rung (linear radiance, [H, W, 3]), and `variance`
/// (per-pixel sample variance of single samples, unbiased, [H, W, 3]).
pub const LADDER: &str = "tauflow/ladder";

/// Which rungs a ladder has: `{dyadic: 512}` for 1, 2, 4 ... 512, or an increasing list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum RungCounts {
    /// Powers of two from 1 to this one.
    Dyadic {
        /// The last rung, a power of two.
        dyadic: u64,
    },
    /// These, in increasing order.
    List(Vec<u64>),
}

impl RungCounts {
    /// The sample counts, increasing.
    ///
    /// # Errors
    /// If they are not increasing from at least 1, or `dyadic` is no power of two.
    pub fn counts(&self) -> Result<Vec<u64>, DataError> {
        match self {
            Self::Dyadic { dyadic } if dyadic.is_power_of_two() => {
                Ok((0..=dyadic.trailing_zeros()).map(|i| 1u64 << i).collect())
            }
            Self::Dyadic { dyadic } => {
                Err(DataError::Format(format!("`dyadic: {dyadic}` is no power of two; use for example 256 or 512")))
            }
            Self::List(list) => {
                if list.is_empty() || list[0] == 0 || list.windows(2).any(|w| w[1] <= w[0]) {
                    return Err(DataError::Format(
                        "rungs must be a list of increasing sample counts from at least 1".into(),
                    ));
                }
                Ok(list.clone())
            }
        }
    }
}

/// What a ladder says of itself.
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
    #[serde(default, skip_serializing_if = "SamplerKind::is_independent")]
    pub sampler: SamplerKind,
}

/// How samples are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum SamplerKind {
    /// Independent and identically distributed: what variance time rests on.
    #[default]
    Independent,
    /// Owen-scrambled Sobol' points: less error after the same number of samples, which depend on each other.
    Sobol,
}

impl SamplerKind {
    /// Whether single samples say how far the mean of many is off.
    pub fn is_independent(&self) -> bool {
        *self == Self::Independent
    }
}

/// One rung: a sample count and the mean of that many samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// Samples a pixel.
    pub spp: u64,
    /// Linear radiance, [H, W, 3].
    pub image: Image,
}

/// A ladder in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Ladder {
    /// What it says of itself.
    pub meta: LadderMeta,
    /// Its rungs, increasing.
    pub rungs: Vec<Rung>,
    /// Per-pixel sample variance of single samples, from the last rung's samples.
    pub variance: Image,
}

/// Name of a rung's part.
pub fn rung_part(spp: u64) -> String {
    format!("rung/{spp:08}")
}

impl Ladder {
    /// Stores the ladder.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn store(&self, ctx: &Context<'_>) -> Result<Artifact, KindError> {
        let mut parts = vec![
            ("meta.json".to_owned(), ctx.put_json(&self.meta)?),
            ("variance".to_owned(), ctx.put(&self.variance.to_bytes())?),
        ];
        for rung in &self.rungs {
            parts.push((rung_part(rung.spp), ctx.put(&rung.image.to_bytes())?));
        }
        Ok(Artifact::tree(LADDER, parts))
    }

    /// Loads what a ladder says of itself.
    ///
    /// # Errors
    /// If the artifact is no ladder.
    pub fn load_meta(ctx: &Context<'_>, artifact: &Artifact) -> Result<LadderMeta, KindError> {
        ctx.json(artifact, "meta.json")
    }

    /// Loads one rung.
    ///
    /// # Errors
    /// If the ladder has no such rung, or a blob is missing or damaged.
    pub fn load_rung(ctx: &Context<'_>, artifact: &Artifact, spp: u64) -> Result<Image, KindError> {
        let bytes = ctx.part(artifact, &rung_part(spp))?;
        Ok(Image::from_bytes(&bytes)?)
    }

    /// Loads the whole ladder.
    ///
    /// # Errors
    /// As [`Ladder::load_rung`].
    pub fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let meta = Self::load_meta(ctx, artifact)?;
        let mut rungs = Vec::with_capacity(meta.counts.len());
        for spp in &meta.counts {
            rungs.push(Rung { spp: *spp, image: Self::load_rung(ctx, artifact, *spp)? });
        }
        let variance = Image::from_bytes(&ctx.part(artifact, "variance")?)?;
        Ok(Self { meta, rungs, variance })
    }
}

/// Media type of a G-buffer: one safetensors blob with `albedo` and `normal`, [H, W, 3] each.
pub const GBUFFER: &str = "tauflow/gbuffer";

/// First-hit features, averaged over samples of each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct GBuffer {
    /// Albedo in [0, 1].
    pub albedo: Image,
    /// Shading normal in the camera's frame (to the right, up, towards the camera), in [-1, 1]; shorter than 1 where samples differ, 0 where nothing is hit.
    pub normal: Image,
}

impl GBuffer {
    /// Stores it.
    ///
    /// # Errors
    /// If the store cannot be written.
    pub fn store(&self, ctx: &Context<'_>) -> Result<Artifact, KindError> {
        let file = TensorFile::default().with_image("albedo", &self.albedo).with_image("normal", &self.normal);
        Ok(Artifact::blob(GBUFFER, ctx.put(&file.to_bytes()?)?))
    }

    /// Loads it.
    ///
    /// # Errors
    /// If a blob is missing or damaged.
    pub fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let file = TensorFile::from_bytes(&ctx.part(artifact, "")?)?;
        Ok(Self { albedo: file.image("albedo")?, normal: file.image("normal")? })
    }
}
