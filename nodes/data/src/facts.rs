//! Facts about ladders, images, models and scores that are known before a run ([`tauflow_contract::Facts`]), and the
//! checks on them that kinds share. Knows no kind.

use crate::methods::{Conditioning, Parameterization};
use serde::de::DeserializeOwned;
use tauflow_contract::{Fact, Facts, Foreseen, Named, Source};

/// The sample counts of a ladder, all of them, increasing. Of a model: those of its training ladder.
pub const RUNGS: Fact<Vec<u64>> = Fact::new("rungs");
/// Width and height in pixels.
pub const FILM: Fact<[usize; 2]> = Fact::new("film");
/// Whether samples are independent of each other.
pub const INDEPENDENT: Fact<bool> = Fact::new("independent");
/// Whether a packed scene has a G-buffer.
pub const HAS_GBUFFER: Fact<bool> = Fact::new("gbuffer");
/// The additional input of a model.
pub const CONDITIONING: Fact<Conditioning> = Fact::new("conditioning");
/// What a model predicts.
pub const PARAMETERIZATION: Fact<Parameterization> = Fact::new("parameterization");
/// The sample counts that images start from, or that their scores say; known only where there are sure to be images.
pub const SPP: Fact<Vec<u64>> = Fact::new("spp");
/// The numbers of network calls of images or scores.
pub const NFE: Fact<Vec<u64>> = Fact::new("nfe");
/// The samples per pixel of the reference behind scores.
pub const REFERENCE_SPP: Fact<u64> = Fact::new("reference_spp");
/// The metrics of scores beyond those that all scores have, by name.
pub const MORE_METRICS: Fact<Vec<String>> = Fact::new("more_metrics");
/// Whether there are weights of a perceptual distance.
pub const HAS_WEIGHTS: Fact<bool> = Fact::new("weights");

/// Numbers in words; of many, the first and the last.
fn listed(numbers: &[u64]) -> String {
    let text = |numbers: &[u64]| numbers.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    match numbers {
        [first @ .., last] if numbers.len() > 12 => format!("{} ... {last}", text(&first[..8])),
        all => text(all),
    }
}

/// The nearest numbers below and above one that is not there.
fn nearest(numbers: &[u64], wanted: u64) -> String {
    let below = numbers.iter().rfind(|number| **number < wanted);
    let above = numbers.iter().find(|number| **number > wanted);
    below.into_iter().chain(above).map(u64::to_string).collect::<Vec<_>>().join(" or ")
}

/// The fact that all of these have; none if one has none, or they differ.
pub fn shared<T: DeserializeOwned + PartialEq>(sources: &[Source], fact: Fact<T>) -> Option<T> {
    let mut values = sources.iter().map(|source| source.facts.get(fact));
    let first = values.next()??;
    values.all(|value| value.as_ref() == Some(&first)).then_some(first)
}

/// Whether a ladder has a rung that the param at `pointer` names.
pub fn rung(source: &Source, wanted: u64, pointer: &str) -> Option<Foreseen> {
    let rungs = source.facts.get(RUNGS).filter(|rungs| !rungs.contains(&wanted))?;
    let message = format!("`{}` has no rung of {wanted} samples, only {}", source.name, listed(&rungs));
    let hint = format!("use {}, or add {wanted} to `rungs` of the ladders", nearest(&rungs, wanted));
    Some(Foreseen::param(pointer, message, hint))
}

/// Whether ladders that must have the same rungs have them; `port` is the input of `source`.
pub fn same_rungs(port: impl Named, source: &Source, other: &Source) -> Option<Foreseen> {
    let (rungs, others) = (source.facts.get(RUNGS)?, other.facts.get(RUNGS)?);
    (rungs != others).then(|| {
        let message =
            format!("`{}` has the rungs {}, but `{}` has {}", source.name, listed(&rungs), other.name, listed(&others));
        Foreseen::input(port, message, "give both ladders the same `rungs`")
    })
}

/// Whether the last rungs of two ladders have the same samples; `port` is the input of `source`.
pub fn same_last_rung(port: impl Named, source: &Source, other: &Source) -> Option<Foreseen> {
    let last = |source: &Source| source.facts.get(RUNGS).and_then(|rungs| rungs.last().copied());
    let (own, others) = (last(source)?, last(other)?);
    (own != others).then(|| {
        let message =
            format!("the last rung of `{}` has {own} samples, but that of `{}` has {others}", source.name, other.name);
        Foreseen::input(port, message, "connect the ladders of which one was made from the other")
    })
}

/// The source with the longest known ladder, the first if there are several.
pub fn longest(sources: &[Source]) -> Option<&Source> {
    let lengths = sources.iter().filter_map(|source| Some((source.facts.get(RUNGS)?.len(), source)));
    lengths.reduce(|most, next| if next.0 > most.0 { next } else { most }).map(|(_, source)| source)
}

/// Whether a ladder that may end before another has only first rungs of it; `port` is the input of `source`.
pub fn first_rungs(port: impl Named, source: &Source, longer: &Source) -> Option<Foreseen> {
    let (rungs, others) = (source.facts.get(RUNGS)?, longer.facts.get(RUNGS)?);
    (!others.starts_with(&rungs)).then(|| {
        let message = format!(
            "`{}` has the rungs {}, but `{}` has {}",
            source.name,
            listed(&rungs),
            longer.name,
            listed(&others)
        );
        Foreseen::input(port, message, "give both ladders the same `rungs`, or one of them the first of the other's")
    })
}

/// Whether images that are compared have the same size; `port` is the input of `source`.
pub fn same_film(port: impl Named, source: &Source, other: &Source) -> Option<Foreseen> {
    let (film, others) = (source.facts.get(FILM)?, other.facts.get(FILM)?);
    (film != others).then(|| {
        let message = format!(
            "the images of `{}` have {} x {} pixels, but those of `{}` have {} x {}",
            source.name, film[0], film[1], other.name, others[0], others[1]
        );
        Foreseen::input(port, message, "render both with the same `resolution`")
    })
}

/// Whether images are large enough for a metric that needs `side` pixels each way.
pub fn least_film(port: impl Named, source: &Source, side: usize, metric: &str) -> Option<Foreseen> {
    let [width, height] = source.facts.get(FILM).filter(|film| film.iter().any(|own| *own < side))?;
    let message = format!(
        "the images of `{}` have {width} x {height} pixels, but {metric} needs at least {side} x {side}",
        source.name
    );
    Some(Foreseen::input(port, message, "increase `resolution`"))
}

/// Whether samples are independent, as variance time requires.
pub fn independent(port: impl Named, source: &Source) -> Option<Foreseen> {
    let correlated = source.facts.get(INDEPENDENT) == Some(false);
    correlated.then(|| {
        let message = format!("the samples of `{}` are correlated, but must be independent", source.name);
        Foreseen::input(port, message, "render these ladders with `sampler: independent`")
    })
}

/// Whether a source has independent samples and the other has not, or the other way round.
pub fn same_sampling(port: impl Named, source: &Source, other: &Source) -> Option<Foreseen> {
    let (own, others) = (source.facts.get(INDEPENDENT)?, other.facts.get(INDEPENDENT)?);
    (own != others).then(|| {
        let name = |independent| if independent { "independent" } else { "correlated" };
        let message = format!(
            "the samples of `{}` are {}, but those of `{}` are {}",
            source.name,
            name(own),
            other.name,
            name(others)
        );
        Foreseen::input(port, message, "render these ladders with the same `sampler`")
    })
}

/// Whether there is the G-buffer that a conditioning needs.
pub fn gbuffer(port: impl Named, source: &Source, conditioning: Conditioning) -> Option<Foreseen> {
    let lacks = conditioning == Conditioning::Gbuffer && source.facts.get(HAS_GBUFFER) == Some(false);
    lacks.then(|| {
        let message = format!("`{}` has no G-buffers, but `conditioning: gbuffer` needs them", source.name);
        let hint = format!("connect `gbuffers` of `{}`, or use `conditioning: rgb`", source.name);
        Foreseen::input(port, message, hint)
    })
}

/// The facts of a packed scene that are facts of an image made of it.
pub fn image_of(packed: &Facts) -> Facts {
    Facts::default().with_some(FILM, packed.get(FILM))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::PackedScene;
    use tauflow_contract::Each;

    const PORT: Each<PackedScene> = Each::new("endpoints", "Scenes.");

    fn source(name: &str, facts: Facts) -> Source {
        Source { name: name.into(), facts, ..Source::default() }
    }

    #[test]
    fn a_missing_rung_names_its_neighbours() {
        let ladder = source("set", Facts::default().with(RUNGS, vec![1, 2, 4]));
        assert_eq!(rung(&ladder, 2, "/from"), None);
        let told = rung(&ladder, 3, "/from").expect("no such rung");
        assert_eq!(told.message, "`set` has no rung of 3 samples, only 1, 2, 4");
        assert_eq!(told.hint, "use 2 or 4, or add 3 to `rungs` of the ladders");
        assert!(rung(&ladder, 8, "/from").expect("no such rung").hint.starts_with("use 4, or"));
        assert_eq!(rung(&source("set", Facts::default()), 3, "/from"), None, "what is not known is no error");
    }

    #[test]
    fn ladders_may_be_the_first_rungs_of_the_longest() {
        let set = |name: &str, rungs: &[u64]| source(name, Facts::default().with(RUNGS, rungs.to_vec()));
        let sets = [set("short", &[1, 2]), set("long", &[1, 2, 4]), set("as long", &[1, 3, 9])];
        let most = longest(&sets).expect("all are known");
        assert_eq!(most.name, "long");
        assert_eq!((first_rungs(PORT, &sets[0], most), first_rungs(PORT, most, most)), (None, None));
        let told = first_rungs(PORT, &sets[2], most).expect("other rungs");
        assert_eq!(told.message, "`as long` has the rungs 1, 3, 9, but `long` has 1, 2, 4");
        let some = [source("unknown", Facts::default()), set("known", &[1])];
        assert_eq!(longest(&some).map(|known| &*known.name), Some("known"));
        assert!(longest(&some[..1]).is_none() && longest(&[]).is_none());
    }

    #[test]
    fn only_facts_of_both_can_differ() {
        let film = |side| source("images", Facts::default().with(FILM, [side, 8]));
        assert!(same_film(PORT, &film(16), &film(8)).expect("they differ").message.contains("16 x 8"));
        assert_eq!(same_film(PORT, &film(8), &film(8)), None);
        assert_eq!(same_film(PORT, &film(8), &source("other", Facts::default())), None);
        assert_eq!((shared(&[film(8), film(8)], FILM), shared(&[film(8), film(9)], FILM)), (Some([8, 8]), None));
        assert!(least_film(PORT, &film(16), 11, "SSIM").is_some() && least_film(PORT, &film(16), 8, "SSIM").is_none());
    }

    #[test]
    fn many_rungs_are_shortened() {
        let numbers: Vec<u64> = (1..=20).collect();
        assert_eq!(listed(&numbers), "1, 2, 3, 4, 5, 6, 7, 8 ... 20");
    }
}
