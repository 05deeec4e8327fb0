//! Times of the network on the CPU and on a device: the first GPU, or `software_vulkan`. Images are made up
//! and have G-buffers. For each place it prints a line of JSON with the medians of training steps, and of predictions
//! of 256 x 256 pixels.
//!
//! ```text
//! cargo run --release -p tauflow-train --features gpu --example device_time -- \
//!     tiny [batch 4] [side 64] [steps 20] [predictions 10] [device vulkan]
//! ```

use tauflow_train::{Convolving, NetworkDevice, Place, Preset, timing};

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, or: usize| args.get(i).map_or(Ok(or), |v| v.parse());
    let preset: Preset = serde_json::from_value(args.first().map_or("tiny", String::as_str).into())?;
    let (batch, side, steps, times) = (number(1, 4)?, number(2, 64)?, number(3, 20)?, number(4, 10)?);
    let device: NetworkDevice = serde_json::from_value(args.get(5).map_or("vulkan", String::as_str).into())?;
    for place in [Place::cpu(), Place::of(device)?] {
        // The first ones warm up caches and memory; on a device, they compile its kernels.
        let found = timing::training_steps(&place, preset, batch, side, steps + 3, Convolving::Minimal)?;
        let predictions = timing::predictions(&place, preset, 256, times + 1)?;
        println!(
            "{{\"place\":{},\"preset\":\"{}\",\"batch\":{batch},\"side\":{side},\"training_step_ms\":{:.3},\
             \"prediction_256_ms\":{:.3}}}",
            serde_json::to_string(place.adapter().unwrap_or("cpu"))?,
            preset.name(),
            median(found[3..].iter().map(|[step, _]| *step).collect()),
            median(predictions[1..].to_vec()),
        );
    }
    Ok(())
}
