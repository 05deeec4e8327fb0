//! Devices with a Vulkan driver, which the environment variable TAUFLOW_DEVICE asks for. The driver is found when it is
//! asked for, by the loader of the system.

use super::Place;
use burn::tensor::{
    Device, DeviceKind,
    wgpu::{WgpuBackend, WgpuInitError},
};
use serde_json::{Value, json};
use std::sync::OnceLock;
use tauflow_contract::{Determinism, KindError, OutputPort};

const VARIABLE: &str = "TAUFLOW_DEVICE";

/// What GPUs are, the fastest first.
const GPUS: &[DeviceKind] = &[DeviceKind::DiscreteGpu(0), DeviceKind::IntegratedGpu(0), DeviceKind::VirtualGpu(0)];

/// A device can be opened once only; what came of it.
type Opened = OnceLock<Result<Place, String>>;

impl Place {
    /// The place that TAUFLOW_DEVICE names; the CPU without it.
    ///
    /// # Errors
    /// See [`Place::named`].
    pub fn chosen() -> Result<Self, KindError> {
        asked().map_or_else(|| Ok(Self::cpu()), |name| Self::named(&name))
    }

    /// The place of a name: `cpu`, `vulkan` for the first GPU, or `software_vulkan` for a driver that has no GPU.
    ///
    /// # Errors
    /// If the name is none of these, or there is no such device, or it cannot be opened.
    pub fn named(name: &str) -> Result<Self, KindError> {
        static GPU: Opened = OnceLock::new();
        static SOFTWARE: Opened = OnceLock::new();
        let (opened, kinds) = match name {
            "cpu" => return Ok(Self::cpu()),
            "vulkan" => (&GPU, GPUS),
            // They crash in the compiler of such drivers.
            "software_vulkan" if cfg!(feature = "gpu-spirv") => {
                return Err(KindError::Environment(format!(
                    "{VARIABLE} is `{name}`, which this build's kernels, in SPIR-V, do not run on; build with the \
                     feature `gpu` alone"
                )));
            }
            "software_vulkan" => (&SOFTWARE, &[DeviceKind::Cpu] as &[DeviceKind]),
            _ => {
                return Err(KindError::Environment(format!(
                    "{VARIABLE} is `{name}`, which is no device; set it to `cpu` or `vulkan`, or to `software_vulkan` \
                     for a driver without a GPU"
                )));
            }
        };
        opened.get_or_init(|| open(kinds)).clone().map_err(|why| {
            KindError::Environment(format!(
                "{VARIABLE} asks for `{name}`: {why}; install a Vulkan driver and its loader (`vulkaninfo --summary` \
                 lists what they find), or set {VARIABLE}=cpu"
            ))
        })
    }
}

/// What TAUFLOW_DEVICE names, unless it is the CPU.
fn asked() -> Option<String> {
    let name = std::env::var_os(VARIABLE)?.to_string_lossy().into_owned();
    (!name.is_empty() && name != "cpu").then_some(name)
}

/// The first device that there is.
fn open(kinds: &[DeviceKind]) -> Result<Place, String> {
    for kind in kinds {
        let options = Device::wgpu_options().device_kind(kind.clone()).graphics_api(WgpuBackend::Vulkan);
        match options.init_with_setup() {
            Ok((device, setup)) => {
                let info = setup.adapter.get_info();
                return Ok(Place {
                    device,
                    // Kernels of two languages are two programs.
                    adapter: Some(format!(
                        "{}, {} {}, {}",
                        info.name,
                        info.driver,
                        info.driver_info,
                        if cfg!(feature = "gpu-spirv") { "SPIR-V" } else { "WGSL" }
                    )),
                });
            }
            Err(WgpuInitError::AdapterUnavailable { .. }) => {}
            Err(error) => return Err(error.to_string()),
        }
    }
    Err("there is no such device here".into())
}

/// The environment of an action that runs a network, whose own is `own`. A device that cannot be opened is told by the
/// action.
pub(crate) fn environment(own: Value) -> Value {
    match Place::chosen() {
        Ok(place) => place.beside(own),
        Err(_) => json!({ "device": null, "beside": own }),
    }
}

/// The ports of a kind: those of `anywhere`, or on a device, which has bits of its own, those of `here`.
pub(crate) fn ports(anywhere: &'static [OutputPort], here: &'static [OutputPort]) -> &'static [OutputPort] {
    if asked().is_some() { here } else { anywhere }
}

/// Ports of which none has bits that are the same on all machines.
pub(crate) const fn of_machine<const N: usize>(ports: &[OutputPort]) -> [OutputPort; N] {
    let mut out = [ports[0]; N];
    let mut i = 0;
    while i < N {
        out[i] = match ports[i].determinism {
            Determinism::Bitwise => ports[i].local(),
            Determinism::Local | Determinism::Measured => ports[i],
        };
        i += 1;
    }
    out
}

/// A device to test on, if there is any.
#[cfg(test)]
pub(crate) fn for_tests() -> Option<Place> {
    let found = Place::named("vulkan").or_else(|_| Place::named("software_vulkan"));
    match &found {
        Ok(place) => println!("on {}", place.adapter().unwrap_or_default()),
        Err(error) => tauflow_testing::skip(tauflow_testing::Need::Vulkan, error),
    }
    found.ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tauflow_contract::{Files, Group, Out};

    #[test]
    fn names_that_are_none_are_told() {
        assert!(Place::named("cpu").expect("always there").adapter().is_none());
        let told = Place::named("cuda").expect_err("no such name");
        assert!(matches!(told, KindError::Environment(_)));
        assert!(
            told.to_string().contains("TAUFLOW_DEVICE is `cuda`") && told.to_string().contains("`vulkan`"),
            "{told}"
        );
        match Place::named("vulkan") {
            Ok(place) => assert!(place.adapter().is_some_and(|name| !name.is_empty())),
            Err(told) => {
                assert!(matches!(told, KindError::Environment(_)));
                assert!(told.to_string().contains("install a Vulkan driver"), "{told}");
            }
        }
    }

    #[test]
    fn bits_of_a_device_are_of_this_machine() {
        const FILES: Out<Files> = Out::new(Group::main(1), "files", "Files.");
        const ANY: &[OutputPort] = &[FILES.port(), FILES.measured().port()];
        const HERE: [OutputPort; 2] = of_machine(ANY);
        assert_eq!(HERE.map(|port| port.determinism), [Determinism::Local, Determinism::Measured]);
        let place = Place { adapter: Some("a card".into()), ..Place::cpu() };
        assert_eq!(place.beside(Value::Null), json!({ "device": "a card", "beside": null }));
        assert_eq!(Place::cpu().beside(json!(3)), json!(3));
    }
}
