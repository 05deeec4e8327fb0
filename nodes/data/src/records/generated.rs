//! Samples that frozen generative backbones made, with and without an adapter.

use super::files::read_image;
use crate::{
    DataError, Image,
    image_io::{encode_png, exr_bytes},
    methods::MethodName,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt;
use tauflow_contract::{
    Artifact, Context, Handle, KindError, Media, ReadFiles, Stored, WriteFiles, parse_json, pretty_json,
};

const META: &str = "meta.json";

/// What sort of generative model a backbone is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// A denoising diffusion model that predicts the noise epsilon.
    Ddpm,
    /// A model of the velocity of a rectified flow.
    RectifiedFlow,
}

impl Family {
    /// Its name in records and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ddpm => "ddpm",
            Self::RectifiedFlow => "rectified_flow",
        }
    }

    /// Its name in text for people.
    pub fn label(self) -> &'static str {
        match self {
            Self::Ddpm => "DDPM",
            Self::RectifiedFlow => "RF",
        }
    }
}

/// One of the ways in which a sample is generated. All variants of a sample share its noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// The backbone alone.
    Frozen,
    /// With the adapter that was trained on rendering endpoints.
    Adapted,
    /// Control: the trained adapter with injection strength eta = 0.
    EtaZero,
    /// Control: the adapter before training, whose last layer is zero.
    UntrainedAdapter,
    /// Control: an adapter that was trained on residuals shuffled between scenes.
    ShuffledResiduals,
    /// Control: an adapter that was trained on Gaussian residuals of the same variance.
    GaussianResiduals,
}

impl Variant {
    /// All of them: frozen, adapted, and then the controls.
    pub const ALL: [Self; 6] = [
        Self::Frozen,
        Self::Adapted,
        Self::EtaZero,
        Self::UntrainedAdapter,
        Self::ShuffledResiduals,
        Self::GaussianResiduals,
    ];

    /// Its name in records, tables and names of files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Adapted => "adapted",
            Self::EtaZero => "eta_zero",
            Self::UntrainedAdapter => "untrained_adapter",
            Self::ShuffledResiduals => "shuffled_residuals",
            Self::GaussianResiduals => "gaussian_residuals",
        }
    }

    /// Its name in text for people.
    pub fn label(self) -> &'static str {
        match self {
            Self::Frozen => "frozen",
            Self::Adapted => "adapted",
            Self::EtaZero => "eta = 0",
            Self::UntrainedAdapter => "untrained adapter",
            Self::ShuffledResiduals => "shuffled residuals",
            Self::GaussianResiduals => "Gaussian residuals",
        }
    }

    /// Whether a gain of the adapted variant has to hold over this one too.
    pub fn is_control(self) -> bool {
        !matches!(self, Self::Frozen | Self::Adapted)
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An image of a sampler's trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// How many sampler steps were done, from 0 for the initial noise to the number of steps.
    pub step: u64,
    /// The state at that time in display values, clipped to [0, 1].
    pub image: Image,
}

/// One variant of a sample.
#[derive(Clone, Debug, PartialEq)]
pub struct GeneratedVariant {
    /// Which one.
    pub variant: Variant,
    /// The final image: RGB display values in [0, 1].
    pub image: Image,
    /// For each sampler step, the mean square over pixels and channels of eta g du, the injected correction. It is 0
    /// where nothing was injected.
    ///
    /// # Units
    /// Squared units of the coordinate that the adapter corrects: velocity (RF), or residual of the image (DDPM), each
    /// in the image range of its backbone.
    pub energy: Vec<f64>,
    /// Frames of the trajectory, by step; none where they were not kept.
    pub frames: Vec<Snapshot>,
}

/// One sample of one backbone, in its variants.
#[derive(Clone, Debug, PartialEq)]
pub struct Generated {
    /// The backbone's name, such as `ddpm_church`.
    pub backbone: MethodName,
    /// What sort of model it is.
    pub family: Family,
    /// The sample's number, which selects its noise.
    pub sample: u64,
    /// Number of sampler steps.
    pub steps: u64,
    /// The variants in the order of [`Variant::ALL`], each at most once. [`Variant::Frozen`] is always there.
    pub variants: Vec<GeneratedVariant>,
}

/// The metadata of the artifact.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GeneratedMeta {
    /// The backbone's name.
    pub backbone: MethodName,
    /// What sort of model it is.
    pub family: Family,
    /// The sample's number.
    pub sample: u64,
    /// Number of sampler steps.
    pub steps: u64,
    /// One for each variant, in order.
    pub variants: Vec<GeneratedVariantMeta>,
}

/// What the artifact says of a variant beside its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GeneratedVariantMeta {
    /// Which one.
    pub variant: Variant,
    /// Mean square of the injected correction in each sampler step.
    pub energy: Vec<f64>,
    /// The steps of its frames.
    pub frames: Vec<u64>,
}

/// Name of the final image's part, and of its file without the ending.
fn image_name(variant: Variant) -> String {
    variant.name().to_owned()
}

/// Name of a frame's part, and of its file without the ending.
fn frame_name(variant: Variant, step: u64) -> String {
    format!("{variant}-step-{step:04}")
}

impl Generated {
    /// One of its variants.
    pub fn variant(&self, variant: Variant) -> Option<&GeneratedVariant> {
        self.variants.iter().find(|its| its.variant == variant)
    }

    /// What is said beside the pixels, of an artifact that is not loaded as a whole.
    ///
    /// # Errors
    /// If the blob is missing or damaged.
    pub fn meta(ctx: &Context<'_>, artifact: Handle<'_, Self>) -> Result<GeneratedMeta, KindError> {
        ctx.json(artifact.artifact(), META)
    }

    /// The final image of a variant, of an artifact that is not loaded as a whole.
    ///
    /// # Errors
    /// If the artifact has no such variant, or its blob is missing or damaged.
    pub fn image(ctx: &Context<'_>, artifact: Handle<'_, Self>, variant: Variant) -> Result<Image, KindError> {
        Ok(Image::from_bytes(&ctx.part(artifact.artifact(), &image_name(variant))?)?)
    }

    /// Refuses what no sampler makes.
    fn check(&self) -> Result<(), DataError> {
        let bad = |what: String| {
            Err(DataError::Format(format!("sample {} of backbone `{}`: {what}", self.sample, self.backbone.as_str())))
        };
        let Some(frozen) = self.variants.first().filter(|first| first.variant == Variant::Frozen) else {
            return bad("its first variant must be `frozen`, which the others are compared with".into());
        };
        for pair in self.variants.windows(2) {
            if pair[0].variant >= pair[1].variant {
                let [first, second] = [pair[0].variant, pair[1].variant];
                return bad(format!(
                    "variant `{second}` follows `{first}`; list each variant once: frozen, adapted, then the controls"
                ));
            }
        }
        for GeneratedVariant { variant, image, energy, frames } in &self.variants {
            let images = frames.iter().map(|frame| &frame.image).chain([image]);
            for image in images {
                if image.channels() != 3 || !image.same_shape(&frozen.image) || image.data().is_empty() {
                    return bad(format!(
                        "variant `{variant}` has an image of {} x {} pixels with {} values, expected {} x {} with 3",
                        image.width(),
                        image.height(),
                        image.channels(),
                        frozen.image.width(),
                        frozen.image.height()
                    ));
                }
                let outside = image.data().iter().filter(|v| !(0.0..=1.0).contains(*v)).count();
                if outside > 0 {
                    return bad(format!(
                        "variant `{variant}` has {outside} values outside [0, 1]; clip images to display values"
                    ));
                }
            }
            if energy.len() as u64 != self.steps {
                return bad(format!(
                    "variant `{variant}` has energies of {} steps, but the sampler makes {}",
                    energy.len(),
                    self.steps
                ));
            }
            if energy.iter().any(|e| !(e.is_finite() && *e >= 0.0)) {
                return bad(format!("variant `{variant}` has an injected energy that is negative or not finite"));
            }
            let ordered = frames.windows(2).all(|pair| pair[0].step < pair[1].step);
            if !ordered || frames.last().is_some_and(|frame| frame.step > self.steps) {
                let steps: Vec<u64> = frames.iter().map(|frame| frame.step).collect();
                return bad(format!(
                    "variant `{variant}` has frames of steps {steps:?}; they must increase and end by step {}",
                    self.steps
                ));
            }
        }
        Ok(())
    }

    fn to_meta(&self) -> GeneratedMeta {
        let said = |its: &GeneratedVariant| GeneratedVariantMeta {
            variant: its.variant,
            energy: its.energy.clone(),
            frames: its.frames.iter().map(|frame| frame.step).collect(),
        };
        GeneratedMeta {
            backbone: self.backbone.clone(),
            family: self.family,
            sample: self.sample,
            steps: self.steps,
            variants: self.variants.iter().map(said).collect(),
        }
    }

    /// Every image, by the name of its part and file.
    fn images(&self) -> impl Iterator<Item = (String, &Image)> {
        self.variants.iter().flat_map(|its| {
            let frames = its.frames.iter().map(|frame| (frame_name(its.variant, frame.step), &frame.image));
            [(image_name(its.variant), &its.image)].into_iter().chain(frames)
        })
    }

    /// The record that a description and images by name make.
    fn from_parts(
        meta: GeneratedMeta,
        mut image: impl FnMut(&str) -> Result<Image, KindError>,
    ) -> Result<Self, KindError> {
        let GeneratedMeta { backbone, family, sample, steps, variants } = meta;
        let variants = variants
            .into_iter()
            .map(|GeneratedVariantMeta { variant, energy, frames }| {
                let frame = |step| Ok(Snapshot { step, image: image(&frame_name(variant, step))? });
                let frames = frames.into_iter().map(frame).collect::<Result<_, KindError>>()?;
                Ok(GeneratedVariant { variant, image: image(&image_name(variant))?, energy, frames })
            })
            .collect::<Result<_, KindError>>()?;
        let generated = Self { backbone, family, sample, steps, variants };
        generated.check()?;
        Ok(generated)
    }
}

impl Media for Generated {
    const NAME: &'static str = "tauflow/generated";
    const DOC: &'static str =
        "One sample of a generative backbone: each variant and its frames as EXR and PNG; `meta.json` lists them.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let image = |name: &str| Ok(Image::from_bytes(&ctx.part(artifact, name)?)?);
        Self::from_parts(ctx.json(artifact, META)?, image)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        self.check()?;
        let part = |(name, image): (String, &Image)| Ok((name, ctx.put(&image.to_small_bytes())?));
        let mut parts = self.images().map(part).collect::<Result<Vec<_>, KindError>>()?;
        parts.push((META.into(), ctx.put_json(&self.to_meta())?));
        Ok(Stored::tree(parts))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let generated = Self::load(ctx, artifact)?;
        to.put(META, &pretty_json(&generated.to_meta())?)?;
        generated.images().try_for_each(|(name, image)| {
            to.put(&format!("{name}.exr"), &exr_bytes(&[("", image)])?)?;
            // Display values already: no display transform.
            to.put(&format!("{name}.png"), &encode_png(image)?)
        })
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let image = |name: &str| read_image(from, &format!("{name}.exr"));
        Self::from_parts(parse_json(META, &from.need(META)?)?, image)?.store(ctx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{FileTree, MemoryBlobs, Silent};

    fn grey(value: f32) -> Image {
        Image::from_data(2, 2, 3, vec![value; 12]).expect("fits")
    }

    fn plain(variant: Variant, value: f32) -> GeneratedVariant {
        GeneratedVariant { variant, image: grey(value), energy: vec![0.0; 4], frames: Vec::new() }
    }

    fn sample() -> Generated {
        let frames = vec![Snapshot { step: 0, image: grey(0.25) }, Snapshot { step: 4, image: grey(0.75) }];
        Generated {
            backbone: MethodName::new("rf_church").expect("a name"),
            family: Family::RectifiedFlow,
            sample: 7,
            steps: 4,
            variants: vec![
                plain(Variant::Frozen, 0.5),
                GeneratedVariant { energy: vec![0.0, 0.0, 0.1, 0.2], frames, ..plain(Variant::Adapted, 0.7) },
                plain(Variant::EtaZero, 0.5),
            ],
        }
    }

    #[test]
    fn samples_are_read_in_part() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let stored = sample().store(&ctx).expect("in memory");
        let meta = Generated::meta(&ctx, stored.handle()).expect("whole");
        assert_eq!((meta.steps, meta.variants[1].frames.as_slice()), (4, &[0, 4][..]));
        let image = |variant| Generated::image(&ctx, stored.handle(), variant);
        assert_eq!(image(Variant::Adapted).expect("there"), grey(0.7));
        let gone = image(Variant::GaussianResiduals).expect_err("not there").to_string();
        assert!(gone.contains("`gaussian_residuals`"), "{gone}");
        // Display values become bytes without the display transform.
        let mut files = FileTree::new();
        Generated::export(&ctx, stored.artifact(), &mut files).expect("whole");
        assert_eq!(files["adapted.png"], encode_png(&grey(0.7)).expect("RGB"));
        assert!(files.contains_key("adapted-step-0004.exr"));
    }

    #[test]
    fn what_no_sampler_makes_is_refused() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let refused = |change: fn(&mut Generated), part: &str| {
            let mut wrong = sample();
            change(&mut wrong);
            let told = wrong.store(&ctx).map(Stored::into_artifact).expect_err(part).to_string();
            assert!(told.contains("sample 7 of backbone `rf_church`") && told.contains(part), "{told}");
        };
        refused(|g| drop(g.variants.remove(0)), "must be `frozen`");
        refused(|g| g.variants.swap(1, 2), "`adapted` follows `eta_zero`");
        refused(|g| g.variants[2].variant = Variant::Adapted, "`adapted` follows `adapted`");
        refused(|g| g.variants[1].image = Image::new(3, 2, 3), "3 x 2 pixels with 3 values, expected 2 x 2 with 3");
        refused(|g| g.variants[1].image = grey(1.5), "12 values outside [0, 1]");
        refused(|g| g.variants[1].frames[0].image = grey(f32::NAN), "12 values outside [0, 1]");
        refused(|g| g.variants[2].energy.truncate(3), "energies of 3 steps, but the sampler makes 4");
        refused(|g| g.variants[1].energy[2] = -1.0, "negative or not finite");
        refused(|g| g.variants[1].frames[1].step = 5, "[0, 5]; they must increase and end by step 4");
        refused(|g| g.variants[1].frames[1].step = 0, "[0, 0]");
    }

    #[test]
    fn names_in_records_are_those_of_the_types() {
        for variant in Variant::ALL {
            assert_eq!(serde_json::to_value(variant).expect("plain"), variant.name());
        }
        for family in [Family::Ddpm, Family::RectifiedFlow] {
            assert_eq!(serde_json::to_value(family).expect("plain"), family.name());
        }
        assert!(Variant::ALL.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(Variant::ALL.map(Variant::is_control), [false, false, true, true, true, true]);
    }
}
