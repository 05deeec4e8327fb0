//! Trains a cell on toy scenes, or on a folder of packed scenes, and prints the time of a step, the loss curve and the
//! gain over the noisy input on test scenes.
//!
//! ```text
//! cargo run --release -p tauflow-train --example step_time -- '{"preset":"tiny","steps":300,"batch":8}' [seed]
//! ```

#[path = "../tests/toy/mod.rs"]
mod toy;

use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Action, Context, Kind, MemoryBlobs, Silent};
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
        let (mut before, mut after, mut count) = (0.0, 0.0, 0.0);
        for (_, artifact) in test.iter() {
            let scene = PackedScene::from_bytes(&ctx.part(artifact, "")?)?;
            let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
            let refined = rollout(&model, &scene.states[0], scene.gbuffer.as_ref(), course)?;
            let reference = &scene.states[scene.states.len() - 1];
            before += toy::psnr(&scene.states[0], reference);
            after += toy::psnr(&refined, reference);
            count += 1.0;
        }
        println!("NFE {steps:3}: hold {:.2} dB, refined {:.2} dB", before / count, after / count);
    }
    Ok(())
}
