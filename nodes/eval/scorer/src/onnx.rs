//! Scorers of ONNX models, in this process.
//!
//! ONNX Runtime's library is loaded when the first model is used. Its file is what the param names, else what
//! TAUFLOW_ONNXRUNTIME names. A process has one runtime. Each model runs on one thread, so that its scores do not
//! depend on their number.

use crate::{
    manifest::Files,
    resize::resized,
    scorer::{Scorer, Search},
};
use ort::{environment::Environment, session::Session, value::Tensor};
use std::{
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};
use tauflow_contract::KindError;
use tauflow_data::{Image, records::ScoreColumn};

/// Variable that names the library.
pub(crate) const VARIABLE: &str = "TAUFLOW_ONNXRUNTIME";

/// The library's file: what the param names, else the variable.
pub(crate) fn library(by_params: Option<&str>) -> Option<PathBuf> {
    let by_variable = || std::env::var(VARIABLE).ok().filter(|name| !name.is_empty());
    by_params.map(str::to_owned).or_else(by_variable).map(PathBuf::from)
}

/// The runtime of this process, with the file that it was loaded from.
fn runtime(file: &Path) -> Result<Environment, KindError> {
    static LOADED: Mutex<Option<(PathBuf, Environment)>> = Mutex::new(None);
    let file = file.canonicalize().map_err(|e| KindError::Environment(format!("`{}`: {e}", file.display())))?;
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((from, environment)) = &*loaded {
        if *from == file {
            return Ok(environment.clone());
        }
        return Err(KindError::Environment(format!(
            "ONNX Runtime was loaded from `{}` already, and `{}` is asked for; name one library for all nodes",
            from.display(),
            file.display()
        )));
    }
    let failed = |why: String| {
        KindError::Environment(format!(
            "cannot load ONNX Runtime from `{}`: {why}; the wheel `onnxruntime` has a newer one",
            file.display()
        ))
    };
    let builder = ort::init_from(&file).map_err(|e| failed(e.to_string()))?;
    let environment = builder.with_name("tauflow").build().map_err(|e| failed(e.to_string()))?;
    *loaded = Some((file.clone(), environment.clone()));
    Ok(environment)
}

/// A model that has passed its check.
pub(crate) struct Onnx {
    files: Files,
    columns: [ScoreColumn; 1],
    session: Session,
    input: String,
}

impl Onnx {
    /// Loads the model of a manifest and holds it against its parity image.
    ///
    /// # Errors
    /// If the manifest is unsound, the model is another file, cannot be run, or gives another score than it should.
    pub(crate) fn find(manifest: &str, runtime_file: Option<&str>) -> Result<Search<Self>, KindError> {
        let Some(files) = Files::read(manifest)? else {
            return Ok(Search::Missing(format!("there is no manifest `{manifest}`")));
        };
        let metric = files.manifest.metric.clone();
        for (what, file) in [("model", &files.model), ("parity image", &files.parity)] {
            if !file.is_file() {
                return Ok(Search::Missing(format!("{metric}: there is no {what} `{}`", file.display())));
            }
        }
        let Some(library) = library(runtime_file) else {
            return Ok(Search::Missing(format!(
                "{metric}: no ONNX Runtime is named; install it (the wheel `onnxruntime` has one) and name its library \
                 with `runtime` or {VARIABLE}"
            )));
        };
        if !library.is_file() {
            return Ok(Search::Missing(format!("{metric}: there is no ONNX Runtime at `{}`", library.display())));
        }
        files.check_digest()?;
        let failed = |why: String| KindError::Input(format!("the model `{}`: {why}", files.model.display()));
        let environment = runtime(&library)?;
        let session = session(&environment, &files.model).map_err(|e| failed(e.to_string()))?;
        let inputs: Vec<String> = session.inputs().iter().map(|input| input.name().to_owned()).collect();
        let [input] = &inputs[..] else {
            return Err(failed(format!("it has {} inputs, expected one image [1, 3, H, W]", inputs.len())));
        };
        let (columns, input) = ([files.column()], input.clone());
        let mut scorer = Self { files, columns, session, input };
        scorer.check()?;
        Ok(Search::Here(scorer))
    }

    /// Holds the model against its parity image.
    fn check(&mut self) -> Result<(), KindError> {
        let image = self.files.parity_image()?;
        let found = self.score(&image)?[0];
        let parity = &self.files.manifest.parity;
        if (found - parity.score).abs() <= parity.tolerance {
            return Ok(());
        }
        Err(KindError::Input(format!(
            "the model `{}` gives its parity image {found}, but the manifest `{}` expects {} to within {}; check \
             `mean`, `deviation` and `size`, and the model's export",
            self.files.model.display(),
            self.files.at,
            parity.score,
            parity.tolerance
        )))
    }
}

fn session(environment: &Environment, model: &Path) -> ort::Result<Session> {
    let builder = Session::builder(environment)?.with_intra_threads(1)?.with_inter_threads(1)?;
    builder.with_deterministic_compute(true)?.commit_from_file(model)
}

impl Scorer for Onnx {
    fn columns(&self) -> &[ScoreColumn] {
        &self.columns
    }

    fn score(&mut self, image: &Image) -> Result<Vec<f64>, KindError> {
        let manifest = &self.files.manifest;
        let image = match manifest.size {
            Some([width, height]) => resized(image, width as usize, height as usize),
            None => image.clone(),
        };
        // Channels first, as networks take images.
        let plane = |c: usize| {
            let scaled = move |value: &f32| (value - manifest.mean[c]) / manifest.deviation[c];
            image.data().iter().skip(c).step_by(3).map(scaled)
        };
        let data: Vec<f32> = (0..3).flat_map(plane).collect();
        let shape = [1, 3, image.height(), image.width()];
        let failed = |why: String| KindError::Input(format!("the model `{}`: {why}", self.files.model.display()));
        let tensor = Tensor::from_array((shape, data)).map_err(|e| failed(e.to_string()))?;
        let outputs = self
            .session
            .run(ort::inputs![self.input.as_str() => tensor])
            .map_err(|e| failed(format!("it does not run on an image of shape {shape:?}: {e}")))?;
        let (_, values) = outputs[0].try_extract_tensor::<f32>().map_err(|e| failed(e.to_string()))?;
        match values {
            [value] if value.is_finite() => Ok(vec![f64::from(*value)]),
            [value] => Err(failed(format!("its score is {value}"))),
            _ => Err(failed(format!("its first output has {} numbers, expected one score", values.len()))),
        }
    }
}
