//! The time until a page of many scenes can be used, in headless Chromium:
//! `cargo run --release -p tauflow-viewer --example many_scenes -- [SCENES [SIDE]]`. Its images are noise.
//!
//! Prints the size of the page, and the time from the start of the navigation until the first image is drawn and the
//! list of scenes has its thumbnails.

use std::error::Error;
use tauflow_data::Image;
use tauflow_testing::Browser;
use tauflow_viewer::{Content, Frame, Head, Page, Scene, Track};

/// An image of noise, which hardly compresses.
fn noise(side: usize, seed: u64) -> Image {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1 << 24) as f32
    };
    Image::from_data(side, side, 3, (0..3 * side * side).map(|_| next()).collect()).expect("as many")
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let scenes: usize = words.next().map_or(Ok(4000), |word| word.parse())?;
    let side: usize = words.next().map_or(Ok(64), |word| word.parse())?;
    let folder = tempfile::tempdir()?;
    let tracks = [Track { name: "rungs".into(), space: "exposed linear radiance".into(), raw: false, between: None }];
    let rung = |spp: u64, tau: f64, before: Option<usize>| {
        let (id, label) = (format!("rungs/{spp} spp"), format!("{spp} spp"));
        Frame { id, track: 0, label, content: Content::Radiance, order: spp, tau: Some(tau), before }
    };
    let frames = [rung(1, 0.0, None), rung(256, 1.0, Some(0))];
    let mut page = Page::new(folder.path().join("page.html"), None);
    for number in 0..scenes {
        let stratum = format!("L{}-open", number % 4);
        let images = vec![(0, noise(side, 2 * number as u64 + 1)), (1, noise(side, 2 * number as u64 + 2))];
        let key = format!("{stratum}-{number:06}");
        page.add(Scene { key, stratum, reference: Some(1), images, ..Scene::default() }, &frames, &tracks)?;
    }
    let written = page.finish(&Head { title: "many scenes".into(), ..Head::default() }, &frames, &tracks)?;
    println!(
        "{scenes} scenes of {side} x {side} pixels, 2 images each: {:.1} MiB",
        written.bytes as f64 / f64::from(1 << 20)
    );
    let Some(mut browser) = Browser::start("many scenes") else { return Ok(()) };
    browser.size(1400, 900);
    for round in 1..=3 {
        browser.open(&written.page);
        browser.wait("now.a !== null && [...$('rows').children].every((row) => row.firstChild.style.objectFit)");
        let taken = browser.eval("performance.now()").as_f64().unwrap_or(f64::NAN);
        let files = browser.eval("kept.size + thumbs.size");
        println!("round {round}: usable after {:.2} s, {files} files read", taken / 1000.0);
    }
    Ok(())
}
