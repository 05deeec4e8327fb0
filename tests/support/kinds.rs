//! Toy kinds on whole numbers: every sort of node that the engine knows, and some that misbehave.

#[path = "deadly.rs"]
mod deadly;
#[path = "fan.rs"]
mod fan;
#[path = "machine.rs"]
mod machine;
#[path = "unsteady.rs"]
mod unsteady;

use super::media::{Number, Text};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;
use tauflow::kinds::Registry;
use tauflow_contract::{
    Action, All, Basis, Context, Each, Group, Handle, InputPort, ItemKey, Items, Kind, KindError, KindRow, KindSpec,
    Media, MemoKey, Mode, Out, OutputPort, Outputs, ParamProblem, SourceItem,
};

/// What most toys make together.
const MAIN: Group = Group::main(1);
/// What most toys read.
const IN: Each<Number> = Each::new("in", "A number.");
/// All that some read.
const ALL: All<Number> = All::new("in", "All numbers.");

/// Every toy kind.
pub fn registry() -> Registry {
    Registry::new([
        Box::new(KindRow::<Numbers>::new()) as Box<dyn tauflow_contract::NodeKind>,
        Box::new(KindRow::<Listed>::new()),
        Box::new(KindRow::<Affine>::new()),
        Box::new(KindRow::<Round>::new()),
        Box::new(KindRow::<Below>::new()),
        Box::new(KindRow::<Pair>::new()),
        Box::new(KindRow::<Total>::new()),
        Box::new(KindRow::<Shares>::new()),
        Box::new(KindRow::<unsteady::Unsteady>::new()),
        Box::new(KindRow::<unsteady::Learned>::new()),
        Box::new(KindRow::<unsteady::Drawn>::new()),
        Box::new(KindRow::<machine::Sited>::new()),
        Box::new(KindRow::<deadly::Deadly>::new()),
        Box::new(KindRow::<fan::Fan>::new()),
    ])
}

fn spec(name: &'static str, mode: Mode, inputs: Vec<InputPort>, outputs: Vec<OutputPort>) -> KindSpec {
    KindSpec { name, summary: "A toy.", manual: "", mode, inputs, outputs, seeded: false }
}

/// The item on [`IN`].
fn read<P>(ctx: &Context<'_>, action: &Action<'_, P>) -> Result<i64, KindError> {
    Ok(action.read(ctx, IN)?.value)
}

/// A number on a port.
fn number(ctx: &Context<'_>, port: Out<Number>, value: i64) -> Result<Outputs, KindError> {
    padded(ctx, port, value, 0)
}

/// A number with blanks after it on a port.
fn padded(ctx: &Context<'_>, port: Out<Number>, value: i64, pad: usize) -> Result<Outputs, KindError> {
    Ok(Outputs::default().put(port, Number { value, pad }.store(ctx)?))
}

fn key(text: impl Into<String>) -> Result<ItemKey, KindError> {
    ItemKey::new(text).map_err(|e| KindError::Input(e.to_string()))
}

/// Params of `numbers`.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NumbersParams {
    /// How many.
    #[schemars(range(min = 0, max = 100_000))]
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

const GIVEN: Out<Number> = Out::new(MAIN, "out", "The number.");

/// Source: item `n000i` holds 10 i + offset.
pub struct Numbers;

impl Kind for Numbers {
    type Params = NumbersParams;

    fn spec() -> KindSpec {
        spec("numbers", Mode::Source, vec![], vec![GIVEN.port()])
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
        number(ctx, GIVEN, value)
    }
}

/// Params of `files`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct FilesParams {
    /// The folder.
    folder: PathBuf,
}

const IN_FILE: Out<Number> = Out::new(MAIN, "out", "The number in the file.");
/// The part that a file becomes.
const DATA: &str = "data";

/// Source: one item for each file of a folder.
pub struct Listed;

impl Kind for Listed {
    type Params = FilesParams;

    fn spec() -> KindSpec {
        spec("files", Mode::Source, vec![], vec![IN_FILE.port()])
    }

    fn items(params: &Self::Params) -> Result<Vec<SourceItem>, KindError> {
        let io = |e: std::io::Error| KindError::Input(format!("cannot list `{}`: {e}", params.folder.display()));
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&params.folder).map_err(io)? {
            let entry = entry.map_err(io)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            found.push(SourceItem { key: key(name)?, files: vec![(DATA.into(), entry.path())] });
        }
        Ok(found)
    }

    fn project(_params: &Self::Params, _item: Option<&ItemKey>, _group: &str) -> Value {
        json!({})
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let text = String::from_utf8_lossy(&ctx.part(action.files()?.artifact(), DATA)?).trim().to_owned();
        let item = action.item()?;
        let value =
            text.parse().map_err(|_| KindError::Input(format!("`{item}` holds `{text}`, which is no number")))?;
        number(ctx, IN_FILE, value)
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

const RESULT: Out<Number> = Out::new(MAIN, "out", "The result.");
const NEGATIVE: Out<Number> = Out::new(Group::new("negative", 1), "negative", "Its negative.");

/// Map: mul * in + add; in a group of its own, its negative.
pub struct Affine;

impl Kind for Affine {
    type Params = AffineParams;

    fn spec() -> KindSpec {
        let outputs = vec![RESULT.port(), NEGATIVE.port()];
        spec("affine", Mode::Map, vec![IN.port()], outputs)
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
        let value = read(ctx, action)?;
        if params.fail_from.is_some_and(|from| value >= from) {
            return Err(KindError::Input(format!("`{}` is too large; lower it", action.item()?)));
        }
        assert!(params.panic_on != Some(value), "the number {value} is unlucky");
        let result = params.mul * value + params.add;
        match action.group {
            "negative" => padded(ctx, NEGATIVE, -result, params.pad),
            _ => padded(ctx, RESULT, result, params.pad),
        }
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

const ROUNDED: Out<Number> = Out::new(MAIN, "out", "The rounded number.");

/// Map: rounds down.
pub struct Round;

impl Kind for Round {
    type Params = RoundParams;

    fn spec() -> KindSpec {
        spec("round", Mode::Map, vec![IN.port()], vec![ROUNDED.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let value = read(ctx, action)?;
        // Shared by all that round the same number, whatever else they read.
        let params = json!({"to": action.params.to, "value": value});
        let memo = MemoKey { basis: Basis::new("round", 1, "result").with(params, None), inputs: Vec::new() };
        if let Some(known) = ctx.memo_get(&memo) {
            return Ok(Outputs::default().put(ROUNDED, Handle::new(&known)?.to_stored()));
        }
        let result = Number::of(value.div_euclid(action.params.to) * action.params.to).store(ctx)?;
        ctx.memo_put(&memo, result.artifact())?;
        Ok(Outputs::default().put(ROUNDED, result))
    }
}

/// Params of `below`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct BelowParams {
    /// The limit.
    limit: i64,
}

const KEPT: Out<Number> = Out::new(MAIN, "kept", "Those below.").filtering();
const OTHERS: Out<Number> = Out::new(MAIN, "others", "The others.").filtering();

/// Filter: numbers below a limit on one port, the others on another.
pub struct Below;

impl Kind for Below {
    type Params = BelowParams;

    fn spec() -> KindSpec {
        spec("below", Mode::Map, vec![IN.port()], vec![KEPT.port(), OTHERS.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let port = if read(ctx, action)? < action.params.limit { KEPT } else { OTHERS };
        Ok(Outputs::default().put(port, action.handle(IN)?.to_stored()))
    }
}

/// No params.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Nothing {}

const LEFT: Each<Number> = Each::new("left", "A number.");
const RIGHT: Each<Number> = Each::new("right", "Another.");
const PAIR_SUM: Out<Number> = Out::new(MAIN, "out", "The sum.");

/// Map over two inputs: their sum.
pub struct Pair;

impl Kind for Pair {
    type Params = Nothing;

    fn spec() -> KindSpec {
        spec("pair", Mode::Map, vec![LEFT.port(), RIGHT.port()], vec![PAIR_SUM.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        number(ctx, PAIR_SUM, action.read(ctx, LEFT)?.value + action.read(ctx, RIGHT)?.value)
    }
}

/// Params of `total`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct TotalParams {
    /// Stands on the page.
    title: String,
}

const SUM: Out<Number> = Out::new(MAIN, "out", "The sum.");
const PAGE: Out<Text> = Out::new(Group::new("page", 1), "page", "A page.").published();

/// Gather: the sum of all, and a page of it.
pub struct Total;

impl Kind for Total {
    type Params = TotalParams;

    fn spec() -> KindSpec {
        spec("total", Mode::Gather, vec![ALL.port()], vec![SUM.port(), PAGE.port()])
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        if group == "page" { json!({"title": params.title}) } else { json!({}) }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let mut sum = 0;
        let mut names = Vec::new();
        for (item, number) in action.all(ALL)?.iter() {
            sum += number.load(ctx)?.value;
            names.push(item.as_str());
        }
        if action.group == "page" {
            let text = Text(format!("{}: {} = {sum}\n", action.params.title, names.join(" + ")));
            return Outputs::default().put_one(PAGE, "all", text.store(ctx)?);
        }
        Outputs::default().put_one(SUM, "all", Number::of(sum).store(ctx)?)
    }
}

const OF: All<Number> = All::new("of", "All.").or_none();
const SHARE: Out<Number> = Out::new(MAIN, "out", "The share.");

/// Map with a collection as input, too: each item's share of the total, in percent.
pub struct Shares;

impl Kind for Shares {
    type Params = Nothing;

    fn spec() -> KindSpec {
        spec("shares", Mode::Map, vec![IN.port(), OF.port()], vec![SHARE.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let mut of = 0;
        for (_, number) in action.all_if(OF)?.into_iter().flat_map(Items::iter) {
            of += number.load(ctx)?.value;
        }
        number(ctx, SHARE, 100 * read(ctx, action)? / of.max(1))
    }
}
