#![doc = include_str!("lpips.md")]

use crate::network::{Features, LEAST_SIDE, Network};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tauflow_contract::{
    Action, All, Context, Each, Facts, Foreseen, Group, Kind, KindError, KindSpec, Known, Media, Mode, Out, Outlook,
    Outputs,
};
use tauflow_data::{
    Image, TensorFile,
    facts::{self, HAS_WEIGHTS, MORE_METRICS, NFE, REFERENCE_SPP, SPP},
    image::preview,
    records::{PackedScene, PerceptualFile, Refined, SceneScores, Score},
};

/// The kind `lpips`.
pub struct Lpips;

/// Params of `lpips`: none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LpipsParams {}

/// Name of the metric.
const NAME: &str = "lpips";

const SCORES: Each<SceneScores> = Each::new("scores", "The scores to which the metric is added.");
const IMAGES: Each<Refined> =
    Each::new("images", "The images that were scored; without them, rungs of the references were.").or_none();
const REFERENCES: Each<PackedScene> = Each::new("references", "The same scenes; their last rung is the reference.");
const WEIGHTS: All<PerceptualFile> =
    All::new("weights", "The weights; without them, the metric is omitted with a note.").or_none();
const METRICS: Out<SceneScores> = Out::new(Group::main(1), "metrics", "The scores with the metric `lpips`.");

impl Kind for Lpips {
    type Params = LpipsParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "lpips",
            summary: "Adds LPIPS, a learned perceptual distance, to scores.",
            manual: include_str!("lpips.md"),
            mode: Mode::Map,
            inputs: vec![SCORES.port(), IMAGES.port(), REFERENCES.port(), WEIGHTS.port()],
            outputs: vec![METRICS.port()],
            seeded: false,
        }
    }

    fn foresee(_params: &Self::Params, known: &Known) -> Outlook {
        let (scores, references) = (known.each(SCORES), known.each(REFERENCES));
        let weights = known.has(WEIGHTS.name()).then(|| facts::shared(known.all(WEIGHTS), HAS_WEIGHTS)).flatten();
        let mut problems: Vec<Foreseen> = Vec::new();
        if weights == Some(true) {
            problems.extend(facts::least_film(REFERENCES, &references, LEAST_SIDE, "LPIPS"));
        }
        if known.has(IMAGES.name()) {
            problems.extend(facts::same_film(REFERENCES, &references, &known.each(IMAGES)));
        }
        // Without weights the metric is left out with a note, and tables that name it are no error.
        let more = scores.facts.get(MORE_METRICS).filter(|_| weights == Some(true)).map(|mut more| {
            more.push(NAME.to_owned());
            more
        });
        let facts = Facts::default()
            .with_some(REFERENCE_SPP, scores.facts.get(REFERENCE_SPP))
            .with_some(SPP, scores.facts.get(SPP))
            .with_some(NFE, scores.facts.get(NFE))
            .with_some(MORE_METRICS, more);
        Outlook::default().with(METRICS, facts).but(problems)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let item = action.item()?.as_str();
        let mut scores = action.read(ctx, SCORES)?;
        let weights = action.all_if(WEIGHTS)?.and_then(|weights| weights.iter().next().map(|(_, own)| own.load(ctx)));
        let Some(weights) = weights.transpose()? else {
            if !scores.scores.is_empty() {
                let note = "`lpips`, because `lpips_weights` names no files; set its `trunk` and `lin`".to_owned();
                scores.note = Some(scores.note.map_or_else(|| note.clone(), |other| format!("{other}; {note}")));
            }
            return Ok(Outputs::default().put(METRICS, scores.store(ctx)?));
        };
        let network = Network::new(&TensorFile::from_bytes(&weights.0)?)?;
        let scene = action.read(ctx, REFERENCES)?;
        let images = action.read_if(ctx, IMAGES)?;
        let reference = scene.states.last();
        let reference =
            reference.ok_or_else(|| KindError::Input(format!("`{item}` has no rung to be its reference")))?;
        let told = |what: &str, error: KindError| match error {
            KindError::Input(why) => KindError::Input(format!("{what} of `{item}`: {why}")),
            other => other,
        };
        let of = |image: &Image| -> Result<Features, KindError> { network.features(&finite(image)?.map(preview)) };
        let seen = of(reference).map_err(|e| told("the reference", e))?;
        for score in &mut scores.scores {
            ctx.check_cancelled()?;
            let what = format!(
                "the image of `{}`, {} -> {} samples, NFE {},",
                score.method, score.from_spp, score.to_spp, score.nfe
            );
            let image = scored(score, images.as_ref(), &scene).ok_or_else(|| {
                KindError::Input(format!(
                    "{what} of `{item}` is in `scores`, but not among the images; connect the `images` and \
                     `references` that `scores` were computed from"
                ))
            })?;
            let distance = of(image).and_then(|own| network.distance(&own, &seen));
            score.metrics.lpips = Some(distance.map_err(|e| told(&what, e))?);
        }
        Ok(Outputs::default().put(METRICS, scores.store(ctx)?))
    }
}

/// The image itself, if all its values are numbers.
fn finite(image: &Image) -> Result<&Image, KindError> {
    match image.data().iter().filter(|value| !value.is_finite()).count() {
        0 => Ok(image),
        count => Err(KindError::Input(format!(
            "{count} of the {} values are not finite, so LPIPS cannot be computed; check the node that produced the \
             image",
            image.data().len()
        ))),
    }
}

/// The image of a score.
fn scored<'a>(score: &Score, images: Option<&'a Refined>, scene: &'a PackedScene) -> Option<&'a Image> {
    let Some(images) = images else {
        let rung = scene.counts.iter().position(|count| *count == score.from_spp).filter(|_| score.nfe == 0)?;
        return scene.states.get(rung);
    };
    let key = (&score.method, score.from_spp, score.to_spp, score.nfe);
    let found = images.images.iter().find(|(said, _)| (&said.method, said.from_spp, said.to_spp, said.nfe) == key);
    found.map(|(_, image)| image)
}
