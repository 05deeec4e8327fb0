//! Type-erased kinds for the engine, with JSON params.

use crate::{
    Action, Context, ItemKey, Kind, KindError, KindSpec, Known, Outlook, Outputs, ParamProblem, Probe, Resources,
    SourceItem, fill_in, leave_out,
};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::marker::PhantomData;

/// The params that the action of an item (if it has one) and an output group reads.
pub type Projection = Box<dyn Fn(Option<&ItemKey>, &str) -> Value + Send + Sync>;

/// A kind as the engine sees it: object-safe, with JSON params.
pub trait NodeKind: Send + Sync {
    /// The description of the kind.
    fn spec(&self) -> KindSpec;
    /// See [`Kind::spec_for`]; `params` are resolved, or a projection.
    fn spec_for(&self, params: &Value) -> KindSpec;
    /// See [`Kind::port_params`].
    fn port_params(&self) -> &'static [&'static str];
    /// JSON Schema of the params.
    fn params_schema(&self) -> Value;
    /// Fills defaults in, and checks.
    ///
    /// # Errors
    /// Every problem found.
    fn resolve(&self, params: &Value) -> Result<Value, Vec<ParamProblem>>;
    /// See [`Kind::foresee`]; `params` are resolved, and are read once for all that is known of several items.
    fn foresee(&self, params: &Value, known: &[Known]) -> Vec<Outlook>;
    /// See [`Kind::work`]; `params` are resolved, or a projection. It is above 0.
    fn work(&self, params: &Value, group: &str) -> f64;
    /// See [`Kind::sort`]; `params` are resolved, or a projection.
    fn sort(&self, params: &Value) -> String;
    /// See [`Kind::resources`]; `params` are resolved, or a projection.
    fn resources(&self, params: &Value, group: &str) -> Resources;
    /// See [`Kind::missing`]; `params` are resolved.
    fn missing(&self, params: &Value) -> Vec<ParamProblem>;
    /// See [`Kind::items`]; `params` are resolved.
    ///
    /// # Errors
    /// As [`Kind::items`].
    fn items(&self, params: &Value) -> Result<Vec<SourceItem>, KindError>;
    /// See [`Kind::project`]; `params` are resolved, and are read once for all the items that the projection is asked
    /// about.
    fn projection(&self, params: &Value) -> Projection;
    /// Resolved params without those that came later and have the value of before ([`Kind::later`]): what decides the
    /// outcomes of all items together.
    fn keyed(&self, params: &Value) -> Value;
    /// See [`Kind::seed`].
    fn seed(&self, pipeline_seed: u64, item: &str) -> u64;
    /// See [`Kind::environment`]; `params` are resolved, or a projection.
    fn environment(&self, params: &Value, group: &str, probe: &dyn Probe) -> Option<Value>;
    /// See [`Kind::runs_programs`]; `params` are resolved, or a projection.
    fn runs_programs(&self, params: &Value) -> bool;
    /// See [`Kind::run`]; the params are a projection.
    ///
    /// # Errors
    /// As [`Kind::run`].
    fn run(&self, ctx: &Context<'_>, action: &Action<'_, Value>) -> Result<Outputs, KindError>;
}

/// Row of the registry: wraps a [`Kind`] as a [`NodeKind`].
pub struct KindRow<K>(PhantomData<fn() -> K>);

impl<K> KindRow<K> {
    /// The row.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<K> Default for KindRow<K> {
    fn default() -> Self {
        Self::new()
    }
}

fn parse<P: DeserializeOwned>(params: &Value) -> Result<P, KindError> {
    serde_json::from_value(params.clone())
        .map_err(|e| KindError::Internal(format!("resolved params do not parse: {e}")))
}

/// A place in params as a JSON pointer.
fn pointer(path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    let step = |segment: &Segment| match segment {
        Segment::Seq { index } => Some(format!("/{index}")),
        Segment::Map { key } => Some(format!("/{}", key.replace('~', "~0").replace('/', "~1"))),
        Segment::Enum { .. } | Segment::Unknown => None,
    };
    path.iter().filter_map(step).collect()
}

impl<K: Kind> NodeKind for KindRow<K> {
    fn spec(&self) -> KindSpec {
        K::spec()
    }

    fn spec_for(&self, params: &Value) -> KindSpec {
        if K::port_params().is_empty() {
            return K::spec();
        }
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        // Params that do not parse cannot be, once they are resolved; those of a crafted action are refused by `run`.
        parse(&read).map_or_else(|_| K::spec(), |params| K::spec_for(&params))
    }

    fn port_params(&self) -> &'static [&'static str] {
        K::port_params()
    }

    fn params_schema(&self) -> Value {
        schemars::schema_for!(K::Params).to_value()
    }

    fn resolve(&self, params: &Value) -> Result<Value, Vec<ParamProblem>> {
        let typed: K::Params = serde_path_to_error::deserialize(params).map_err(|error| {
            let hint = format!("see `tauflow kinds {}` for its params", K::spec().name);
            vec![ParamProblem::new(pointer(error.path()), error.inner().to_string(), hint)]
        })?;
        let problems = K::check(&typed);
        if !problems.is_empty() {
            return Err(problems);
        }
        serde_json::to_value(&typed).map_err(|e| vec![ParamProblem::new("", e.to_string(), "use finite numbers")])
    }

    fn foresee(&self, params: &Value, known: &[Known]) -> Vec<Outlook> {
        match parse::<K::Params>(params) {
            Ok(params) => known.iter().map(|known| K::foresee(&params, known)).collect(),
            // Cannot be for resolved params; nothing is known then.
            Err(_) => vec![Outlook::default(); known.len()],
        }
    }

    fn work(&self, params: &Value, group: &str) -> f64 {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        let work: f64 = parse(&read).map_or(1.0, |params| K::work(&params, group));
        if work.is_finite() && work > 0.0 { work } else { 1.0 }
    }

    fn sort(&self, params: &Value) -> String {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        parse(&read).map_or_else(|_| String::new(), |params| K::sort(&params))
    }

    fn resources(&self, params: &Value, group: &str) -> Resources {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        parse(&read).map_or_else(|_| Resources::default(), |params| K::resources(&params, group))
    }

    fn missing(&self, params: &Value) -> Vec<ParamProblem> {
        parse::<K::Params>(params).map_or_else(|_| Vec::new(), |params| K::missing(&params))
    }

    fn items(&self, params: &Value) -> Result<Vec<SourceItem>, KindError> {
        K::items(&parse(params)?)
    }

    fn projection(&self, params: &Value) -> Projection {
        match parse::<K::Params>(params) {
            Ok(typed) => Box::new(move |item, group| {
                let mut read = K::project(&typed, item, group);
                leave_out(&mut read, K::later());
                read
            }),
            // Cannot be for resolved params; the whole params are a sound, if broad, key.
            Err(_) => {
                let params = params.clone();
                Box::new(move |_, _| params.clone())
            }
        }
    }

    fn keyed(&self, params: &Value) -> Value {
        let mut keyed = params.clone();
        leave_out(&mut keyed, K::later());
        keyed
    }

    fn seed(&self, pipeline_seed: u64, item: &str) -> u64 {
        K::seed(pipeline_seed, item)
    }

    fn environment(&self, params: &Value, group: &str, probe: &dyn Probe) -> Option<Value> {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        // Params that do not parse cannot be, once they are resolved; those of a crafted action are refused by `run`.
        parse(&read).map_or(Some(Value::Null), |params| K::environment(&params, group, probe))
    }

    fn runs_programs(&self, params: &Value) -> bool {
        let mut read = params.clone();
        fill_in(&mut read, K::later());
        parse(&read).is_ok_and(|params| K::runs_programs(&params))
    }

    fn run(&self, ctx: &Context<'_>, action: &Action<'_, Value>) -> Result<Outputs, KindError> {
        let mut read = action.params.clone();
        fill_in(&mut read, K::later());
        let typed = Action {
            params: parse::<K::Params>(&read)?,
            item: action.item,
            group: action.group,
            seed: action.seed,
            each: action.each.clone(),
            all: action.all.clone(),
        };
        K::run(ctx, &typed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Before, Files, Group, Later, Mode, Out};
    use schemars::JsonSchema;
    use serde::{Deserialize, Serialize};
    use serde_json::json;
    use std::collections::BTreeMap;

    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Params {
        #[serde(default)]
        list: Vec<Even>,
        /// Was 1 before it existed; the default of today is another.
        #[serde(default = "five")]
        factor: u32,
    }

    fn five() -> u32 {
        5
    }

    #[derive(Serialize, Deserialize, JsonSchema)]
    #[serde(try_from = "u32")]
    struct Even(u32);

    impl TryFrom<u32> for Even {
        type Error = String;
        fn try_from(value: u32) -> Result<Self, String> {
            if value.is_multiple_of(2) { Ok(Self(value)) } else { Err(format!("{value} is odd; write an even number")) }
        }
    }

    struct Halves;

    impl Kind for Halves {
        type Params = Params;

        fn spec() -> KindSpec {
            KindSpec {
                name: "halves",
                summary: "A toy.",
                manual: "",
                mode: Mode::Source,
                inputs: vec![],
                outputs: vec![Out::<Files>::new(Group::main(3), "out", "Nothing.").port()],
                seeded: false,
            }
        }

        fn later() -> &'static [Later] {
            &[Later { pointer: "/factor", before: Before::Integer(1) }]
        }

        fn run(_: &Context<'_>, action: &Action<'_, Params>) -> Result<Outputs, KindError> {
            // Its inputs, as shown by its outcome.
            Err(KindError::Input(action.params.factor.to_string()))
        }
    }

    #[test]
    fn a_param_that_came_later_is_left_out_of_keys_and_acts_as_before() {
        let row = KindRow::<Halves>::new();
        for (given, key) in [(json!(1), json!({ "list": [] })), (json!(5), json!({ "list": [], "factor": 5 }))] {
            let resolved = row.resolve(&json!({ "factor": given })).expect("fine");
            let read = row.projection(&resolved)(None, "main");
            assert_eq!(read, key);
            assert_eq!(row.keyed(&resolved), key, "for lanes and shards, too");
            let (blobs, stop) = (crate::MemoryBlobs::default(), std::sync::atomic::AtomicBool::new(false));
            let ctx = Context::new(&blobs, &crate::Silent, &stop);
            let action = Action {
                params: read,
                item: None,
                group: "main",
                seed: 0,
                each: BTreeMap::new(),
                all: BTreeMap::new(),
            };
            assert_eq!(row.run(&ctx, &action).expect_err("always").to_string(), given.to_string());
        }
    }

    #[test]
    fn a_value_that_its_type_refuses_is_a_problem_at_its_place() {
        let row = KindRow::<Halves>::new();
        let problems = row.resolve(&json!({ "list": [2, 3] })).expect_err("an odd number");
        assert_eq!((problems[0].pointer.as_str(), problems.len()), ("/list/1", 1));
        assert!(problems[0].message.contains("3 is odd"), "{problems:?}");
        assert_eq!(row.resolve(&json!({ "list": [2] })).expect("even"), json!({ "list": [2], "factor": 5 }));
        assert_eq!(row.spec().groups(), [Group::main(3)]);
    }
}
