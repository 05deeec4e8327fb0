//! Trains a cell on toy scenes and prints the time of a step and of a prediction, the loss curve, and the gain over the
//! noisy input on test scenes.
//!
//! ```text
//! cargo run --release -p tauflow-train --example step_time -- '{"preset":"tiny","steps":300,"batch":8}' [seed]
//! ```

#[path = "../tests/toy/mod.rs"]
mod toy;

use std::{collections::BTreeMap, sync::atomic::AtomicBool, time::Instant};
use tauflow_contract::{Action, Collection, Context, Kind, KindError, MemoryBlobs, Silent};
use tauflow_data::{
    formats::PackedScene,
    results::{TrainingLog, TrainingTiming},
    time::TimeGrid,
};
use tauflow_train::{Course, Model, Training, TrainingParams, rollout};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let params: TrainingParams = serde_json::from_str(&args.next().unwrap_or_else(|| "{\"steps\":100}".into()))?;
    let seed = args.next().map_or(Ok(7), |s| s.parse())?;
    let counts: Vec<u64> = (0..9).map(|i| 1 << i).collect();
    let blobs = MemoryBlobs::default();
    let train = toy::collection(&blobs, 0..48, 64, &counts);
    let test = toy::collection(&blobs, 1000..1024, 64, &counts);
    let cancel = AtomicBool::new(false);
    let ctx = Context::new(&blobs, &Silent, &cancel);
    let whole = BTreeMap::from([("train", &train), ("test", &test)]);
    let action = Action { params, item: None, group: "main", seed, each: BTreeMap::new(), whole };
    let outputs = Training::run(&ctx, &action)?;
    let one = |port: &str| outputs.collections[port].get("model").ok_or("no such output");
    let log: TrainingLog = ctx.json(one("log")?, "")?;
    let timing: TrainingTiming = ctx.json(one("timing")?, "")?;
    println!("{} weights, median step {:.1} ms, {:.1} s", log.weights, timing.median_step_ms, timing.seconds);
    for p in &log.points {
        println!("{:6} train {:?} test {:?} norm {:?}", p.step, p.train, p.test, p.gradient_norm);
    }
    let model = Model::load(&ctx.part(one("model")?, "")?)?;
    for steps in [1, 2, 9, 20] {
        report(&ctx, &model, &test, steps)?;
    }
    Ok(())
}

/// Prints the mean PSNR over scenes, before and after a rollout of so many steps.
fn report(ctx: &Context<'_>, model: &Model, scenes: &Collection, steps: usize) -> Result<(), KindError> {
    let (mut before, mut after, mut seconds) = (0.0, 0.0, 0.0);
    for (_, artifact) in scenes.iter() {
        let scene = PackedScene::from_bytes(&ctx.part(artifact, "")?)?;
        let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
        let start = Instant::now();
        let refined = rollout(model, &scene.states[0], scene.gbuffer.as_ref(), course)?;
        seconds += start.elapsed().as_secs_f64();
        let reference = &scene.states[scene.states.len() - 1];
        before += toy::psnr(&scene.states[0], reference);
        after += toy::psnr(&refined, reference);
    }
    let count = scenes.len() as f64;
    let call = 1000.0 * seconds / (count * steps as f64);
    println!("NFE {steps:3}: hold {:.2} dB, refined {:.2} dB, {call:.2} ms a call", before / count, after / count);
    Ok(())
}
