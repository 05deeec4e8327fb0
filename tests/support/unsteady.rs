//! Toy kinds whose outputs are not decided by what they read: one that gives something else each time, and one that
//! draws.

use super::{super::media::Number, ALL, IN, MAIN, Nothing, number, spec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};
use tauflow_contract::{
    Action, Basis, Context, Group, Handle, Kind, KindError, KindSpec, Media, MemoKey, Mode, Out, Outputs,
};

/// Far from other numbers of tests, because actions on equal inputs are one action.
static RUNS: AtomicU64 = AtomicU64::new(1000);

/// Params of `unsteady`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct UnsteadyParams {
    /// It memoises what it gave.
    remembers: bool,
}

const WHATEVER: Out<Number> = Out::new(MAIN, "out", "Whatever.");
const TIME: Out<Number> = Out::new(Group::new("time", 1), "time", "A measurement.").measured();

/// Map that gives something else each time.
pub struct Unsteady;

impl Kind for Unsteady {
    type Params = UnsteadyParams;

    fn spec() -> KindSpec {
        spec("unsteady", Mode::Map, vec![IN.port()], vec![WHATEVER.port(), TIME.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let port = if action.group == "time" { TIME } else { WHATEVER };
        let inputs = vec![action.handle(IN)?.artifact().digest()];
        let memo = MemoKey { basis: Basis::new("unsteady", 1, port.name()), inputs };
        if let Some(known) = ctx.memo_get(&memo).filter(|_| action.params.remembers) {
            return Ok(Outputs::default().put(port, Handle::new(&known)?.to_stored()));
        }
        let result = Number::of(RUNS.fetch_add(1, Ordering::Relaxed) as i64).store(ctx)?;
        if action.params.remembers {
            ctx.memo_put(&memo, result.artifact())?;
        }
        Ok(Outputs::default().put(port, result))
    }
}

const DRAWN: Out<Number> = Out::new(MAIN, "out", "The drawn number.");

/// Map that draws a number from its seed.
pub struct Drawn;

impl Kind for Drawn {
    type Params = Nothing;

    fn spec() -> KindSpec {
        KindSpec { seeded: true, ..spec("drawn", Mode::Map, vec![IN.port()], vec![DRAWN.port()]) }
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        number(ctx, DRAWN, (action.seed >> 40) as i64)
    }
}

const LEARNED: Out<Number> = Out::new(MAIN, "out", "The same each time.");
const TOOK: Out<Number> = Out::new(MAIN, "took", "A measurement, made together with it.").measured();

/// Gather that measures while it makes something else, as a training does.
pub struct Learned;

impl Kind for Learned {
    type Params = Nothing;

    fn spec() -> KindSpec {
        spec("learned", Mode::Gather, vec![ALL.port()], vec![LEARNED.port(), TOOK.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let count = action.all(ALL)?.iter().count() as i64;
        let took = Number::of(RUNS.fetch_add(1, Ordering::Relaxed) as i64).store(ctx)?;
        Outputs::default().put_one(LEARNED, "all", Number::of(count).store(ctx)?)?.put_one(TOOK, "all", took)
    }
}
