//! Where networks run: on the CPU, by operators of our own; in builds with the feature `gpu`, on a device with a Vulkan
//! driver, too. A node's param `device` says which, and so decides whether its outputs are of this machine. Knows
//! nothing of networks.

#[cfg(feature = "gpu")]
pub(crate) mod vulkan;

use burn::tensor::Device;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tauflow_contract::{Before, KindError, KindSpec, Later, OutputPort, ParamProblem, Resources};

/// What networks run on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NetworkDevice {
    /// The CPU.
    #[default]
    Cpu,
    /// The first GPU with a Vulkan driver.
    Vulkan,
    /// A Vulkan driver without a GPU.
    SoftwareVulkan,
}

/// Name of the param that chooses a [`NetworkDevice`]: it decides ports.
pub(crate) const PORT_PARAMS: &[&str] = &["device"];

/// Networks ran on the CPU before the param `device` existed.
pub(crate) const ON_THE_CPU: Later = Later { pointer: "/device", before: Before::Text("cpu") };

/// Cores that networks ask a scheduler for: few, so that small nodes have them. More make an action faster.
pub(crate) const CORES: u32 = 2;

impl NetworkDevice {
    /// Its name in pipeline files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Vulkan => "vulkan",
            Self::SoftwareVulkan => "software_vulkan",
        }
    }

    /// What a kind states about a node whose networks run here: a GPU's bits are of this machine and its driver.
    pub(crate) fn stated(self, spec: KindSpec) -> KindSpec {
        if self == Self::Cpu {
            return spec;
        }
        let outputs = spec.outputs.into_iter().map(OutputPort::of_machine).collect();
        KindSpec { outputs, ..spec }
    }

    /// The resources of an action whose networks run here, on so many cores beside it.
    pub(crate) fn resources(self, cores: u32) -> Resources {
        let resources = Resources::default().cores(cores);
        if self == Self::Vulkan { resources.gpus(1) } else { resources }
    }

    /// What is wrong with the param `device`.
    pub(crate) fn problems(self) -> Vec<ParamProblem> {
        if self == Self::Cpu || cfg!(feature = "gpu") {
            return Vec::new();
        }
        vec![ParamProblem::new("/device", ONLY_CPU, "build with `--features gpu`, or take `device` away")]
    }

    /// The environment of an action whose networks run here, and whose own environment is `own`. The action tells of a
    /// device that cannot be opened.
    pub(crate) fn environment(self, own: Value) -> Value {
        match Place::of(self) {
            Ok(place) => place.beside(own),
            Err(_) => serde_json::json!({ "device": null, "beside": own }),
        }
    }
}

/// What is wrong with every device but one.
const ONLY_CPU: &str = "this build runs networks on the CPU only";

/// A place where networks run.
#[derive(Clone, Debug)]
pub struct Place {
    device: Device,
    /// The device and its driver, by name; none for the CPU.
    adapter: Option<String>,
}

impl Place {
    /// The CPU.
    pub fn cpu() -> Self {
        Self { device: Device::flex(), adapter: None }
    }

    /// The place of a device.
    ///
    /// # Errors
    /// If this build or this machine has no such device, or it cannot be opened.
    pub fn of(device: NetworkDevice) -> Result<Self, KindError> {
        match device {
            NetworkDevice::Cpu => Ok(Self::cpu()),
            #[cfg(feature = "gpu")]
            device => vulkan::open(device),
            #[cfg(not(feature = "gpu"))]
            device => Err(KindError::Environment(format!(
                "{ONLY_CPU}, and `{}` is asked for; build with `--features gpu`",
                device.name()
            ))),
        }
    }

    /// The device and its driver, by name; none for the CPU, whose bits do not depend on it.
    pub fn adapter(&self) -> Option<&str> {
        self.adapter.as_deref()
    }

    /// The device of tensors.
    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// What else decides bits, `own`, and what of this place does.
    pub(crate) fn beside(&self, own: Value) -> Value {
        match &self.adapter {
            Some(adapter) => serde_json::json!({ "device": adapter, "beside": own }),
            None => own,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use tauflow_contract::{Determinism, Files, Group, Mode, Out};

    #[test]
    fn a_device_makes_outputs_of_this_machine() {
        const FILES: Out<Files> = Out::new(Group::main(1), "files", "Files.");
        let outputs = vec![FILES.port(), FILES.measured().port()];
        let (name, summary, manual, mode) = ("toy", "", "", Mode::Map);
        let spec = KindSpec { name, summary, manual, mode, inputs: vec![], outputs, seeded: false };
        assert_eq!(NetworkDevice::Cpu.stated(spec.clone()), spec);
        let found = NetworkDevice::Vulkan.stated(spec).outputs;
        let found: Vec<Determinism> = found.iter().map(|port| port.determinism).collect();
        assert_eq!(found, [Determinism::Local, Determinism::Measured]);
        let place = Place { adapter: Some("a card".into()), ..Place::cpu() };
        assert_eq!(place.beside(Value::Null), json!({ "device": "a card", "beside": null }));
        assert_eq!(Place::cpu().beside(json!(3)), json!(3));
    }

    #[test]
    #[cfg(not(feature = "gpu"))]
    fn a_build_without_devices_says_so() {
        assert!(NetworkDevice::Cpu.problems().is_empty() && Place::of(NetworkDevice::Cpu).is_ok());
        let problem = NetworkDevice::Vulkan.problems().remove(0);
        assert!(problem.pointer == "/device" && problem.hint.contains("--features gpu"), "{problem:?}");
        let told = Place::of(NetworkDevice::SoftwareVulkan).expect_err("not built in").to_string();
        assert!(told.contains("`software_vulkan`") && told.contains("--features gpu"), "{told}");
    }
}
