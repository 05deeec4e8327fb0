//! Tests of devices, in builds that have them.

#[cfg(feature = "gpu")]
mod on_device;
#[cfg(feature = "gpu")]
#[expect(dead_code, reason = "other tests use the rest")]
#[path = "../toy/mod.rs"]
mod toy;

#[cfg(not(feature = "gpu"))]
#[test]
fn devices_give_what_the_processor_gives() {
    tauflow_testing::skip(tauflow_testing::Need::Vulkan, "this build lacks the feature `gpu`");
}
