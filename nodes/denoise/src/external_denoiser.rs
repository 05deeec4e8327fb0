#![doc = include_str!("external_denoiser.md")]

use crate::{
    command::{self, Places},
    oidn::{self, Filter},
    timed::{self, Conditioning, TIMING},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::{
    Action, Context, InputPort, ItemKey, Kind, KindError, KindSpec, Mode, OutputPort, Outputs, ParamProblem,
};
use tauflow_data::{
    Image,
    formats::{JSON, PACKED, REFINED},
    image_io::{read_exr, write_exr},
    timing::{Timing, machine},
};

/// The kind `external_denoiser`.
pub struct ExternalDenoiser;

/// Params of `external_denoiser`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExternalDenoiserParams {
    /// Its name in tables.
    pub method: String,
    /// What it sees beside the endpoint.
    pub conditioning: Conditioning,
    /// Sample count of the endpoint to denoise.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// Path or name of the Open Image Denoise library; none for what TAUFLOW_OIDN names, or the system has.
    pub library: Option<String>,
    /// Words of a program's command line in place of the library, with {color}, {albedo}, {normal} and {output} for EXR files.
    pub command: Vec<String>,
    /// True if it is an error that the library is missing; else the method is left out with a note.
    pub required: bool,
    /// Times that `timing` measures it.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for ExternalDenoiserParams {
    fn default() -> Self {
        Self {
            method: "oidn".into(),
            conditioning: Conditioning::Gbuffer,
            from: 1,
            library: None,
            command: Vec::new(),
            required: false,
            repeats: 5,
        }
    }
}

const INPUTS: &[InputPort] = &[
    InputPort::each("endpoints", PACKED, "The scenes whose endpoints are denoised."),
    InputPort::each("after", "*", "What must be there before `timing` measures, so that methods take turns.").or_none(),
];
const OUTPUTS: &[OutputPort] = &[
    OutputPort::new("refined", REFINED, "The denoised image; none where the library is missing.").local(),
    OutputPort::new("timing", JSON, "How long it takes, on all cores.").in_group(TIMING).measured(),
];

impl Kind for ExternalDenoiser {
    type Params = ExternalDenoiserParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "external_denoiser",
            version: 2,
            summary: "Denoises endpoints with Open Image Denoise, or any program, to compare with.",
            manual: include_str!("external_denoiser.md"),
            mode: Mode::Map,
            inputs: INPUTS,
            outputs: OUTPUTS,
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        if params.method.trim().is_empty() {
            out.push(ParamProblem::new("/method", "the method has no name", "write for example `method: oidn`"));
        }
        if !params.command.is_empty()
            && let Some(problem) = PLACES.problem(&params.command)
        {
            let hint = "write for example `command: [denoise, \"{color}\", \"{albedo}\", \"{normal}\", \"{output}\"]`";
            out.push(ParamProblem::new("/command", problem, hint));
        }
        if !params.command.is_empty() && params.library.is_some() {
            let hint = "leave one of them away";
            out.push(ParamProblem::new("/library", "there are both a `library` and a `command`", hint));
        }
        out
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        timed::projected(params, group)
    }

    fn environment(params: &Self::Params, _group: &str) -> Value {
        let version = match params.command.is_empty() {
            // One that cannot be loaded is told by the action.
            true => oidn::find(params.library.as_deref()).ok().flatten().map(|oidn| oidn.version),
            false => None,
        };
        json!({ "oidn": version, "program": command::identity(&params.command), "machine": machine() })
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let scene = timed::scene(ctx, action)?;
        let color = timed::endpoint(&scene, params.from)?;
        let gbuffer = timed::gbuffer(&scene, params.conditioning)?;
        let said = timed::said(&params.method, &scene, params.from);
        if !params.command.is_empty() {
            return match action.group {
                TIMING => timed::timing(ctx, &said, params.repeats, || {
                    Ok(Some(by_program(&params.command, color, gbuffer)?.1))
                }),
                _ => timed::refined(ctx, vec![(said, by_program(&params.command, color, gbuffer)?.0)], None),
            };
        }
        let size = (color.width(), color.height());
        match (oidn::find(params.library.as_deref())?, action.group) {
            (Some(oidn), TIMING) => {
                let mut filter = Filter::new(&oidn, gbuffer, size, 0)?;
                timed::timing(ctx, &said, params.repeats, || filter.run(color).map(|_| None))
            }
            (Some(oidn), _) => {
                let image = Filter::new(&oidn, gbuffer, size, 1)?.run(color)?;
                timed::refined(ctx, vec![(said, image)], None)
            }
            (None, _) if params.required => Err(KindError::Environment(format!("{MISSING}; or say `required: false`"))),
            (None, TIMING) => timed::timings(ctx, &Timing { entries: Vec::new() }),
            (None, _) => timed::refined(ctx, Vec::new(), Some(format!("{}: {MISSING}", params.method))),
        }
    }
}

/// What is said where there is no library.
const MISSING: &str = "there is no Open Image Denoise library here; install it (the wheel `pyoidn` has one) and name it with \
                       `library` or TAUFLOW_OIDN";

/// What may stand in a command: EXR files.
const PLACES: Places = Places {
    what: "denoiser",
    all: &["{color}", "{albedo}", "{normal}", "{output}"],
    needed: &["{color}", "{output}"],
};

/// The image that a program makes of an image [H, W, 3], and the seconds that it took, of wall and processor time.
///
/// # Errors
/// If it cannot be started, fails, or writes no image of the same size.
fn by_program(template: &[String], color: &Image, gbuffer: Option<&Image>) -> Result<(Image, [f64; 2]), KindError> {
    let failed = |what: String| PLACES.failed(template, &what);
    let folder = tempfile::tempdir().map_err(|e| failed(format!("got no folder for its images: {e}")))?;
    let path = |name: &str| folder.path().join(name);
    write_exr(&path("color.exr"), &[("", color)])?;
    if let Some(gbuffer) = gbuffer {
        for (name, first) in [("albedo.exr", 0), ("normal.exr", 3)] {
            let part = gbuffer.data().chunks_exact(6).flat_map(|pixel| pixel[first..first + 3].iter().copied());
            let image = Image::from_data(gbuffer.width(), gbuffer.height(), 3, part.collect())?;
            write_exr(&path(name), &[("", &image)])?;
        }
    }
    let file = |place: &&'static str| {
        let name = format!("{}.exr", place.trim_matches(['{', '}']));
        (*place, path(&name).to_string_lossy().into_owned())
    };
    let seconds = PLACES.run(template, &PLACES.all.iter().map(file).collect::<Vec<_>>())?;
    let layers = read_exr(&path("output.exr")).map_err(|e| failed(format!("left no image that can be read: {e}")))?;
    // The layer without a name comes first.
    let image = layers.into_values().next().ok_or_else(|| failed("left an image without channels".into()))?;
    if !image.same_shape(color) {
        let shape = |i: &Image| format!("{} x {} pixels of {} values", i.width(), i.height(), i.channels());
        return Err(failed(format!("made {} of {}", shape(&image), shape(color))));
    }
    Ok((image, seconds))
}
