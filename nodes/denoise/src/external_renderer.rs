#![doc = include_str!("external_renderer.md")]

use crate::{
    command::{self, Places, Surroundings},
    process::keyed_variables,
    timed::{self, AFTER, TIMING},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::{collections::BTreeMap, path::Path};
use tauflow_contract::{
    Action, Before, Context, Digest, Each, Facts, Group, ItemKey, Kind, KindError, KindSpec, Known, Later, Media, Mode,
    Out, Outlook, Outputs, ParamProblem, Probe, Resources, Seen,
};
use tauflow_data::{
    Image, Resolution, Rungs, Scene,
    facts::{FILM, NFE, SPP},
    image_io::read_exr,
    methods::MethodName,
    mitsuba::{self, Film},
    records::{Refined, RefinedImage, RefinedImages, SceneRecord, TimedImage, Timing},
    timing::{Repeated, measuring},
};

/// The kind `external_renderer`.
pub struct ExternalRenderer;

/// Params of `external_renderer`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExternalRendererParams {
    /// Name of the method in tables.
    pub method: MethodName,
    /// Command line of the program, as a list of words with {scene}, {counts}, {repeats}, {seed} and {folder}.
    /// Required.
    pub command: Vec<String>,
    /// Command that prints the version of the program and fails if it is missing, as a list of words; not needed if the
    /// content of the program file identifies the version.
    pub version: Vec<String>,
    /// Files, directories and patterns such as `models/*.pt` that the program depends on, in addition to traced files.
    /// Their contents are part of the keys.
    pub depends: Vec<String>,
    /// Additional environment variables that the program inherits. Their values are part of the keys.
    pub variables: Vec<String>,
    /// Samples per pixel of the images: `{dyadic: 64}` for 1, 2, 4 ... 64, or an increasing list.
    pub counts: Rungs,
    /// Width and height in pixels.
    pub resolution: Resolution,
    /// Fail if the program is missing, instead of omitting the method with a note.
    pub required: bool,
    /// Number of renders per image for timing.
    #[schemars(range(min = 1, max = 1000))]
    pub repeats: u64,
}

impl Default for ExternalRendererParams {
    fn default() -> Self {
        Self {
            method: MethodName::new("mitsuba").expect("letters"),
            command: Vec::new(),
            version: Vec::new(),
            depends: Vec::new(),
            variables: Vec::new(),
            counts: Rungs::dyadic(64).expect("a power of two"),
            resolution: Resolution::new(256, 256).expect("a small film"),
            required: false,
            repeats: 3,
        }
    }
}

const SCENES: Each<SceneRecord> = Each::new("scenes", "The scenes to render.");
const MAIN: Group = Group::main(1);
const TIMED: Group = Group::new(TIMING, 2);
const RENDERED: Out<Refined> =
    Out::new(MAIN, "rendered", "One image per sample count; none if the program is missing.").local();
const TIMES: Out<Timing> = Out::new(TIMED, "timing", "Wall time of each image, as the program reports it.").measured();
const PLACES: Places = Places {
    what: "renderer",
    all: &["{scene}", "{counts}", "{repeats}", "{seed}", "{folder}"],
    needed: &["{scene}", "{counts}", "{folder}"],
};

impl Kind for ExternalRenderer {
    type Params = ExternalRendererParams;

    fn spec() -> KindSpec {
        KindSpec {
            name: "external_renderer",
            summary: "Renders scenes with an external renderer, as a baseline.",
            manual: include_str!("external_renderer.md"),
            mode: Mode::Map,
            inputs: vec![SCENES.port(), AFTER.port()],
            outputs: vec![RENDERED.port(), TIMES.port()],
            seeded: true,
        }
    }

    fn check(params: &Self::Params) -> Vec<ParamProblem> {
        let problem = match params.command.is_empty() {
            true => Some("there is no command".to_owned()),
            false => PLACES.problem(&params.command),
        };
        let hint = "write for example `command: [python3, render.py, \"{scene}\", \"{counts}\", \"{folder}\"]`";
        problem.map(|problem| ParamProblem::new("/command", problem, hint)).into_iter().collect()
    }

    fn foresee(params: &Self::Params, _known: &Known) -> Outlook {
        let film = [params.resolution.width(), params.resolution.height()];
        let counts = params.required.then(|| params.counts.counts().to_vec());
        let facts = Facts::default().with(FILM, film).with(NFE, vec![0]).with_some(SPP, counts);
        Outlook::default().with(RENDERED, facts)
    }

    fn missing(params: &Self::Params) -> Vec<ParamProblem> {
        let there = params.command.first().is_some_and(|name| command::program(name).is_some());
        // Without the program the method is left out, with a note.
        if params.required || there {
            return command::missing(&params.command, "/command", &params.depends);
        }
        Vec::new()
    }

    fn work(params: &Self::Params, group: &str) -> f64 {
        let pixels = (params.resolution.width() * params.resolution.height()) as f64;
        let rounds = if group == TIMING { params.repeats + 1 } else { 1 };
        pixels * params.counts.counts().iter().sum::<u64>() as f64 * rounds as f64
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
        &[Later { pointer: "/depends", before: NONE }, Later { pointer: "/variables", before: NONE }]
    }

    fn runs_programs(_params: &Self::Params) -> bool {
        true
    }

    fn environment(params: &Self::Params, _group: &str, probe: &dyn Probe) -> Option<Value> {
        let version = command::probed_version(&params.version, probe)?;
        let mut found =
            json!({ "program": command::identity(&params.command), "version": version, "machine": measuring(probe) });
        found["variables"] = json!(keyed_variables(&params.variables));
        if !params.depends.is_empty() {
            found["depends"] = json!(command::depended(&params.depends));
        }
        Some(found)
    }

    fn run(ctx: &Context<'_>, action: &Action<'_, Self::Params>) -> Result<Outputs, KindError> {
        let params = &action.params;
        let name = params.command.first().map_or("", String::as_str);
        let missing = match command::program(name) {
            None => Some(format!("there is no program `{name}` here; install it, or give its whole path")),
            Some(_) => command::version(&params.version).err(),
        };
        let put_images = |images: RefinedImages, note: Option<String>| -> Result<Outputs, KindError> {
            Ok(Outputs::default().put(RENDERED, Refined { images, note, ..Default::default() }.store(ctx)?))
        };
        let put_times =
            |times: Timing| -> Result<Outputs, KindError> { Ok(Outputs::default().put(TIMES, times.store(ctx)?)) };
        if let Some(missing) = missing {
            return match (params.required, action.group) {
                (true, _) => Err(KindError::Environment(format!("{missing}; or say `required: false`"))),
                (false, TIMING) => put_times(timed::nothing()),
                (false, _) => put_images(Vec::new(), Some(format!("{}: {missing}", params.method.as_str()))),
            };
        }
        command::check_depends(&params.depends)?;
        let scene = SceneRecord::scene(ctx, action.handle(SCENES)?)?;
        let work = SceneToRender { ctx, params, seed: action.seed, scene };
        match action.group {
            TIMING => {
                let (_, times, seen) = work.render(params.repeats)?;
                Ok(Outputs { seen, ..put_times(times)? })
            }
            _ => {
                let (images, _, seen) = work.render(0)?;
                Ok(Outputs { seen, ..put_images(images, None)? })
            }
        }
    }
}

/// A scene, and how a program is to render it.
struct SceneToRender<'a> {
    ctx: &'a Context<'a>,
    params: &'a ExternalRendererParams,
    seed: u64,
    scene: Scene,
}

/// The times that a program reports for one sample count: seconds per repeat.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Told {
    wall_s: Vec<f64>,
    cpu_s: Vec<f64>,
}

impl SceneToRender<'_> {
    fn failed(&self, what: &str) -> KindError {
        PLACES.failed(&self.params.command, what)
    }

    /// Its images, and how long each took; without repeats no times. And the files that the program looked at: it tells
    /// the times itself, of work after its files are loaded.
    fn render(&self, repeats: u64) -> Result<(RefinedImages, Timing, Option<Seen>), KindError> {
        let counts = self.params.counts.counts();
        let folder = tempfile::tempdir().map_err(|e| self.failed(&format!("got no folder for its images: {e}")))?;
        let (inputs, images) = (folder.path().join("scene"), folder.path().join("images"));
        std::fs::create_dir(&images).map_err(|e| self.failed(&format!("got no folder for its images: {e}")))?;
        let resolution = self.params.resolution;
        let (width, height) = (resolution.width(), resolution.height());
        let film = Film { width, height, spp: self.params.counts.last() };
        mitsuba::export(&self.scene, &mut |digest: &Digest| self.ctx.get(digest), &inputs, film)?;
        let listed: Vec<String> = counts.iter().map(u64::to_string).collect();
        self.ctx.check_cancelled()?;
        let surroundings = Surroundings { own: folder.path(), variables: &self.params.variables, trace: true };
        let ran = PLACES.run(
            self.ctx,
            &self.params.command,
            &[
                ("{scene}", inputs.join("scene.xml").to_string_lossy().into_owned()),
                ("{counts}", listed.join(",")),
                ("{repeats}", repeats.to_string()),
                // The range of seeds that every program accepts.
                ("{seed}", (self.seed % (1 << 31)).to_string()),
                ("{folder}", images.to_string_lossy().into_owned()),
            ],
            surroundings,
        )?;
        // The program's messages may tell why a file is missing or wrong.
        let tail = ran.tail();
        let told = |error: KindError| match error {
            KindError::Environment(what) => KindError::Environment(format!("{what}{tail}")),
            other => other,
        };
        let image = |count: &u64| Ok((self.said(*count), self.image(&images, *count)?));
        let images_of = || counts.iter().map(image).collect::<Result<Vec<_>, KindError>>();
        match repeats {
            0 => Ok((images_of().map_err(told)?, timed::nothing(), ran.seen)),
            _ => Ok((Vec::new(), self.times(&images, counts, repeats).map_err(told)?, ran.seen)),
        }
    }

    fn said(&self, count: u64) -> RefinedImage {
        RefinedImage { method: self.params.method.as_str().to_owned(), from_spp: count, to_spp: count, nfe: 0 }
    }

    fn image(&self, folder: &Path, count: u64) -> Result<Image, KindError> {
        let file = format!("{count}.exr");
        let path = folder.join(&file);
        let layers = read_exr(&path).map_err(|e| {
            // The folder has another name each time, and is gone.
            let why = e.to_string().replace(&*path.to_string_lossy(), &file);
            self.failed(&format!("left no `{file}` that can be read: {why}"))
        })?;
        let image = layers.into_values().next().ok_or_else(|| self.failed(&format!("left no channels in `{file}`")))?;
        let (width, height) = (self.params.resolution.width(), self.params.resolution.height());
        if (image.width(), image.height(), image.channels()) != (width, height, 3) {
            return Err(self.failed(&format!(
                "made `{file}` of {} x {} pixels of {} values, expected {width} x {height} of 3",
                image.width(),
                image.height(),
                image.channels()
            )));
        }
        Ok(image)
    }

    fn times(&self, folder: &Path, counts: &[u64], repeats: u64) -> Result<Timing, KindError> {
        let broken = |what: &dyn std::fmt::Display| self.failed(&format!("left no times in `times.json`: {what}"));
        let text = std::fs::read_to_string(folder.join("times.json")).map_err(|e| broken(&e))?;
        let mut told: BTreeMap<u64, Told> = serde_json::from_str(&text).map_err(|e| broken(&e))?;
        let mut entries = Vec::new();
        for count in counts {
            let Told { wall_s, cpu_s } =
                told.remove(count).ok_or_else(|| broken(&format!("none of {count} samples per pixel")))?;
            let sound =
                |times: &[f64]| times.len() as u64 == repeats && times.iter().all(|t| t.is_finite() && *t >= 0.0);
            if !(sound(&wall_s) && sound(&cpu_s)) {
                return Err(broken(&format!("{repeats} of each kind are asked for, of {count} samples per pixel")));
            }
            let RefinedImage { method, from_spp, nfe, .. } = self.said(*count);
            entries.push(TimedImage { method, from_spp, nfe, took: Repeated { wall_s, cpu_s } });
        }
        Ok(Timing::here(entries))
    }
}
