#![doc = include_str!("image_quality.md")]

mod clean;
mod distances;
mod features;
mod niqe;
mod pictures;
mod samples;
mod symmetric;

use self::{
    clean::{Clean, Renders, Tools},
    features::LEAST_SIDE,
    niqe::stands_alone,
    pictures::{Backbone, Size, backbones, clean as clean_render, common, size},
    samples::{Bootstrap, Given, MMD, NIQE, SWD, Samples, Scored, place, score},
};
use crate::claims::claim;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tauflow_contract::{
    Action, All, Context, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, ParamProblem,
};
use tauflow_data::records::{
    AgainstGaussian, BackboneQuality, Better, Claim, ClaimVerdict, Estimate, Evidence, Gain, Generated, ImageQuality,
    PackedScene, SampleRow, SampleScores, ScoreColumn, Variant, VariantQuality,
};

/// The kind `image_quality`.
pub struct ImageQualityKind;

/// Params of `image_quality`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImageQualityParams {
    /// The score that decides the verdicts: mmd, swd, niqe, or one of the connected `scores`.
    pub judged_by: String,
    /// Number of bootstrap resamples.
    #[schemars(range(min = 100, max = 100_000))]
    pub resamples: u64,
}

impl Default for ImageQualityParams {
    fn default() -> Self {
        Self { judged_by: MMD.into(), resamples: 2000 }
    }
}

const GENERATED: All<Generated> = All::new("generated", "The samples, of one backbone or several.");
const REFERENCES: All<PackedScene> =
    All::new("references", "Held-out scenes; their last rungs are the clean renders for the comparison.");
const TRAINING: All<PackedScene> =
    All::new("training", "Training set: for the normalisation of features, the model of NIQE, and Gaussian images.")
        .or_none();
const FROZEN: All<Generated> = All::new(
    "frozen",
    "Samples of the same backbones to compare with the Gaussian images, instead of `generated`; only their variant \
     `frozen` is used.",
)
.or_none();
const SCORES: All<SampleScores> =
    All::new("scores", "Scores of the same samples by metrics that need no reference.").or_none();
const QUALITY: Out<ImageQuality> =
    Out::new(Group::main(4), "quality", "Scores by backbone and variant, gains and verdicts.").single();

fn input(what: String) -> KindError {
    KindError::Input(what)
}

impl Kind for ImageQualityKind {
    type Params = ImageQualityParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "image_quality",
            summary: "Scores generated images against clean renders, and judges an adapter's gain.",
            manual: include_str!("image_quality.md"),
            mode: Mode::Gather,
            inputs: vec![GENERATED.port(), REFERENCES.port(), TRAINING.port(), FROZEN.port(), SCORES.port()],
            outputs: vec![QUALITY.port()],
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.judged_by.trim().is_empty() {
            return Vec::new();
        }
        vec![ParamProblem::new("/judged_by", "no score is named", "write for example `judged_by: mmd`")]
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let generated = action.all(GENERATED)?;
        let renders = Renders { references: action.all(REFERENCES)?, training: action.all_if(TRAINING)? };
        let number = renders.references.len();
        if number < 2 {
            return Err(input(format!("`references` has {number} scenes; connect at least 2 held-out scenes")));
        }
        if let Some(training) = renders.training.filter(|training| training.len() < 2) {
            let number = training.len();
            return Err(input(format!("`training` has {number} scenes; connect at least 2, or leave it away")));
        }
        let backbones = backbones(ctx, generated)?;
        if backbones.is_empty() {
            return Err(input("`generated` has no sample; connect a node that generates some".into()));
        }
        let frozen = frozen(ctx, action, &backbones, renders.training.is_some())?;
        let mut others = external(ctx, action)?;
        let bootstrap = Bootstrap { resamples: action.params.resamples, seed: action.seed };
        let drawn = backbones.iter().chain(&frozen).map(|backbone| backbone.samples.len()).max().unwrap_or(0);
        let tools = Tools::new();
        let mut known: Vec<(Size, Clean)> = Vec::new();
        let mut quality = ImageQuality {
            judged_by: action.params.judged_by.clone(),
            resamples: action.params.resamples,
            references: number as u64,
            training: renders.training.map(|training| training.len() as u64),
            columns: [MMD, SWD, NIQE].map(|name| ScoreColumn { name: name.into(), better: Better::Lower }).into(),
            backbones: Vec::new(),
            notes: notes(&renders, std::mem::take(&mut others.notes)),
            per_sample: Vec::new(),
        };
        quality.columns.extend(others.columns.iter().cloned());
        let total = backbones.len() as u64;
        for (done, backbone) in backbones.iter().enumerate() {
            ctx.progress(done as u64, total, &backbone.name);
            let size = compared_at(ctx, backbone, &renders)?;
            if !known.iter().any(|(at, _)| *at == size) {
                let clean = Clean::new(ctx, &tools, renders, size, gaussian_images(size, drawn), action.seed)?;
                known.push((size, clean));
            }
            let Some((_, clean)) = known.iter().find(|(at, _)| *at == size) else {
                return Err(KindError::Internal("a size that was just read".into()));
            };
            let scored = Scored {
                backbone,
                frozen: frozen.iter().find(|its| its.name == backbone.name),
                given: others.of(backbone)?,
                size,
            };
            let compared = scored.frozen.unwrap_or(backbone);
            let samples = score(ctx, &tools, clean, scored, bootstrap)?;
            quality.notes.extend(samples.notes.iter().cloned());
            if samples.scores.iter().any(|score| score == NIQE) && !stands_alone(size[0].min(size[1])) {
                let (name, patches) = (&backbone.name, clean.patches);
                quality.notes.push(format!(
                    "NIQE of `{name}` pools the patches of each variant, because images have fewer than 192 pixels; \
                     its model has {patches} patches"
                ));
            }
            quality.per_sample.extend(per_sample(backbone, &samples));
            let against = (compared, gaussian_images(size, drawn));
            quality.backbones.push(table(backbone, size, &samples, &quality, against)?);
        }
        let there = |column: &ScoreColumn| {
            let has = |backbone: &BackboneQuality| backbone.variants[0].scores.contains_key(&column.name);
            quality.backbones.iter().any(has)
        };
        let (columns, _): (Vec<_>, Vec<_>) = quality.columns.clone().into_iter().partition(there);
        quality.columns = columns;
        Outputs::default().put_one(QUALITY, "quality", quality.store(ctx)?)
    }
}

/// How many Gaussian images are drawn: at least as many as samples. More of them make the comparison more certain at
/// little cost, until their sums fill 128 MiB.
fn gaussian_images(size: Size, samples: usize) -> usize {
    let bytes = 3 * size[0] * size[1] * size_of::<f32>();
    ((128 << 20) / bytes.max(1)).min(1000).max(samples)
}

/// What is said of inputs that were left out.
fn notes(renders: &Renders<'_>, others: Vec<String>) -> Vec<String> {
    let training = "no training set is connected: the held-out renders give the units of features and NIQE's model, \
                    and the frozen backbones are not compared with Gaussian images";
    renders.training.is_none().then(|| training.to_owned()).into_iter().chain(others).collect()
}

/// The size at which a backbone's samples and the renders are compared.
fn compared_at(ctx: &Context<'_>, backbone: &Backbone<'_>, renders: &Renders<'_>) -> Result<Size, KindError> {
    let number = backbone.samples.len();
    if number < 2 {
        let name = &backbone.name;
        return Err(input(format!("backbone `{name}` has {number} sample; generate at least 2")));
    }
    let own = size(&backbone.samples[0].image(ctx, Variant::Frozen)?);
    let Some((key, first)) = renders.references.iter().next() else {
        return Err(KindError::Internal("references that were counted".into()));
    };
    let theirs = size(&clean_render(ctx, first)?);
    let at = common(own, theirs).ok_or_else(|| {
        input(format!(
            "samples of `{}` have {} x {} pixels, the render of `{key}` {} x {}; the sides must be equal, or one a \
             whole multiple of the other: render at another `film`",
            backbone.name, own[0], own[1], theirs[0], theirs[1]
        ))
    })?;
    if at[0].min(at[1]) < LEAST_SIDE {
        return Err(input(format!(
            "samples of `{}` and renders are compared at {} x {} pixels; scores need {LEAST_SIDE} on each side",
            backbone.name, at[0], at[1]
        )));
    }
    Ok(at)
}

/// The backbones of the input `frozen`, each of which `generated` has too.
fn frozen<'a>(
    ctx: &Context<'_>,
    action: &Action<'a, ImageQualityParams>,
    scored: &[Backbone<'_>],
    training: bool,
) -> Result<Vec<Backbone<'a>>, KindError> {
    let Some(items) = action.all_if(FROZEN)?.filter(|items| !items.is_empty()) else { return Ok(Vec::new()) };
    if !training {
        return Err(input(
            "`frozen` is compared with Gaussian images of a training set; connect `training`, or leave `frozen` away"
                .into(),
        ));
    }
    let found = backbones(ctx, items)?;
    for Backbone { name, family, samples, .. } in &found {
        let Some(own) = scored.iter().find(|own| own.name == *name) else {
            return Err(input(format!("`frozen` has samples of backbone `{name}`, which `generated` does not have")));
        };
        if own.family != *family {
            return Err(input(format!(
                "backbone `{name}` is a {} in `generated` and a {} in `frozen`; connect samples of the same backbones",
                own.family.name(),
                family.name()
            )));
        }
        if samples.len() < 2 {
            return Err(input(format!("`frozen` has {} sample of `{name}`; generate at least 2", samples.len())));
        }
    }
    Ok(found)
}

/// Scores of single images that were made elsewhere.
struct External {
    columns: Vec<ScoreColumn>,
    rows: BTreeMap<(String, u64, Variant), BTreeMap<String, f64>>,
    notes: Vec<String>,
}

/// Those that are connected.
fn external(ctx: &Context<'_>, action: &Action<'_, ImageQualityParams>) -> Result<External, KindError> {
    let mut found = External { columns: Vec::new(), rows: BTreeMap::new(), notes: Vec::new() };
    let Some(items) = action.all_if(SCORES)? else { return Ok(found) };
    for (key, item) in items.iter() {
        let SampleScores { columns, rows, notes } = item.load(ctx)?;
        found.notes.extend(notes);
        for column in columns {
            let known = |name: &str| [MMD, SWD, NIQE].contains(&name) || found.columns.iter().any(|c| c.name == name);
            if known(&column.name) {
                let name = &column.name;
                return Err(input(format!("`scores` item `{key}` has a score `{name}`, which is there already")));
            }
            found.columns.push(column);
        }
        for SampleRow { backbone, sample, variant, scores } in rows {
            let row = found.rows.entry((backbone, sample, variant)).or_default();
            row.extend(scores);
        }
    }
    Ok(found)
}

impl External {
    /// The scores of a backbone's samples: by name, then variant and sample.
    fn of(&self, backbone: &Backbone<'_>) -> Result<Given, KindError> {
        let value = |name: &str, variant: Variant, sample: u64| {
            let row = self.rows.get(&(backbone.name.clone(), sample, variant));
            row.and_then(|row| row.get(name)).copied().filter(|value| value.is_finite()).ok_or_else(|| {
                input(format!(
                    "`scores` has no `{name}` of sample {sample} of `{}`, variant `{variant}`; connect scores of the \
                     same samples",
                    backbone.name
                ))
            })
        };
        let column = |ScoreColumn { name, .. }: &ScoreColumn| {
            let variant = |variant: &Variant| {
                backbone.samples.iter().map(|sample| value(name, *variant, sample.meta.sample)).collect()
            };
            Ok((name.clone(), backbone.variants.iter().map(variant).collect::<Result<_, KindError>>()?))
        };
        self.columns.iter().map(column).collect()
    }
}

/// The scores of single images, a row for each.
fn per_sample(backbone: &Backbone<'_>, samples: &Samples) -> Vec<SampleRow> {
    let rows = backbone.samples.iter().enumerate().flat_map(|(number, sample)| {
        backbone.variants.iter().enumerate().map(move |(at, variant)| (number, sample, at, *variant))
    });
    let row = |(number, sample, at, variant): (usize, &pictures::Sample<'_>, usize, Variant)| SampleRow {
        backbone: backbone.name.clone(),
        sample: sample.meta.sample,
        variant,
        scores: samples.each.iter().map(|(name, values)| (name.clone(), values[at][number])).collect(),
    };
    rows.map(row).filter(|row| !row.scores.is_empty()).collect()
}

/// The tables of a backbone.
fn table(
    backbone: &Backbone<'_>,
    size: Size,
    samples: &Samples,
    quality: &ImageQuality,
    (compared, gaussians): (&Backbone<'_>, usize),
) -> Result<BackboneQuality, KindError> {
    let resampled = &samples.resampled;
    let figures = |of: &dyn Fn(usize, &str) -> Estimate| -> BTreeMap<String, Estimate> {
        samples.scores.iter().enumerate().map(|(at, name)| (name.clone(), of(at, name))).collect()
    };
    let variant = |(at, variant): (usize, &Variant)| VariantQuality {
        variant: *variant,
        scores: figures(&|score, _| resampled.estimate(|m| m[samples.at(at, score)])),
        change: samples.changes[at],
        energy: energy(backbone, at),
    };
    let better = |name: &str| {
        quality.columns.iter().find(|column| column.name == name).map_or(Better::Lower, |column| column.better)
    };
    let adapted = place(&backbone.variants, Variant::Adapted);
    let gain = |own: usize, other: usize, over: Variant| Gain {
        over,
        scores: figures(&|score, name| {
            let (own, other) = (samples.at(own, score), samples.at(other, score));
            resampled.estimate(|m| better(name).gain(m[own], m[other]))
        }),
    };
    let others = |own: usize| backbone.variants.iter().enumerate().filter(move |(at, _)| *at != own);
    let gains: Vec<Gain> =
        adapted.map_or_else(Vec::new, |own| others(own).map(|(at, over)| gain(own, at, *over)).collect());
    let gaussian = quality.training.is_some().then(|| {
        let [gaussian, frozen] = samples.gaussian();
        AgainstGaussian {
            images: gaussians as u64,
            samples: compared.samples.len() as u64,
            steps: compared.steps,
            gaussian: resampled.estimate(|m| m[gaussian]),
            frozen: resampled.estimate(|m| m[frozen]),
            nearer: resampled.estimate(|m| m[gaussian] - m[frozen]),
        }
    });
    let claim = adapted.map(|_| verdict(&backbone.name, &gains, &quality.judged_by, samples)).transpose()?;
    Ok(BackboneQuality {
        backbone: backbone.name.clone(),
        family: backbone.family,
        samples: backbone.samples.len() as u64,
        steps: backbone.steps,
        size: size.map(|side| side as u64),
        variants: backbone.variants.iter().enumerate().map(variant).collect(),
        gains,
        gaussian,
        claim,
    })
}

/// The mean over samples of the injected energy of each step.
fn energy(backbone: &Backbone<'_>, variant: usize) -> Vec<f64> {
    let number = backbone.samples.len() as f64;
    let mean = |step: usize| {
        backbone.samples.iter().map(|sample| sample.meta.variants[variant].energy[step]).sum::<f64>() / number
    };
    (0..backbone.steps as usize).map(mean).collect()
}

/// Whether a gain counts as physical.
fn verdict(backbone: &str, gains: &[Gain], judged_by: &str, samples: &Samples) -> Result<Claim, KindError> {
    let scores = &samples.scores;
    if !scores.iter().any(|score| score == judged_by) {
        return Err(input(format!(
            "`judged_by: {judged_by}` is no score of `{backbone}`, which has {}; name one of them, or connect `scores` \
             that have it",
            scores.join(", ")
        )));
    }
    let evidence = |gain: &Gain| {
        let difference = *gain.scores.get(judged_by)?;
        let what = format!("over {}", gain.over.label());
        Some(Evidence { what, metric: judged_by.to_owned(), difference, draws: None })
    };
    let evidence: Vec<Evidence> = gains.iter().filter_map(evidence).collect();
    let group = BTreeMap::from([("backbone".to_owned(), backbone.to_owned())]);
    let mut found = claim("The adapter's gain is physical", &group, Some(evidence), &samples.resampled)
        .ok_or_else(|| KindError::Internal(format!("a gain of `{backbone}` that is no finite number")))?;
    let controls = gains.iter().filter(|gain| gain.over.is_control()).count();
    let all = Variant::ALL.iter().filter(|variant| variant.is_control()).count();
    if found.verdict == ClaimVerdict::Held && controls < all {
        found.verdict = ClaimVerdict::Undecided;
    }
    Ok(found)
}
