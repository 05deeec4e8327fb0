//! Where networks run: on the CPU, by operators of our own; in builds with the feature `gpu`, on a device with a Vulkan
//! driver, too. Knows nothing of networks.

#[cfg(feature = "gpu")]
pub(crate) mod vulkan;

use burn::tensor::Device;
use serde_json::Value;
#[cfg(not(feature = "gpu"))]
use tauflow_contract::KindError;

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

    /// The place that this process is to use.
    ///
    /// # Errors
    /// None: there is but one.
    #[cfg(not(feature = "gpu"))]
    pub fn chosen() -> Result<Self, KindError> {
        Ok(Self::cpu())
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

/// The environment of an action that runs a network, whose own is `own`.
#[cfg(not(feature = "gpu"))]
pub(crate) fn environment(own: Value) -> Value {
    Place::cpu().beside(own)
}

/// Either ports of bits that any machine makes, or the same ports of bits of this one: where the networks run decides.
#[cfg(not(feature = "gpu"))]
macro_rules! ports {
    ($ports:expr) => {
        $ports
    };
}

#[cfg(feature = "gpu")]
macro_rules! ports {
    ($ports:expr) => {
        $crate::device::vulkan::ports($ports, const { &$crate::device::vulkan::of_machine::<{ $ports.len() }>($ports) })
    };
}

pub(crate) use ports;
#[cfg(feature = "gpu")]
pub(crate) use vulkan::environment;
