#![doc = include_str!("external_denoiser.md")]

use crate::{
    command::{self, Places, Surroundings},
    endpoint::{self, Endpoint},
    oidn::{self, Buffers, Features, Filter, Oidn, Quality, Settings},
    oidn_files,
    process::{Ran, keyed_variables},
    timed::{self, AFTER, TIMING},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tauflow_contract::{
    Action, Before, Context, Each, Facts, Group, ItemKey, Kind, KindError, KindSpec, Known, Later, Media, Mode, Out,
    Outlook, Outputs, ParamProblem, Probe, Resources, Seen,
};
use tauflow_data::{
    Image,
    image_io::{read_exr, write_exr},
    methods::{Conditioning, MethodName, OIDN},
    records::{PackedScene, Refined, Timing},
    timing::measuring,
    views::{View, Views},
};

/// The kind `external_denoiser`.
pub struct ExternalDenoiser;

/// Params of `external_denoiser`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExternalDenoiserParams {
    /// Name of the method in tables.
    pub method: MethodName,
    /// Additional input of the denoiser; the G-buffer by default.
    pub conditioning: Conditioning,
    /// Sample count of the endpoint to denoise.
    #[schemars(range(min = 1))]
    pub from: u64,
    /// What the library is told of the G-buffer.
    pub features: Features,
    /// Quality mode of the library.
    pub quality: Quality,
    /// Number of mirrored and rotated copies over which the library's result is averaged: 1, 2 (mirrored), 4 (also
    /// upside down) or 8 (also transposed).
    pub mirrors: Views,
    /// Path or name of the Open Image Denoise library. Default: TAUFLOW_OIDN, or the system's library.
    pub library: Option<String>,
    /// Command line of a program that replaces the library, as a list of words; {color}, {albedo}, {normal} and
    /// {output} are EXR files.
    pub command: Vec<String>,
    /// Files, directories and patterns such as `models/*.pt` that the program depends on, in addition to traced files.
    /// Their contents are part of the keys.
    pub depends: Vec<String>,
    /// Command that prints the version of the program, as a list of words. Its output is part of the keys.
    pub version: Vec<String>,
    /// Additional environment variables that the program inherits. Their values are part of the keys.
    pub variables: Vec<String>,
    /// Fail if the library is missing, instead of omitting the method with a note.
    pub required: bool,
    /// Number of measurements by `timing`.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for ExternalDenoiserParams {
    fn default() -> Self {
        Self {
            method: MethodName::new(OIDN).expect("letters"),
            conditioning: Conditioning::Gbuffer,
            from: 1,
            features: Features::default(),
            quality: Quality::default(),
            mirrors: Views::ONE,
            library: None,
            command: Vec::new(),
            depends: Vec::new(),
            version: Vec::new(),
            variables: Vec::new(),
            required: false,
            repeats: 5,
        }
    }
}

const ENDPOINTS: Each<PackedScene> = Each::new("endpoints", "The scenes whose endpoints are denoised.");
const MAIN: Group = Group::main(3);
const TIMED: Group = Group::new(TIMING, 4);
const REFINED: Out<Refined> = Out::new(MAIN, "refined", "The denoised image; none if the library is missing.").local();
const TIMES: Out<Timing> = Out::new(TIMED, "timing", "Wall time on all cores.").measured();

impl Kind for ExternalDenoiser {
    type Params = ExternalDenoiserParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "external_denoiser",
            summary: "Denoises endpoints with Open Image Denoise or any program, as a baseline.",
            manual: include_str!("external_denoiser.md"),
            mode: Mode::Map,
            inputs: vec![ENDPOINTS.port(), AFTER.port()],
            outputs: vec![REFINED.port(), TIMES.port()],
            seeded: false,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let mut out = Vec::new();
        if !params.command.is_empty()
            && let Some(problem) = PLACES.problem(&params.command)
        {
            let hint = "write for example `command: [denoise, \"{color}\", \"{albedo}\", \"{normal}\", \"{output}\"]`";
            out.push(ParamProblem::new("/command", problem, hint));
        }
        let features = ["{albedo}", "{normal}"];
        if params.conditioning == Conditioning::Rgb
            && let Some(place) = features.iter().find(|place| params.command.iter().any(|word| word.contains(**place)))
        {
            let message = format!("`conditioning: rgb` has no file `{place}`");
            out.push(ParamProblem::new(
                "/command",
                message,
                "omit it, use `conditioning: gbuffer`, or write a node for each conditioning",
            ));
        }
        if !params.command.is_empty() && params.library.is_some() {
            let hint = "omit one of them";
            out.push(ParamProblem::new("/library", "both `library` and `command` are set", hint));
        }
        let plain = (Features::default(), Quality::default(), Views::ONE);
        if !params.command.is_empty() && (params.features, params.quality, params.mirrors) != plain {
            let message = "`features`, `quality` and `mirrors` are settings of the library, and `command` is set";
            out.push(ParamProblem::new("/command", message, "omit these, or `command`"));
        }
        for (pointer, words) in
            [("/depends", &params.depends), ("/version", &params.version), ("/variables", &params.variables)]
        {
            if params.command.is_empty() && !words.is_empty() {
                let message = format!("`{}` is set without `command`", &pointer[1..]);
                out.push(ParamProblem::new(pointer, message, "set `command`, or omit it"));
            }
        }
        out
    }

    fn foresee(params: &Self::Params, known: &Known) -> Outlook {
        let (facts, problems) = endpoint::foresee(known, ENDPOINTS, params.from, params.conditioning);
        // Without the library there may be no image.
        let sure = !params.command.is_empty() || params.required;
        Outlook::default().with(REFINED, if sure { facts } else { Facts::default() }).but(problems)
    }

    fn missing(params: &Self::Params) -> Vec<ParamProblem> {
        if !params.command.is_empty() {
            return command::missing(&params.command, "/command", &params.depends);
        }
        let named = oidn_files::named(params.library.as_deref());
        if oidn_files::locate(named.as_deref()).is_some() {
            return Vec::new();
        }
        // One that is named must be there.
        let (pointer, message) = match (&params.library, params.required) {
            (Some(library), _) => ("/library", format!("there is no library `{library}` here")),
            (None, true) => ("/required", "there is no Open Image Denoise library here".to_owned()),
            (None, false) => return Vec::new(),
        };
        let hint = "install it, and name it with `library` or TAUFLOW_OIDN; or omit `library` and `required`";
        vec![ParamProblem::new(pointer, message, hint)]
    }

    fn project(params: &Self::Params, _item: Option<&ItemKey>, group: &str) -> Value {
        timed::projected(params, group)
    }

    fn resources(_params: &Self::Params, _group: &str) -> Resources {
        Resources::default().cores(2).memory(2 << 30)
    }

    fn sort(params: &Self::Params) -> String {
        params.command.join(" ")
    }

    fn later() -> &'static [Later] {
        // An empty list of words.
        const NONE: Before = Before::Integers(&[]);
        &[
            Later { pointer: "/depends", before: NONE },
            Later { pointer: "/version", before: NONE },
            Later { pointer: "/variables", before: NONE },
            Later { pointer: "/features", before: Before::Text("clean") },
            Later { pointer: "/quality", before: Before::Text("high") },
            Later { pointer: "/mirrors", before: Before::Integer(1) },
        ]
    }

    fn runs_programs(params: &Self::Params) -> bool {
        !params.command.is_empty()
    }

    fn environment(params: &Self::Params, _group: &str, probe: &dyn Probe) -> Option<Value> {
        let library = match params.command.is_empty() {
            // One that cannot be loaded is told by the action.
            true => oidn_files::identity(params.library.as_deref()),
            false => Value::Null,
        };
        let mut found =
            json!({ "oidn": library, "program": command::identity(&params.command), "machine": measuring(probe) });
        if !params.command.is_empty() {
            found["variables"] = json!(keyed_variables(&params.variables));
        }
        if !params.depends.is_empty() {
            found["depends"] = json!(command::depended(&params.depends));
        }
        if !params.version.is_empty() {
            found["version"] = command::probed_version(&params.version, probe)?;
        }
        Some(found)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        command::check_depends(&params.depends)?;
        command::version(&params.version).map_err(KindError::Environment)?;
        let scene = action.read(ctx, ENDPOINTS)?;
        let endpoint = Endpoint::of(&scene, &params.method, params.from, params.conditioning)?;
        let library = match params.command.is_empty() {
            true => oidn::find(params.library.as_deref())?,
            false => None,
        };
        let denoiser = match (&library, params.command.is_empty()) {
            (_, false) => Some(Denoiser::Program(params)),
            (Some(library), true) => Some(Denoiser::Library(library, params)),
            (None, true) if params.required => {
                return Err(KindError::Environment(format!("{MISSING}; or say `required: false`")));
            }
            (None, true) => None,
        };
        match (action.group, denoiser) {
            (TIMING, None) => Ok(Outputs::default().put(TIMES, timed::nothing().store(ctx)?)),
            (TIMING, Some(denoiser)) => {
                let (timing, seen) = denoiser.times(ctx, &endpoint, params.repeats)?;
                Ok(Outputs { seen, ..Outputs::default() }.put(TIMES, timing.store(ctx)?))
            }
            (_, denoiser) => {
                let (refined, seen) = match denoiser {
                    Some(denoiser) => denoiser.refine(ctx, endpoint)?,
                    None => {
                        let note = Some(format!("{}: {MISSING}", params.method.as_str()));
                        (Refined { note, ..Refined::default() }, None)
                    }
                };
                Ok(Outputs { seen, ..Outputs::default() }.put(REFINED, refined.store(ctx)?))
            }
        }
    }
}

/// The denoiser.
enum Denoiser<'a> {
    Program(&'a ExternalDenoiserParams),
    Library(&'a Oidn, &'a ExternalDenoiserParams),
}

impl Denoiser<'_> {
    fn refine(&self, ctx: &Context<'_>, endpoint: Endpoint<'_>) -> Result<(Refined, Option<Seen>), KindError> {
        let Endpoint { color, gbuffer, said, sampler } = endpoint;
        let (image, seen) = match self {
            Self::Program(params) => {
                let (image, ran) = by_program(ctx, params, (color, gbuffer), true)?;
                (image, ran.seen)
            }
            Self::Library(oidn, params) => (averaged(&mut filters(oidn, params, (color, gbuffer), 1)?)?, None),
        };
        Ok((Refined { images: vec![(said, image)], note: None, sampler }, seen))
    }

    /// The library's filters are made once, and timed by themselves on all cores; a program is timed whole. The
    /// files that a program looks at are noted in the warm-up, whose time does not count.
    fn times(
        &self,
        ctx: &Context<'_>,
        endpoint: &Endpoint<'_>,
        repeats: u64,
    ) -> Result<(Timing, Option<Seen>), KindError> {
        let Endpoint { color, gbuffer, said, .. } = endpoint;
        match self {
            Self::Program(params) => {
                let mut seen = None;
                let timing = timed::timing(ctx, said, repeats, || {
                    let ran = by_program(ctx, params, (color, *gbuffer), seen.is_none())?.1;
                    seen = seen.take().or(ran.seen);
                    Ok(Some(ran.seconds))
                })?;
                Ok((timing, seen))
            }
            Self::Library(oidn, params) => {
                let mut filters = filters(oidn, params, (color, *gbuffer), 0)?;
                Ok((timed::timing(ctx, said, repeats, || averaged(&mut filters).map(|_| None))?, None))
            }
        }
    }
}

/// The library's filters for an image [H, W, 3] with its G-buffer, one per view.
fn filters<'a>(
    oidn: &'a Oidn,
    params: &ExternalDenoiserParams,
    (color, gbuffer): (&Image, Option<&Image>),
    threads: usize,
) -> Result<Vec<(View, Filter<'a>)>, KindError> {
    let settings = Settings { quality: params.quality, features: params.features };
    let one = |view: View| {
        let gbuffer = gbuffer.map(|gbuffer| view.gbuffer(gbuffer)).transpose()?;
        let buffers = Buffers::new(&view.image(color)?, gbuffer.as_ref())?;
        Ok((view, Filter::new(oidn, buffers, threads, settings)?))
    };
    params.mirrors.all().map(one).collect()
}

/// The mean of what they make, each turned back.
fn averaged(filters: &mut [(View, Filter<'_>)]) -> Result<Image, KindError> {
    let share = 1.0 / filters.len() as f32;
    let mut sum: Option<Image> = None;
    for (view, filter) in filters {
        let made = view.inverse().image(&filter.run()?)?;
        match &mut sum {
            None => sum = Some(made),
            Some(sum) => sum.data_mut().iter_mut().zip(made.data()).for_each(|(sum, made)| *sum += made),
        }
    }
    let sum = sum.ok_or_else(|| KindError::Internal("no view of an image".into()))?;
    Ok(sum.map(|value| value * share))
}

/// The message if there is no library.
const MISSING: &str = "there is no Open Image Denoise library here; install it (the wheel `pyoidn` has one) and name \
                       it with `library` or TAUFLOW_OIDN";

/// Placeholders of a command: EXR files.
const PLACES: Places = Places {
    what: "denoiser",
    all: &["{color}", "{albedo}", "{normal}", "{output}"],
    needed: &["{color}", "{output}"],
};

/// The image that a program makes of an image [H, W, 3] with its G-buffer, and how it ran.
///
/// # Errors
/// If it cannot be started, fails, or writes no image of the same size.
fn by_program(
    ctx: &Context<'_>,
    params: &ExternalDenoiserParams,
    (color, gbuffer): (&Image, Option<&Image>),
    trace: bool,
) -> Result<(Image, Ran), KindError> {
    let template = &params.command;
    let failed = |what: String| PLACES.failed(template, &what);
    let folder = tempfile::tempdir().map_err(|e| failed(format!("got no folder for its images: {e}")))?;
    let path = |name: &str| folder.path().join(name);
    write_exr(&path("color.exr"), &[("", color)])?;
    if let Some(gbuffer) = gbuffer {
        for (name, channels) in [("albedo.exr", 0..3), ("normal.exr", 3..6)] {
            write_exr(&path(name), &[("", &gbuffer.channels_of(channels))])?;
        }
    }
    let file = |place: &&'static str| {
        let name = format!("{}.exr", place.trim_matches(['{', '}']));
        (*place, path(&name).to_string_lossy().into_owned())
    };
    let surroundings = Surroundings { own: folder.path(), variables: &params.variables, trace };
    let ran = PLACES.run(ctx, template, &PLACES.all.iter().map(file).collect::<Vec<_>>(), surroundings)?;
    let failed = |what: String| failed(format!("{what}{}", ran.tail()));
    let output = path("output.exr");
    let layers = read_exr(&output).map_err(|e| {
        // The folder has another name each time, and is gone.
        let why = e.to_string().replace(&*output.to_string_lossy(), "{output}");
        failed(format!("left no image that can be read: {why}"))
    })?;
    // The layer without a name comes first.
    let image = layers.into_values().next().ok_or_else(|| failed("left an image without channels".into()))?;
    if !image.same_shape(color) {
        let shape = |i: &Image| format!("{} x {} pixels of {} values", i.width(), i.height(), i.channels());
        return Err(failed(format!("made {} of {}", shape(&image), shape(color))));
    }
    let odd = image.data().iter().filter(|value| !value.is_finite()).count();
    if odd > 0 {
        return Err(failed(format!("made an image in which {odd} of {} values are not finite", image.data().len())));
    }
    Ok((image, ran))
}
