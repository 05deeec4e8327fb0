//! Layout templates: parametric arrangements, a handful for each context.
//!
//! Metres; an object is about 1 m. Powers are relative: exposure is set afterwards, scene by scene.

mod enclosed;
mod environment;
mod open;

use super::stage::Stage;
use tauflow_data::{ContextClass, Regime, Stratum, rng::Stream};

/// A template: fills a stage for so many objects.
type Template = (&'static str, fn(&mut Stage, usize));

/// The templates of a context that suit a regime.
///
/// Caustics need a diffuse receiver: objects that float in the sky have none, so L3 leaves `floating` out.
pub fn templates(stratum: Stratum) -> Vec<Template> {
    let all: &[Template] = match stratum.context {
        ContextClass::Environment => &environment::TEMPLATES,
        ContextClass::Open => &open::TEMPLATES,
        ContextClass::Enclosed => &enclosed::TEMPLATES,
    };
    let fits = |t: &&Template| stratum.regime != Regime::L3 || t.0 != "floating";
    all.iter().filter(fits).copied().collect()
}

/// A stage of a random template for `objects` objects.
pub fn build(stratum: Stratum, stream: &Stream, objects: usize) -> Stage {
    let choices = templates(stratum);
    let (name, template) = choices[stream.part("template").below(choices.len())];
    let mut stage = Stage::new(name, stratum.regime, stream);
    template(&mut stage, objects.saturating_sub(1));
    stage
}
