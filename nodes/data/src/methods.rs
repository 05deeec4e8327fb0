//! Names that several kinds and pages use for the same thing: methods, what networks see, groups of measured ports.

use crate::rungs::ParamError;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// The path tracer among methods that are timed.
pub const PATH_TRACER: &str = "path_tracer";
/// The path tracer with Sobol' points, among methods that are timed.
pub const PATH_TRACER_SOBOL: &str = "path_tracer_sobol";
/// The G-buffer among what is timed.
pub const GBUFFER: &str = "gbuffer";
/// The input itself, as the baseline that changes nothing.
pub const HOLD: &str = "hold";
/// Open Image Denoise among methods.
pub const OIDN: &str = "oidn";
/// Steps of `local_velocity` along the rungs of a bridge, one Euler step for each sample.
pub const LOCAL_STEP: &str = "local_step";
/// The same, where each step adds the whole predicted difference to twice as many samples.
pub const LOCAL_DELTA: &str = "local_delta";
/// A stop of a bridge at the expectation of the rung, given the endpoint.
pub const EXPECTATION: &str = "expectation";
/// The same, with the noise of the samples that are yet to come.
pub const STOCHASTIC: &str = "stochastic";
/// A stop of a bridge at the expectation of the rung, with a Gaussian filter of the endpoint as the clean estimate.
pub const GAUSSIAN: &str = "gaussian";
/// The same, at the fraction of variance time.
pub const GAUSSIAN_TAU: &str = "gaussian_tau";

/// A method of the bridge between rungs: a rule, the space in which it moves images, and the estimate that it uses.
///
/// Its name is the rule, with `+log1p` if images are moved in that space, and with `+reference` if a held-out reference
/// stands in the network's place: `mc_noise+log1p+reference`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BridgeMethod<'a> {
    /// Whether a held-out reference stands in the network's place.
    pub reference: bool,
    /// Whether images are moved in the space `log1p`, instead of linear radiance.
    pub log: bool,
    /// The rule, such as [`LOCAL_DELTA`].
    pub rule: &'a str,
}

const IN_LOG: &str = "+log1p";
const BY_REFERENCE: &str = "+reference";

impl<'a> BridgeMethod<'a> {
    /// The method of this name.
    pub fn of(name: &'a str) -> Self {
        let (name, reference) = name.strip_suffix(BY_REFERENCE).map_or((name, false), |rest| (rest, true));
        let (rule, log) = name.strip_suffix(IN_LOG).map_or((name, false), |rest| (rest, true));
        Self { reference, log, rule }
    }

    /// Its name in tables and files.
    pub fn name(self) -> String {
        let suffix = |is: bool, text| if is { text } else { "" };
        format!("{}{}{}", self.rule, suffix(self.log, IN_LOG), suffix(self.reference, BY_REFERENCE))
    }

    /// The name of its space.
    pub fn space(self) -> &'static str {
        if self.log { "log1p" } else { "linear" }
    }
}

/// Axes of matrices by which tables tell cells apart, as in `parameterization=mc_noise+conditioning=rgb`.
pub mod axes {
    /// The target of the network: see [`super::Parameterization`].
    pub const PARAMETERIZATION: &str = "parameterization";
    /// The additional input of a method: see [`super::Conditioning`].
    pub const CONDITIONING: &str = "conditioning";
    /// The space that a network was trained in.
    pub const SPACE: &str = "space";
    /// The sample count of the endpoint that a method starts from.
    pub const FROM: &str = "from";
    /// The method, where it is no parameterization.
    pub const METHOD: &str = "method";
    /// The draw of a training: its initial weights and batches.
    pub const DRAW: &str = "draw";
    /// How samples were drawn: see [`crate::SamplerKind`].
    pub const SAMPLER: &str = "sampler";
}

/// The name of a method in tables and in names of files: letters, digits, `_`, `-`, `.` and `+`, with no `.` in front.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct MethodName(String);

impl MethodName {
    /// A method of this name.
    ///
    /// # Errors
    /// If it cannot be part of a file's name.
    pub fn new(name: impl Into<String>) -> Result<Self, ParamError> {
        let name = name.into();
        let fine = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.' | '+');
        if name.is_empty() || !name.chars().all(fine) || name.starts_with('.') {
            return Err(ParamError(format!(
                "a method is called `{name}`; use letters, digits, `_`, `-`, `.` and `+`, with no `.` in front"
            )));
        }
        Ok(Self(name))
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for MethodName {
    type Error = ParamError;
    fn try_from(name: String) -> Result<Self, ParamError> {
        Self::new(name)
    }
}

impl From<MethodName> for String {
    fn from(name: MethodName) -> Self {
        name.0
    }
}

impl JsonSchema for MethodName {
    fn schema_name() -> Cow<'static, str> {
        "MethodName".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "The name of a method: letters, digits, `_`, `-`, `.` and `+`, with no `.` in front.",
            "type": "string",
            "minLength": 1,
            "pattern": "^[A-Za-z0-9_+-][A-Za-z0-9_.+-]*$",
        })
    }
}

/// Quantity that the network predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Default)]
#[serde(rename_all = "snake_case")]
pub enum Parameterization {
    /// clean - I_nmin on straight interpolants: rectified flow (Liu et al. 2022), the baseline that sees interpolants.
    VanillaRf,
    /// The secant to the next rung.
    LocalVelocity,
    /// The secant to the last rung.
    McVelocity,
    /// The remaining Monte Carlo noise.
    #[default]
    McNoise,
}

impl Parameterization {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 4] = [Self::VanillaRf, Self::LocalVelocity, Self::McVelocity, Self::McNoise];

    /// Its name in pipelines.
    pub const fn name(self) -> &'static str {
        match self {
            Self::VanillaRf => "vanilla_rf",
            Self::LocalVelocity => "local_velocity",
            Self::McVelocity => "mc_velocity",
            Self::McNoise => "mc_noise",
        }
    }
}

/// The additional input of a solver or denoiser.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Conditioning {
    /// Nothing.
    Rgb,
    /// Albedo and shading normal.
    Gbuffer,
}

impl Conditioning {
    /// Its name in pipelines.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Gbuffer => "gbuffer",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{from_value, json, to_value};

    #[test]
    fn methods_of_the_bridge_are_named_after_rule_space_and_estimate() {
        let noise = Parameterization::McNoise.name();
        for rule in [HOLD, LOCAL_STEP, LOCAL_DELTA, EXPECTATION, STOCHASTIC, GAUSSIAN, GAUSSIAN_TAU, noise] {
            for (log, reference) in [(false, false), (false, true), (true, false), (true, true)] {
                let method = BridgeMethod { rule, log, reference };
                let name = method.name();
                assert_eq!(BridgeMethod::of(&name), method);
                assert!(MethodName::new(name).is_ok());
            }
        }
        let method = BridgeMethod { rule: LOCAL_DELTA, log: true, reference: true };
        assert_eq!((method.name().as_str(), method.space()), ("local_delta+log1p+reference", "log1p"));
    }

    #[test]
    fn names_of_methods_can_be_in_names_of_files() {
        for name in [OIDN, PATH_TRACER_SOBOL, "my-solver+v1.2"] {
            let method: MethodName = from_value(json!(name)).expect("plain");
            assert_eq!((method.as_str(), to_value(&method).expect("text")), (name, json!(name)));
        }
        for bad in ["", " ", "a/b", ".hidden", "mon débruiteur"] {
            let error = from_value::<MethodName>(json!(bad)).expect_err("wrong").to_string();
            assert!(error.contains(&format!("`{bad}`")), "{error}");
        }
    }
}
