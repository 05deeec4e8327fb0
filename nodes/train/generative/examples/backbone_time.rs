//! Time of one prediction of a published backbone with made-up weights, as one line of JSON: the median, in
//! milliseconds.
//!
//! ```text
//! cargo run --release -p tauflow-generative --example backbone_time -- ddpm 2 [side 256] [predictions 3]
//! ```

#![expect(clippy::disallowed_methods, reason = "it measures")]

use std::time::Instant;
use tauflow_data::Image;
use tauflow_generative::{Backbone, Config, NcsnppConfig, Unet2dConfig, count};
use tauflow_tensors::Weights;

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, or: usize| args.get(i).map_or(Ok(or), |v| v.parse());
    let (threads, side, times) = (number(1, 1)?, number(2, 256)?, number(3, 3)?);
    let config = match args.first().map(String::as_str) {
        Some("rectified_flow") => Config::RectifiedFlow(Box::new(NcsnppConfig::lsun())),
        _ => Config::Ddpm(Box::new(Unet2dConfig::church()), Box::default()),
    };
    let network = config.network();
    let parameters = network.parameters();
    // Small numbers without a pattern that the processor could profit from.
    let value = |i: usize| ((i * 7919 % 2003) as f32 / 1001.5 - 1.0) * 0.03;
    let weights = parameters.iter().map(|p| (0..p.shape.iter().product()).map(value).collect()).collect();
    let weights_in_all = count(parameters);
    let backbone = Backbone::new(config, &Weights(weights));
    let image = Image::from_data(side, side, 3, (0..side * side * 3).map(|i| value(i) * 30.0).collect())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut found = Vec::new();
    // The first one warms up memory.
    for _ in 0..=times {
        let start = Instant::now();
        pool.install(|| backbone.predict(&[&image], &[0.5]))?;
        found.push(1000.0 * start.elapsed().as_secs_f64());
    }
    found.remove(0);
    found.sort_by(f64::total_cmp);
    println!("{{\"weights\":{weights_in_all},\"predict_ms\":{:.1}}}", found[found.len() / 2]);
    Ok(())
}
