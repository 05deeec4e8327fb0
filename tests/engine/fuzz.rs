//! The loader of pipelines meets text that nobody would write: every pipeline there is, mangled. It may refuse; it may
//! not panic, hang, or point outside the text.
//!
//! A few seconds of it are a test; `TAUFLOW_FUZZ_SECONDS=600 cargo test --release --test engine fuzz` goes on for
//! longer.

use crate::support::registry;
use std::{
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    time::{Duration, Instant},
};
use tauflow::pipeline::{self, Options};

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 ^ (self.0 >> 33)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() >> 8) as usize % limit.max(1)
    }
}

/// What is put in: characters that mean something to YAML, to pipelines, or to neither.
const TOKENS: [&str; 44] = [
    "{",
    "}",
    "[",
    "]",
    ":",
    ": ",
    ",",
    "-",
    "- ",
    "&a ",
    "*a",
    "!!str ",
    "|\n",
    ">\n",
    "'",
    "\"",
    "#",
    "\n",
    "\t",
    "  ",
    "? ",
    "---\n",
    "...\n",
    "<<: ",
    "~",
    "null",
    "yes",
    ".nan",
    "-.inf",
    "1e999",
    "0x",
    "99999999999999999999",
    "\u{0}",
    "\u{feff}",
    "ä",
    "\u{1f600}",
    "nodes:",
    "matrix: {a: [1]}",
    "matrix: {like: solvers}",
    "$film",
    "$$",
    "values: {film: $film}",
    "[a=b]",
    ".",
];

fn mangle(random: &mut Random, seeds: &[String]) -> String {
    let mut text = seeds[random.below(seeds.len())].clone().into_bytes();
    for _ in 0..=random.below(6) {
        let at = random.below(text.len() + 1);
        let to = (at + random.below(40)).min(text.len());
        match random.below(8) {
            0 => text.truncate(at),
            1 => drop(text.drain(at..to)),
            2 => {
                let piece = text[at..to].to_vec();
                let place = random.below(text.len() + 1);
                text.splice(place..place, piece);
            }
            3 if at < text.len() => text[at] = random.next() as u8,
            4 => {
                let other = seeds[random.below(seeds.len())].as_bytes();
                let from = random.below(other.len() + 1);
                let piece = other[from..(from + random.below(200)).min(other.len())].to_vec();
                text.splice(at..to, piece);
            }
            5 => {
                let piece = text[at..to].repeat(random.below(30));
                text.splice(at..at, piece);
            }
            _ => {
                let token = TOKENS[random.below(TOKENS.len())].as_bytes().to_vec();
                text.splice(at..at, token);
            }
        }
    }
    String::from_utf8_lossy(&text).into_owned()
}

fn seeds() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut seeds = Vec::new();
    for folder in ["pipelines", "src/cli"] {
        let mut paths: Vec<_> =
            fs::read_dir(root.join(folder)).expect("readable").map(|entry| entry.expect("readable").path()).collect();
        paths.sort();
        let yaml = paths.into_iter().filter(|path| path.extension().is_some_and(|e| e == "yaml"));
        seeds.extend(yaml.map(|path| fs::read_to_string(path).expect("text")));
    }
    let toys = "pipeline: x\nseed: 3\nprofiles: {tiny: {numbers.count: 2}}\nnodes:\n  \
                numbers: {kind: numbers, params: {count: 4}}\n  \
                b: {kind: affine, matrix: {mul: [2, 3]}, inputs: {in: numbers}}\n  \
                c: {kind: total, inputs: {in: [\"b[mul=2]\", numbers.out]}, params: {title: x}}\n\
                targets: [c.page]\n";
    seeds.push(toys.into());
    seeds
}

#[test]
fn the_loader_refuses_without_a_panic() {
    let seconds = std::env::var("TAUFLOW_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(3.0);
    let (toys, real, seeds) = (registry(), tauflow::registry::registry(), seeds());
    let mut random = Random(std::env::var("TAUFLOW_FUZZ_SEED").ok().and_then(|text| text.parse().ok()).unwrap_or(1));
    let start = Instant::now();
    let (mut count, mut accepted, mut slowest) = (0u64, 0u64, Duration::ZERO);
    while start.elapsed().as_secs_f64() < seconds {
        let text = mangle(&mut random, &seeds);
        let registry = if random.below(2) == 0 { &toys } else { &real };
        let profile = (random.below(4) == 0).then(|| "tiny".to_owned());
        let options = Options { profile, ..Options::default() };
        let begun = Instant::now();
        let done =
            catch_unwind(AssertUnwindSafe(|| match pipeline::resolve_text("fuzz.yaml", &text, registry, &options) {
                Ok(_) => true,
                Err(problems) => {
                    assert!(!problems.render(false).is_empty());
                    false
                }
            }));
        let Ok(fine) = done else { panic!("it panicked at this text:\n{text:?}") };
        let took = begun.elapsed();
        assert!(took.as_secs() < 5, "it took {took:?} at this text:\n{text:?}");
        slowest = slowest.max(took);
        accepted += u64::from(fine);
        count += 1;
    }
    println!("{count} texts, {accepted} of them accepted, the slowest in {slowest:?}");
    assert!(
        accepted > 0 && accepted < count,
        "texts near what is right, and texts that are wrong: {accepted} of {count}"
    );
}
