//! Toy kinds on whole numbers: every sort of node that the engine knows, and some that misbehave.

#[path = "machine.rs"]
mod machine;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    path::PathBuf,
    sync::atomic::{AtomicU64, Ordering},
};
use tauflow::kinds::Registry;
use tauflow_contract::{
    Action, Artifact, Collection, Context, InputPort, ItemKey, Kind, KindError, KindRow, KindSpec, MemoKey, Mode,
    OutputPort, Outputs, ParamProblem, SourceItem,
};

const NUMBER: &str = "toy/number";
const TEXT: &str = "toy/text";

/// Every toy kind.
pub fn registry() -> Registry {
    Registry::new([
        Box::new(KindRow::<Numbers>::new()) as Box<dyn tauflow_contract::NodeKind>,
        Box::new(KindRow::<Files>::new()),
        Box::new(KindRow::<Affine>::new()),
        Box::new(KindRow::<Round>::new()),
        Box::new(KindRow::<Below>::new()),
        Box::new(KindRow::<Pair>::new()),
        Box::new(KindRow::<Total>::new()),
        Box::new(KindRow::<Shares>::new()),
        Box::new(KindRow::<Unsteady>::new()),
        Box::new(KindRow::<Drawn>::new()),
        Box::new(KindRow::<machine::Sited>::new()),
    ])
}

const fn spec(
    name: &'static str,
    mode: Mode,
    inputs: &'static [InputPort],
    outputs: &'static [OutputPort],
) -> KindSpec {
    KindSpec { name, version: 1, summary: "A toy.", manual: "", mode, inputs, outputs, seeded: false }
}

fn read(ctx: &Context<'_>, artifact: &Artifact) -> Result<i64, KindError> {
    let text = String::from_utf8_lossy(&ctx.part(artifact, "")?).trim().to_owned();
    text.parse().map_err(|_| KindError::Input(format!("`{text}` is no number; give digits")))
}

/// A number as a blob; `pad` makes it long, so that it gets a file of its own in the store.
fn number(ctx: &Context<'_>, value: i64, pad: usize) -> Result<Artifact, KindError> {
    Ok(Artifact::blob(NUMBER, ctx.put(format!("{value}{}", " ".repeat(pad)).as_bytes())?))
}

fn key(text: impl Into<String>) -> Result<ItemKey, KindError> {
    ItemKey::new(text).map_err(|e| KindError::Input(e.to_string()))
}

/// Params of `numbers`.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NumbersParams {
    /// How many.
    #[schemars(range(min = 0, max = 100000))]
    count: u64,
    /// Added to each.
    offset: i64,
    /// Items that are one more than they would be.
    raised: Vec<u64>,
    /// Milliseconds that each takes.
    nap_ms: u64,
}

impl Default for NumbersParams {
    fn default() -> Self {
        Self { count: 4, offset: 0, raised: Vec::new(), nap_ms: 0 }
    }
}

/// Source: item `n000i` holds 10 i + offset.
pub struct Numbers;

impl Kind for Numbers {
    type Params = NumbersParams;

    fn spec() -> KindSpec {
        spec("numbers", Mode::Source, &[], const { &[OutputPort::new("out", NUMBER, "The number.")] })
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        (0..params.count).map(|i| Ok(SourceItem { key: key(format!("n{i:04}"))?, files: Vec::new() })).collect()
    }

    fn project(params: &Self::Params, item: Option<&ItemKey>, _group: &str) -> Value {
        // The number itself stands in for the item, so that how many there are does not matter.
        let number = item.and_then(|i| i.as_str()[1..].parse::<u64>().ok());
        let raised: Vec<u64> = params.raised.iter().copied().filter(|n| Some(*n) == number).collect();
        json!({"count": number, "offset": params.offset, "raised": raised, "nap_ms": params.nap_ms})
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        std::thread::sleep(std::time::Duration::from_millis(action.params.nap_ms));
        let value = 10 * action.params.count as i64 + action.params.offset + action.params.raised.len() as i64;
        Ok(Outputs::default().item("out", number(ctx, value, 0)?))
    }
}

/// Params of `files`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct FilesParams {
    /// The folder.
    folder: PathBuf,
}

/// Source: one item for each file of a folder.
pub struct Files;

impl Kind for Files {
    type Params = FilesParams;

    fn spec() -> KindSpec {
        spec("files", Mode::Source, &[], const { &[OutputPort::new("out", NUMBER, "The number in the file.")] })
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        let io = |e: std::io::Error| KindError::Input(format!("cannot list `{}`: {e}", params.folder.display()));
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&params.folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            found.push(SourceItem { key: key(name)?, files: vec![("data".into(), entry.path())] });
        }
        Ok(found)
    }

    fn project(_params: &Self::Params, _item: Option<&ItemKey>, _group: &str) -> Value {
        json!({})
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let text = String::from_utf8_lossy(&ctx.part(action.each("file")?, "data")?).trim().to_owned();
        let item = action.item()?;
        let value =
            text.parse().map_err(|_| KindError::Input(format!("`{item}` holds `{text}`, which is no number")))?;
        Ok(Outputs::default().item("out", number(ctx, value, 0)?))
    }
}

/// Params of `affine`.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AffineParams {
    /// Factor.
    mul: i64,
    /// Summand.
    #[schemars(range(min = -1000, max = 1000))]
    add: i64,
    /// Inputs from this on fail.
    fail_from: Option<i64>,
    /// This input panics.
    panic_on: Option<i64>,
    /// Blanks after the number.
    pad: usize,
    /// How to round.
    rounding: Rounding,
    /// Nothing but a list.
    list: [u32; 2],
}

/// A choice.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Rounding {
    /// Not at all.
    #[default]
    Exact,
    /// To tens.
    Tens,
}

impl Default for AffineParams {
    fn default() -> Self {
        let (fail_from, panic_on) = (None, None);
        Self { mul: 1, add: 0, fail_from, panic_on, pad: 0, rounding: Rounding::Exact, list: [1, 2] }
    }
}

/// Map: mul * in + add; in a group of its own, its negative.
pub struct Affine;

impl Kind for Affine {
    type Params = AffineParams;

    fn spec() -> KindSpec {
        spec(
            "affine",
            Mode::Map,
            const { &[InputPort::each("in", NUMBER, "A number.")] },
            const {
                &[
                    OutputPort::new("out", NUMBER, "The result."),
                    OutputPort::new("negative", NUMBER, "Its negative.").in_group("negative"),
                ]
            },
        )
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut found = Vec::new();
        if params.mul == 0 {
            found.push(ParamProblem::new("/mul", "a factor of 0 makes all items alike", "give another factor"));
        }
        if params.list[0] > params.list[1] {
            found.push(ParamProblem::new("/list/1", "the list ends before it begins", "swap the two"));
        }
        found
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let value = read(ctx, action.each("in")?)?;
        if params.fail_from.is_some_and(|from| value >= from) {
            return Err(KindError::Input(format!("`{}` is too large; lower it", action.item()?)));
        }
        assert!(params.panic_on != Some(value), "the number {value} is unlucky");
        let result = params.mul * value + params.add;
        Ok(match action.group {
            "negative" => Outputs::default().item("negative", number(ctx, -result, params.pad)?),
            _ => Outputs::default().item("out", number(ctx, result, params.pad)?),
        })
    }
}

/// Params of `round`.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RoundParams {
    /// To multiples of this.
    #[schemars(range(min = 1))]
    to: i64,
}

impl Default for RoundParams {
    fn default() -> Self {
        Self { to: 10 }
    }
}

/// Map: rounds down.
pub struct Round;

impl Kind for Round {
    type Params = RoundParams;

    fn spec() -> KindSpec {
        spec(
            "round",
            Mode::Map,
            const { &[InputPort::each("in", NUMBER, "A number.")] },
            const { &[OutputPort::new("out", NUMBER, "The rounded number.")] },
        )
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let value = read(ctx, action.each("in")?)?;
        // Shared by all that round the same number, whatever else they read.
        let memo = MemoKey {
            name: "round/result".into(),
            version: 1,
            params: json!({"to": action.params.to, "value": value}),
            inputs: Vec::new(),
        };
        if let Some(known) = ctx.memo_get(&memo) {
            return Ok(Outputs::default().item("out", known));
        }
        let result = number(ctx, value.div_euclid(action.params.to) * action.params.to, 0)?;
        ctx.memo_put(&memo, &result)?;
        Ok(Outputs::default().item("out", result))
    }
}

/// Params of `below`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct BelowParams {
    /// The limit.
    limit: i64,
}

/// Filter: numbers below a limit on one port, the others on another.
pub struct Below;

impl Kind for Below {
    type Params = BelowParams;

    fn spec() -> KindSpec {
        spec(
            "below",
            Mode::Map,
            const { &[InputPort::each("in", NUMBER, "A number.")] },
            const {
                &[
                    OutputPort::new("kept", NUMBER, "Those below.").filtering(),
                    OutputPort::new("others", NUMBER, "The others.").filtering(),
                ]
            },
        )
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let artifact = action.each("in")?;
        let port = if read(ctx, artifact)? < action.params.limit { "kept" } else { "others" };
        Ok(Outputs::default().item(port, artifact.clone()))
    }
}

/// No params.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Nothing {}

/// Map over two inputs: their sum.
pub struct Pair;

impl Kind for Pair {
    type Params = Nothing;

    fn spec() -> KindSpec {
        let inputs =
            const { &[InputPort::each("left", NUMBER, "A number."), InputPort::each("right", NUMBER, "Another.")] };
        spec("pair", Mode::Map, inputs, const { &[OutputPort::new("out", NUMBER, "The sum.")] })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let sum = read(ctx, action.each("left")?)? + read(ctx, action.each("right")?)?;
        Ok(Outputs::default().item("out", number(ctx, sum, 0)?))
    }
}

/// Params of `total`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct TotalParams {
    /// Stands on the page.
    title: String,
}

/// Gather: the sum of all, and a page of it.
pub struct Total;

impl Kind for Total {
    type Params = TotalParams;

    fn spec() -> KindSpec {
        spec(
            "total",
            Mode::Gather,
            const { &[InputPort::whole("in", NUMBER, "All numbers.")] },
            const {
                &[
                    OutputPort::new("out", NUMBER, "The sum."),
                    OutputPort::new("page", TEXT, "A page.").in_group("page").published(),
                ]
            },
        )
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        if group == "page" { json!({"title": params.title}) } else { json!({}) }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let mut sum = 0;
        let mut names = Vec::new();
        for (item, artifact) in action.whole("in")?.iter() {
            sum += read(ctx, artifact)?;
            names.push(item.as_str());
        }
        let one = |artifact| -> Result<Collection, KindError> { Ok([(key("all")?, artifact)].into_iter().collect()) };
        if action.group == "page" {
            let text = format!("{}: {} = {sum}\n", action.params.title, names.join(" + "));
            let parts = [("page.txt".to_owned(), ctx.put(text.as_bytes())?)];
            return Ok(Outputs::default().collection("page", one(Artifact::tree(TEXT, parts))?));
        }
        Ok(Outputs::default().collection("out", one(number(ctx, sum, 0)?)?))
    }
}

/// Map with a whole input too: each item's share of the total, in percent.
pub struct Shares;

impl Kind for Shares {
    type Params = Nothing;

    fn spec() -> KindSpec {
        let inputs =
            const { &[InputPort::each("in", NUMBER, "A number."), InputPort::whole("of", NUMBER, "All.").or_none()] };
        spec("shares", Mode::Map, inputs, const { &[OutputPort::new("out", NUMBER, "The share.")] })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let mut of = 0;
        for artifact in action.whole.get("of").into_iter().flat_map(|c| c.items.values()) {
            of += read(ctx, artifact)?;
        }
        let value = read(ctx, action.each("in")?)?;
        Ok(Outputs::default().item("out", number(ctx, 100 * value / of.max(1), 0)?))
    }
}

static RUNS: AtomicU64 = AtomicU64::new(0);

/// Params of `unsteady`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct UnsteadyParams {
    /// It memoises what it gave.
    remembers: bool,
}

/// Map that gives something else each time.
pub struct Unsteady;

impl Kind for Unsteady {
    type Params = UnsteadyParams;

    fn spec() -> KindSpec {
        spec(
            "unsteady",
            Mode::Map,
            const { &[InputPort::each("in", NUMBER, "A number.")] },
            const {
                &[
                    OutputPort::new("out", NUMBER, "Whatever."),
                    OutputPort::new("time", NUMBER, "A measurement.").in_group("time").measured(),
                ]
            },
        )
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let port = if action.group == "time" { "time" } else { "out" };
        let inputs = vec![action.each("in")?.digest()];
        let memo = MemoKey { name: format!("unsteady/{port}"), version: 1, params: json!(null), inputs };
        if let Some(known) = ctx.memo_get(&memo).filter(|_| action.params.remembers) {
            return Ok(Outputs::default().item(port, known));
        }
        let result = number(ctx, RUNS.fetch_add(1, Ordering::Relaxed) as i64, 0)?;
        if action.params.remembers {
            ctx.memo_put(&memo, &result)?;
        }
        Ok(Outputs::default().item(port, result))
    }
}

/// Map that draws a number from its seed.
pub struct Drawn;

impl Kind for Drawn {
    type Params = Nothing;

    fn spec() -> KindSpec {
        KindSpec {
            seeded: true,
            ..spec(
                "drawn",
                Mode::Map,
                const { &[InputPort::each("in", NUMBER, "A number.")] },
                const { &[OutputPort::new("out", NUMBER, "The drawn number.")] },
            )
        }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        Ok(Outputs::default().item("out", number(ctx, (action.seed >> 40) as i64, 0)?))
    }
}
