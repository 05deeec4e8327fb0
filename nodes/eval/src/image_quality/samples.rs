//! The scores of one backbone's samples, and their intervals.
//!
//! Every draw of the bootstrap takes samples with replacement, all variants of a sample together, and held-out renders
//! with replacement. So differences between variants are paired, those of scores of whole sets too.

use super::{
    clean::{Clean, Numbers, Tools},
    distances::{Counts, Mmd, Slices},
    features::FeatureSet,
    niqe::{Law, Moments, stands_alone},
    pictures::{Backbone, Size, at_size},
};
use crate::bootstrap::Resampled;
use rayon::prelude::*;
use std::collections::BTreeMap;
use tauflow_contract::{Context, KindError};
use tauflow_data::{records::Variant, rng::Stream};

/// Squared MMD.
pub(crate) const MMD: &str = "mmd";
/// Sliced Wasserstein distance.
pub(crate) const SWD: &str = "swd";
/// NIQE.
pub(crate) const NIQE: &str = "niqe";

/// The samples of one variant as numbers.
struct Set {
    numbers: Vec<Numbers>,
    /// Largest difference of a value from the frozen variant.
    change: f64,
}

/// A score of a set of samples.
enum Column<'a> {
    Mmd(Mmd<'a>),
    Swd(Slices),
    /// NIQE of all patches together.
    Pooled(Vec<Moments>, &'a Law),
    /// The mean of the scores of the samples.
    Each(Vec<f64>),
}

/// What one backbone's samples say.
pub(crate) struct Samples {
    /// Names of the scores, in the order of columns.
    pub(crate) scores: Vec<String>,
    /// The scores of each variant, one after the other, and those of every draw; at last the squared MMD of the
    /// Gaussian images and of the frozen samples that are compared with them.
    pub(crate) resampled: Resampled,
    /// Largest difference from the frozen variant, by variant.
    pub(crate) changes: Vec<f64>,
    /// Scores of single images, by name: by variant, then sample.
    pub(crate) each: BTreeMap<String, Vec<Vec<f64>>>,
    /// What was left out, and why.
    pub(crate) notes: Vec<String>,
}

impl Samples {
    /// Place of a score of a variant among the figures.
    pub(crate) fn at(&self, variant: usize, score: usize) -> usize {
        variant * self.scores.len() + score
    }

    /// Places of the squared MMD of the Gaussian images, and of the frozen samples that are compared with them.
    pub(crate) fn gaussian(&self) -> [usize; 2] {
        let first = self.changes.len() * self.scores.len();
        [first, first + 1]
    }
}

/// Scores of single images that were made elsewhere: by name, then variant and sample.
pub(crate) type Given = BTreeMap<String, Vec<Vec<f64>>>;

/// How to resample.
#[derive(Clone, Copy)]
pub(crate) struct Bootstrap {
    pub(crate) resamples: u64,
    pub(crate) seed: u64,
}

/// A backbone's samples, what else is known of them, and the size at which they are scored.
pub(crate) struct Scored<'a> {
    /// The samples.
    pub(crate) backbone: &'a Backbone<'a>,
    /// Frozen samples to compare with the Gaussian images, if these are not those of `backbone`.
    pub(crate) frozen: Option<&'a Backbone<'a>>,
    /// Scores of the samples that were made elsewhere.
    pub(crate) given: Given,
    /// Width and height in pixels.
    pub(crate) size: Size,
}

/// Scores a backbone's samples.
///
/// # Errors
/// If an image is missing, damaged, or of another size than the others.
pub(crate) fn score(
    ctx: &Context<'_>,
    tools: &Tools,
    clean: &Clean,
    scored: Scored<'_>,
    bootstrap: Bootstrap,
) -> Result<Samples, KindError> {
    let Scored { backbone, frozen, given, size } = scored;
    let sets = read(ctx, tools, backbone, size)?;
    let mut notes = Vec::new();
    let niqe = match niqe_columns(clean, backbone, &sets, stands_alone(size[0].min(size[1]))) {
        Ok(columns) => Some(columns),
        Err(note) => {
            notes.push(note);
            None
        }
    };
    let mut each = given;
    if let Some(columns) = &niqe
        && let Some(values) = columns.iter().map(Column::values).collect::<Option<Vec<_>>>()
    {
        each.insert(NIQE.into(), values);
    }
    let mut niqe: Vec<Option<Column<'_>>> = match niqe {
        Some(columns) => columns.into_iter().map(Some).collect(),
        None => sets.iter().map(|_| None).collect(),
    };
    let mut scores = vec![MMD.to_owned(), SWD.to_owned()];
    scores.extend(niqe[0].is_some().then(|| NIQE.to_owned()));
    scores.extend(each.keys().filter(|name| *name != NIQE).cloned());
    let mut columns = Vec::new();
    let features = |set: &Set| {
        let rows: Vec<Vec<f64>> = set.numbers.iter().map(|numbers| numbers.features.clone()).collect();
        clean.standard.apply(&rows)
    };
    for (at, set) in sets.iter().enumerate() {
        let features = features(set);
        columns.push(Column::Mmd(Mmd::new(&features, &clean.references, &clean.among)));
        columns.push(Column::Swd(Slices::new(&features, &tools.directions)));
        columns.extend(niqe[at].take());
        columns.extend(each.iter().filter(|(name, _)| *name != NIQE).map(|(_, of)| Column::Each(of[at].clone())));
    }
    let against = |of: &FeatureSet| Against { mmd: Mmd::new(of, &clean.references, &clean.among), images: of.0.len() };
    let gaussian = match (&clean.gaussian, frozen) {
        (None, _) => None,
        (Some(gaussian), None) => Some((against(gaussian), None)),
        (Some(gaussian), Some(frozen)) => {
            let alone = Backbone { variants: vec![Variant::Frozen], ..frozen.clone() };
            Some((against(gaussian), Some(against(&features(&read(ctx, tools, &alone, size)?[0])))))
        }
    };
    let resampled = resample(clean, &columns, gaussian, backbone, bootstrap);
    Ok(Samples { scores, resampled, changes: sets.iter().map(|set| set.change).collect(), each, notes })
}

/// The numbers of all images, by variant.
fn read(ctx: &Context<'_>, tools: &Tools, backbone: &Backbone<'_>, size: Size) -> Result<Vec<Set>, KindError> {
    let rows: Vec<Vec<(Numbers, f64)>> = backbone
        .samples
        .par_iter()
        .map(|sample| {
            ctx.check_cancelled()?;
            let mut row: Vec<(Numbers, f64)> = Vec::with_capacity(backbone.variants.len());
            let mut frozen = None;
            for variant in &backbone.variants {
                let what = format!("variant `{variant}` of sample {} of `{}`", sample.meta.sample, backbone.name);
                let image = at_size(sample.image(ctx, *variant)?, size, &what)?;
                match &frozen {
                    None => {
                        row.push((tools.numbers(&image), 0.0));
                        frozen = Some(image);
                    }
                    // A control that changes nothing has the same numbers.
                    Some(frozen) if *frozen == image => row.push((row[0].0.clone(), 0.0)),
                    Some(frozen) => {
                        let off = frozen.data().iter().zip(image.data()).map(|(a, b)| f64::from((a - b).abs()));
                        row.push((tools.numbers(&image), off.fold(0.0, f64::max)));
                    }
                }
            }
            Ok(row)
        })
        .collect::<Result<_, KindError>>()?;
    let mut sets: Vec<Set> = backbone.variants.iter().map(|_| Set { numbers: Vec::new(), change: 0.0 }).collect();
    for row in rows {
        for (set, (numbers, change)) in sets.iter_mut().zip(row) {
            set.numbers.push(numbers);
            set.change = set.change.max(change);
        }
    }
    Ok(sets)
}

/// NIQE of each variant; what keeps it from being computed, else.
fn niqe_columns<'a>(
    clean: &'a Clean,
    backbone: &Backbone<'_>,
    sets: &[Set],
    alone: bool,
) -> Result<Vec<Column<'a>>, String> {
    let law = clean.law.as_ref().ok_or_else(|| {
        format!("NIQE of `{}` is left out: the clean renders have {} usable patches", backbone.name, clean.patches)
    })?;
    let needed = if alone { 2 } else { 1 };
    for (variant, set) in backbone.variants.iter().zip(sets) {
        for (sample, numbers) in backbone.samples.iter().zip(&set.numbers) {
            let patches = &numbers.patches;
            if patches.features.len() < needed {
                return Err(format!(
                    "NIQE of `{}` is left out: {} of the {} patches of sample {}, variant `{variant}`, are flat",
                    backbone.name,
                    patches.flat,
                    patches.flat + patches.features.len(),
                    sample.meta.sample
                ));
            }
        }
    }
    let column = |set: &Set| {
        let moments = set.numbers.iter().map(|numbers| Moments::of(&numbers.patches.features));
        if alone {
            let distance = |moments: Moments| moments.law().map_or(f64::NAN, |own| own.distance(law));
            Column::Each(moments.map(distance).collect())
        } else {
            Column::Pooled(moments.collect(), law)
        }
    };
    Ok(sets.iter().map(column).collect())
}

impl Column<'_> {
    /// The scores of the single samples, if there are such.
    fn values(&self) -> Option<Vec<f64>> {
        match self {
            Self::Each(values) => Some(values.clone()),
            Self::Mmd(_) | Self::Swd(_) | Self::Pooled(..) => None,
        }
    }

    /// The score of a draw.
    fn of(&self, clean: &Clean, samples: &Counts, references: &Counts) -> f64 {
        match self {
            Self::Mmd(mmd) => mmd.squared(samples, references),
            Self::Swd(slices) => slices.distance(samples, &clean.slices, references),
            Self::Pooled(moments, law) => {
                let mut pooled = Moments::none();
                for (moments, times) in moments.iter().zip(samples).filter(|(_, times)| **times > 0) {
                    pooled.add(moments, f64::from(*times));
                }
                pooled.law().map_or(f64::NAN, |own| own.distance(law))
            }
            Self::Each(values) => {
                let times = |(value, times): (&f64, &u32)| value * f64::from(*times);
                let number: u32 = samples.iter().sum();
                values.iter().zip(samples).map(times).sum::<f64>() / f64::from(number)
            }
        }
    }
}

/// A set of images that is compared with the held-out renders by its squared MMD alone.
struct Against<'a> {
    mmd: Mmd<'a>,
    images: usize,
}

/// The figures of all samples, and those of every draw.
fn resample(
    clean: &Clean,
    columns: &[Column<'_>],
    gaussian: Option<(Against<'_>, Option<Against<'_>>)>,
    backbone: &Backbone<'_>,
    bootstrap: Bootstrap,
) -> Resampled {
    let (samples, references) = (backbone.samples.len(), clean.references.0.len());
    // Frozen samples that are those of the backbone share its draws.
    let figures = |own: &Counts, others: &Counts, drawn: &Counts, frozen: &Counts| -> Vec<f64> {
        let mut figures: Vec<f64> = columns.iter().map(|column| column.of(clean, own, others)).collect();
        if let Some((gaussian, more)) = &gaussian {
            let of_frozen = more.as_ref().map_or(figures[0], |more| more.mmd.squared(frozen, others));
            figures.extend([gaussian.mmd.squared(drawn, others), of_frozen]);
        }
        figures
    };
    let images = gaussian.as_ref().map_or(0, |(gaussian, _)| gaussian.images);
    let more = gaussian.as_ref().and_then(|(_, more)| more.as_ref()).map_or(0, |more| more.images);
    let values = figures(&vec![1; samples], &vec![1; references], &vec![1; images], &vec![1; more]);
    let stream = Stream::new(bootstrap.seed, &[]).part("bootstrap").part(&backbone.name);
    let seed = stream.clone().bits();
    let draw = |at: u64| {
        let mut stream = Stream::new(seed, &[at]);
        let [own, others, drawn, frozen] = [samples, references, images, more].map(|n| counts(&mut stream, n));
        figures(&own, &others, &drawn, &frozen)
    };
    let draws: Vec<Vec<f64>> = (0..bootstrap.resamples).into_par_iter().map(draw).collect();
    Resampled::of_draws(values, draws.concat())
}

/// How often each of `number` members is drawn, in as many draws. A resample of one member alone has no pairs, and is
/// drawn again; there are two members at least, or none.
fn counts(stream: &mut Stream, number: usize) -> Vec<u32> {
    loop {
        let mut counts = vec![0; number];
        (0..number).for_each(|_| counts[stream.below(number)] += 1);
        if number == 0 || counts.iter().filter(|n| **n > 0).count() > 1 {
            return counts;
        }
    }
}

/// The score of a variant, by the index of the variant.
pub(crate) fn place(variants: &[Variant], of: Variant) -> Option<usize> {
    variants.iter().position(|variant| *variant == of)
}
