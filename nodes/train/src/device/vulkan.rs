//! Devices with a Vulkan driver, which a node's param `device` asks for. The loader of the system finds the driver when
//! it is asked for.

use super::{NetworkDevice, Place};
use burn::tensor::{
    Device, DeviceKind,
    wgpu::{WgpuBackend, WgpuInitError},
};
use std::sync::OnceLock;
use tauflow_contract::KindError;

/// Types of GPUs, the fastest first.
const GPUS: &[DeviceKind] = &[DeviceKind::DiscreteGpu(0), DeviceKind::IntegratedGpu(0), DeviceKind::VirtualGpu(0)];

/// A device can be opened once only; what came of it.
type Opened = OnceLock<Result<Place, String>>;

/// The place of a device.
///
/// # Errors
/// If there is no such device, or it cannot be opened.
pub(super) fn open(device: NetworkDevice) -> Result<Place, KindError> {
    static GPU: Opened = OnceLock::new();
    static SOFTWARE: Opened = OnceLock::new();
    let (opened, kinds) = match device {
        NetworkDevice::Cpu => return Ok(Place::cpu()),
        NetworkDevice::Vulkan => (&GPU, GPUS),
        // They crash in the compiler of such drivers.
        NetworkDevice::SoftwareVulkan if cfg!(feature = "gpu-spirv") => {
            return Err(KindError::Environment(
                "`device` is `software_vulkan`, which this build's kernels, in SPIR-V, do not run on; build with the \
                 feature `gpu` alone"
                    .into(),
            ));
        }
        NetworkDevice::SoftwareVulkan => (&SOFTWARE, &[DeviceKind::Cpu] as &[DeviceKind]),
    };
    opened.get_or_init(|| first(kinds)).clone().map_err(|why| {
        KindError::Environment(format!(
            "`device` is `{}`: {why}; install a Vulkan driver and its loader (`vulkaninfo --summary` lists what they \
             find), or write `device: cpu`",
            device.name()
        ))
    })
}

/// The first device that there is.
fn first(kinds: &[DeviceKind]) -> Result<Place, String> {
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

/// A device to test on, if there is any.
#[cfg(test)]
pub(crate) fn for_tests() -> Option<Place> {
    let found = open(NetworkDevice::Vulkan).or_else(|_| open(NetworkDevice::SoftwareVulkan));
    match &found {
        Ok(place) => println!("on {}", place.adapter().unwrap_or_default()),
        Err(error) => tauflow_testing::skip(tauflow_testing::Need::Vulkan, error),
    }
    found.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_is_missing_is_told() {
        match open(NetworkDevice::Vulkan) {
            Ok(place) => assert!(place.adapter().is_some_and(|name| !name.is_empty())),
            Err(told) => {
                assert!(matches!(told, KindError::Environment(_)));
                assert!(told.to_string().contains("install a Vulkan driver"), "{told}");
            }
        }
    }
}
