//! Environment-dominant layouts: objects under a sky, with little else to bounce from.

use super::Template;
use crate::{
    geom::{add, direction, mul},
    scene_generation::stage::{Spot, Stage},
};

pub(super) const TEMPLATES: [Template; 4] =
    [("plaza", plaza), ("pedestal", pedestal), ("terrace", terrace), ("floating", floating)];

/// Objects on open ground.
fn plaza(s: &mut Stage, others: usize) {
    let radius = s.draw("ground.radius", 5.0, 12.0);
    s.ground(radius);
    s.ring([0.0; 3], [0.9, 1.3], [0.4, 0.8], others);
    s.sky = 1.0;
    s.view.elevation = [0.12, 0.75];
}

/// The main object on a pedestal, others about its foot.
fn pedestal(s: &mut Stage, others: usize) {
    let radius = s.draw("ground.radius", 4.0, 9.0);
    s.ground(radius);
    let (half, height) = (s.draw("pedestal.half", 0.45, 0.65), s.draw("pedestal.height", 0.15, 0.7));
    s.plinth([0.0, 0.5 * height, 0.0], [half, 0.5 * height, half]);
    s.ring([0.0; 3], [0.8, 1.1], [0.35, 0.6], others);
    s.spots[0].position[1] = height;
    // The others must clear the pedestal's corners.
    for spot in &mut s.spots[1..] {
        let [x, _, z] = spot.position;
        let far = (x * x + z * z).sqrt();
        let least = 1.42 * half + 0.6 * spot.size;
        if far < least {
            spot.position = mul(spot.position, least / far);
        }
    }
    s.sky = 1.0;
    s.view.elevation = [0.08, 0.6];
}

/// Two broad steps; the main object on the upper, others on the lower and on the ground.
fn terrace(s: &mut Stage, others: usize) {
    let radius = s.draw("ground.radius", 5.0, 10.0);
    s.ground(radius);
    let (upper, lower) = (s.draw("upper.half", 0.7, 1.0), s.draw("lower.half", 1.5, 2.1));
    let rise = s.draw("rise", 0.12, 0.35);
    s.plinth([0.0, 0.5 * rise, 0.0], [lower, 0.5 * rise, lower]);
    s.plinth([0.0, 1.5 * rise, 0.0], [upper, 0.5 * rise, upper]);
    s.ring([0.0; 3], [0.9, 1.3], [0.35, 0.6], others);
    s.spots[0].position[1] = 2.0 * rise;
    for spot in &mut s.spots[1..] {
        let [x, _, z] = spot.position;
        let far = (x * x + z * z).sqrt();
        // On the lower step, between the two squares, whatever the direction.
        let reach = x.abs().max(z.abs()) / far;
        let ring = (0.5 * (upper + lower)) / reach;
        spot.position = [x * ring / far, rise, z * ring / far];
        spot.size = spot.size.min(0.9 * (lower - upper));
    }
    s.sky = 1.0;
    s.view.elevation = [0.15, 0.7];
}

/// Objects that hang in the sky, lit by it alone.
fn floating(s: &mut Stage, others: usize) {
    let size = s.draw("main.size", 1.0, 1.4);
    let turn = s.draw("ring.turn", 0.0, core::f64::consts::TAU);
    s.spots.push(Spot { position: [0.0; 3], size, floating: true });
    for i in 0..others {
        let small = s.draw(&format!("float.{i}.size"), 0.4, 0.8);
        let lift = s.draw(&format!("float.{i}.lift"), -0.6, 0.6);
        let gap = s.draw(&format!("float.{i}.gap"), 0.1, 0.4);
        let angle = turn + core::f64::consts::TAU * i as f64 / others as f64;
        let toward = direction(angle, lift);
        let position = add([0.0; 3], mul(toward, 0.75 * (size + small) + gap));
        s.spots.push(Spot { position, size: small, floating: true });
    }
    s.sky = 1.0;
    s.view.elevation = [-0.3, 0.5];
}
