//! A toy that takes its process with it, as a library that crashes does.

use super::{GIVEN, IN, Mode, number, read, spec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{fs, path::PathBuf, process};
use tauflow_contract::{Action, Context, Kind, KindError, KindSpec, Outputs};

/// Params of `deadly`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct DeadlyParams {
    /// These inputs end the process.
    on: Vec<i64>,
    /// Only where there is no such file, which is made then.
    once: Option<PathBuf>,
}

/// Map: its input, if it survives that.
pub struct Deadly;

impl Kind for Deadly {
    type Params = DeadlyParams;

    fn spec() -> KindSpec {
        spec("deadly", Mode::Map, vec![IN.port()], vec![GIVEN.port()])
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let value = read(ctx, action)?;
        let DeadlyParams { on, once } = &action.params;
        if on.contains(&value) && once.as_ref().is_none_or(|path| fs::File::create_new(path).is_ok()) {
            process::abort();
        }
        number(ctx, GIVEN, value)
    }
}
