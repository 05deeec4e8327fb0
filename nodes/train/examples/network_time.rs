//! Times of the network by itself on made-up images with G-buffers, as one line of JSON: medians of training steps, of
//! the share of a step that drawing its batch takes, and of predictions. The last argument is the way to convolve of
//! steps; predictions always have minimal filtering.
//!
//! ```text
//! cargo run --release -p tauflow-train --example network_time -- small 2 [batch 4] [steps 20] [calls 10] [minimal]
//! ```

use tauflow_train::{Convolving, Place, Preset, timing};

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
    let threads = number(1, 1)?;
    let (batch, steps, times) = (number(2, 4)?, number(3, 20)?, number(4, 10)?);
    let convolving: Convolving = serde_json::from_value(args.get(5).map_or("minimal", String::as_str).into())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let cpu = Place::cpu();
    // The first ones warm up caches and memory.
    let found = pool.install(|| timing::training_steps(&cpu, preset, batch, 64, steps + 3, convolving))?;
    let predictions = pool.install(|| timing::predictions(&cpu, preset, 256, times + 1))?;
    println!(
        "{{\"weights\":{},\"step_ms\":{:.3},\"draw_share\":{:.4},\"predict_ms\":{:.3}}}",
        timing::weights(preset)?,
        median(found[3..].iter().map(|[step, _]| *step).collect()),
        median(found[3..].iter().map(|[step, draw]| draw / step).collect()),
        median(predictions[1..].to_vec())
    );
    Ok(())
}
