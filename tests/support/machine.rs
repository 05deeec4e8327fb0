//! A toy kind that depends on the machine: on what a file says, and on who runs beside it.

use super::super::media::Number;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{
    collections::HashMap,
    path::PathBuf,
    sync::{LazyLock, Mutex},
    time::Duration,
};
use tauflow_contract::{
    Action, Context, Each, Group, Kind, KindError, KindSpec, Media, Mode, Out, Outputs, Probe, Stored,
};

const IN: Each<Number> = Each::new("in", "Anything.");
const OUT: Out<Number> = Out::new(Group::main(1), "out", "What the file says.").local();
const CLOCKED: Out<Number> = Out::new(Group::new("clock", 1), "clocked", "Who ran beside it.").measured();

/// How many actions run, and the most that ever ran beside one that measures, for each file.
static RUNNING: LazyLock<Mutex<HashMap<PathBuf, i64>>> = LazyLock::new(Mutex::default);

/// Params of `sited`.
#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct SitedParams {
    /// What stands for the machine.
    site: PathBuf,
}

/// Map: `out` is what the file says, and belongs to the machine; `clocked` is a measurement: how many actions ran with
/// it.
pub struct Sited;

impl Kind for Sited {
    type Params = SitedParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "sited",
            summary: "A toy.",
            manual: "",
            mode: Mode::Map,
            inputs: vec![IN.port()],
            outputs: vec![OUT.port(), CLOCKED.port()],
            seeded: false,
        }
    }

    fn environment(params: &Self::Params, _group: &str, _probe: &dyn Probe) -> Option<Value> {
        Some(json!({ "site": std::fs::read_to_string(&params.site).unwrap_or_default() }))
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let site = &action.params.site;
        let count = |by: i64| {
            let mut running = RUNNING.lock().expect("no holder panics");
            let of = running.entry(site.clone()).or_default();
            *of += by;
            *of
        };
        let before = count(1);
        std::thread::sleep(Duration::from_millis(4));
        let after = count(0);
        count(-1);
        if action.group == "clock" {
            return Ok(Outputs::default().put(CLOCKED, Number::of(before.max(after)).store(ctx)?));
        }
        let text = std::fs::read(site).map_err(|e| KindError::Environment(e.to_string()))?;
        Ok(Outputs::default().put(OUT, Stored::blob(ctx.put(&text)?)))
    }
}
