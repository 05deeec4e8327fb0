//! Clocks, rungs and rollouts, on predictions that are exact.

use super::{Hazard, about, held};
use tauflow_contract::KindError;
use tauflow_data::{Image, Rungs, SdeTime, VarianceTime, time::TimeGrid};
use tauflow_train::{Course, Denoiser, Parameterization, Space, rollout, rollout_to};

const CLOCKS: &str = "Ladders and variance time";
const SOLVERS: &str = "Solvers";

/// Knows the clean image: every prediction is exact.
pub(super) struct Oracle {
    pub(super) kind: Parameterization,
    pub(super) space: Space,
    pub(super) clock: VarianceTime,
    /// Where it starts.
    pub(super) start: Image,
    pub(super) clean: Image,
}

impl Denoiser for Oracle {
    fn parameterization(&self) -> Parameterization {
        self.kind
    }

    fn space(&self) -> Space {
        self.space
    }

    fn clock(&self) -> VarianceTime {
        self.clock
    }

    fn predict(&self, state: &Image, _: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        let tau = tau.expect("a rollout tells the time");
        let mut out = state.clone();
        for ((out, clean), start) in out.data_mut().iter_mut().zip(self.clean.data()).zip(self.start.data()) {
            let noise = *out - self.space.encode(*clean);
            *out = match self.kind {
                Parameterization::McNoise => noise,
                // The same all the way.
                Parameterization::VanillaRf => self.space.encode(*clean) - self.space.encode(*start),
                // v = -eps/(1 - tau).
                _ => (-f64::from(noise) / (1.0 - tau)) as f32,
            };
        }
        Ok(out)
    }
}

/// Pixels of grey values in a row.
pub(super) fn image(values: &[f32]) -> Image {
    let data = values.iter().flat_map(|v| [*v; 3]).collect();
    Image::from_data(values.len(), 1, 3, data).expect("fits")
}

/// Largest difference, relative to the larger of 1e-6 and the second image's value.
pub(super) fn difference(a: &Image, b: &Image) -> f64 {
    let off = |(a, b): (&f32, &f32)| f64::from((a - b).abs()) / f64::from(b.abs().max(1e-6));
    a.data().iter().zip(b.data()).map(off).fold(0.0, f64::max)
}

/// Which pixel of those that the solvers are given is the firefly.
const FIREFLY: usize = 3;

/// The largest difference of the other pixels, relative to what they are, and that of the firefly. The latter is
/// absolute: the firefly's clean value is smaller than the digits of its noisy one are apart, so that a difference
/// relative to it says little.
fn apart(a: &Image, b: &Image) -> [f64; 2] {
    let pick = |image: &Image, wanted: bool| {
        let chosen = (0..image.width()).filter(|x| (*x == FIREFLY) == wanted);
        let data: Vec<f32> = chosen.flat_map(|x| image.pixel(x, 0).to_vec()).collect();
        Image::from_data(data.len() / 3, 1, 3, data).expect("whole pixels")
    };
    let [firefly, truth] = [a, b].map(|image| pick(image, true));
    let off = firefly.data().iter().zip(truth.data()).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    [difference(&pick(a, false), &pick(b, false)), off]
}

/// How far single precision may take the firefly from its true value in so many steps, absolute.
///
/// A step rounds four times (prediction, share, product, sum), each time by half a digit of the largest state at most
/// and to either side: so many digits as the root of their number. Digits are 2^-4 apart at 1e6, and 2^-20 at its
/// logarithm of 13.8; back from there they count (1 + value) times.
fn digits(space: Space, steps: usize, truth: f64) -> f64 {
    let digit = match space {
        Space::Linear => 2f64.powi(-4),
        Space::Log1p => 2f64.powi(-20) * (1.0 + truth),
    };
    digit * (4.0 * steps as f64).sqrt()
}

/// What the other pixels may be off by, relative. The same number of digits: of 1e4, whose logarithm is 9.2, 1,000
/// steps make 6e-5; the rest, and linear space, less.
const OTHERS: f64 = 1e-4;

/// A share of the way from an image to another, straight in a space: where exact predictions lead in variance time.
fn between(space: Space, share: f64, noisy: &Image, clean: &Image) -> Image {
    let at = |(noisy, clean): (&f32, &f32)| {
        let (noisy, clean) = (f64::from(space.encode(*noisy)), f64::from(space.encode(*clean)));
        space.decode((noisy + share * (clean - noisy)) as f32)
    };
    let data = noisy.data().iter().zip(clean.data()).map(at).collect();
    Image::from_data(noisy.width(), noisy.height(), 3, data).expect("the same shape")
}

pub fn hazards() -> Vec<Hazard> {
    let mut out = clocks();
    out.extend(solvers());
    out
}

fn clocks() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add =
        |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(CLOCKS, fed, must, came));
    for (first, last) in [(1u64, 2u64), (7, 8), (1_000_000, 1_000_001), (1, 1 << 52)] {
        let came = VarianceTime::new(first, last).map_err(|e| e.to_string()).and_then(|clock| {
            let (a, b) = (clock.tau(first as f64), clock.tau(last as f64));
            let back = [0.0, 0.25, 0.5, 1.0]
                .map(|tau| (clock.tau(clock.count(tau)) - tau).abs())
                .into_iter()
                .fold(0.0, f64::max);
            held(a == 0.0 && b == 1.0 && back < 1e-12, format!("0 and 1 exactly; round trip to {}", about(back)))
        });
        add(
            format!("a ladder from {first} to {last} samples"),
            "tau from exactly 0 to exactly 1, and its inverse",
            came,
        );
    }
    let refused = [(0u64, 4u64), (4, 4), (8, 4)].iter().all(|(a, b)| VarianceTime::new(*a, *b).is_err());
    add(
        "ladders that start at 0, end where they start, or run backwards".into(),
        "refused",
        held(refused, "refused".into()),
    );
    let clock = VarianceTime::new(1, 512).expect("a ladder");
    let counts: Vec<f64> = [1.0 - 1e-6, 1.0 - 1e-9, 1.0 - 1e-12, 1.0].map(|tau| clock.count(tau)).to_vec();
    let rising = counts.windows(2).all(|w| w[0] <= w[1]) && counts.iter().all(|n| n.is_finite());
    let near = (counts[3] / 512.0 - 1.0).abs();
    add(
        "tau up to 1 - 1e-12, and 1".into(),
        "finite counts that increase to n_max",
        held(rising && near < 1e-12, format!("n_max to {}", about(near))),
    );
    let long = VarianceTime::new(1, 1 << 40).expect("a ladder");
    let taus = [20, 8, 0].map(|apart| long.tau(((1u64 << 40) - (1 << apart)) as f64));
    let rising = taus.windows(2).all(|pair| pair[0] <= pair[1]) && taus[0] < 1.0 && taus[2] <= 1.0;
    add(
        "tau of 2^40 - 2^20, 2^40 - 2^8 and 2^40 - 1 of 2^40 samples".into(),
        "increasing, and never above 1",
        held(
            rising,
            format!(
                "1 - tau is {}, {} and {}: at the end of a ladder of this length, counts within 256 of each other have \
                 the same tau",
                about(1.0 - taus[0]),
                about(1.0 - taus[1]),
                about(1.0 - taus[2])
            ),
        ),
    );
    for kind in [TimeGrid::Ladder, TimeGrid::Uniform] {
        let fine = [1usize, 2, 9, 50, 1000, 100_000].into_iter().all(|steps| {
            let times = clock.grid(1.0, steps, kind);
            times.len() == steps + 1 && times[0] == 0.0 && times[steps] == 1.0 && times.windows(2).all(|w| w[0] < w[1])
        });
        add(
            format!("grids of 1 to 100,000 steps, {kind:?}").to_lowercase(),
            "increasing, from exactly 0 to exactly 1",
            held(fine, "as expected".into()),
        );
    }
    let lists = [vec![1u64, 3, 10, 11], vec![5, 6], vec![1, 1 << 40]];
    let fine = lists.iter().all(|list| Rungs::list(list.clone()).is_ok_and(|found| found.counts() == *list));
    let bad = [vec![], vec![0, 1], vec![2, 2], vec![3, 1]];
    let refused = bad.iter().all(|list| Rungs::list(list.clone()).is_err()) && Rungs::dyadic(48).is_err();
    add(
        "rungs that are not powers of two; no rungs, equal rungs, decreasing rungs".into(),
        "accepted; refused",
        held(fine && refused, "as expected".into()),
    );
    let infinite = [1.0, 1e6, 1e15].map(SdeTime::of_count);
    let off = infinite.iter().zip([1.0, 1e6, 1e15]).map(|(s, n)| (s.count() / n - 1.0).abs()).fold(0.0, f64::max);
    let below = infinite.iter().all(|s| s.0 < 1.0);
    add(
        "the SDE's clock at up to 1e15 samples".into(),
        "s below 1, and its inverse",
        held(below && off < 1e-6, format!("round trip to {}: 1 - s has lost half of its digits", about(off))),
    );
    out
}

fn solvers() -> Vec<Hazard> {
    let mut out = Vec::new();
    let mut add =
        |fed: String, must: &str, came: Result<String, String>| out.push(Hazard::new(SOLVERS, fed, must, came));
    let clock = VarianceTime::new(1, 512).expect("a ladder");
    let noisy = image(&[0.0, 7.0, 0.3, 1e6, 1e-6, 100.0]);
    let clean = image(&[0.5, 2.0, 0.3, 0.4, 2e-6, 1e4]);
    let run = |kind, space, steps: usize, noisy: &Image, clean: &Image| {
        let oracle = Oracle { kind, space, clock, start: noisy.clone(), clean: clean.clone() };
        rollout(&oracle, noisy, None, Course { from: 1, steps, grid: TimeGrid::Ladder }).map_err(|e| e.to_string())
    };
    for (first, last) in [(3u64, 20u64), (7, 8)] {
        let clock = VarianceTime::new(first, last).expect("a ladder");
        let came = Parameterization::ALL.into_iter().try_fold(0.0f64, |worst, kind| {
            [Space::Linear, Space::Log1p].into_iter().try_fold(worst, |worst, space| {
                [TimeGrid::Ladder, TimeGrid::Uniform].into_iter().try_fold(worst, |worst, grid| {
                    [1usize, 9, 1000].into_iter().try_fold(worst, |worst, steps| {
                        let oracle = Oracle { kind, space, clock, start: noisy.clone(), clean: clean.clone() };
                        let end = rollout(&oracle, &noisy, None, Course { from: first, steps, grid });
                        Ok::<_, String>(worst.max(apart(&end.map_err(|e| e.to_string())?, &clean)[0]))
                    })
                })
            })
        });
        add(
            format!(
                "exact predictions, all four parameterizations, on a ladder from {first} to {last} samples, both \
                 spaces and grids, 1, \
                 9 and 1,000 steps"
            ),
            "the clean image, to 1e-4 of a value",
            came.and_then(|off| held(off < OTHERS, format!("off by {}", about(off)))),
        );
    }
    // The last step of two of them lands on the estimate whatever came before it: all are seen on the way, too.
    let on_the_way = |kind, space, steps: usize, noisy: &Image, clean: &Image| {
        let oracle = Oracle { kind, space, clock, start: noisy.clone(), clean: clean.clone() };
        let course = Course { from: 1, steps, grid: TimeGrid::Ladder };
        rollout_to(&oracle, noisy, None, course, 64.0).map_err(|e| e.to_string())
    };
    for space in [Space::Linear, Space::Log1p] {
        let expected = between(space, clock.tau(64.0), &noisy, &clean);
        for kind in Parameterization::ALL {
            let worst = [1usize, 2, 9, 50, 1000].into_iter().try_fold([0.0f64; 5], |worst, steps| {
                let [way, way_firefly] = apart(&on_the_way(kind, space, steps, &noisy, &clean)?, &expected);
                let [end, end_firefly] = apart(&run(kind, space, steps, &noisy, &clean)?, &clean);
                let share = |off: f64, truth: &Image| off / digits(space, steps, f64::from(truth.pixel(FIREFLY, 0)[0]));
                let share = share(way_firefly, &expected).max(share(end_firefly, &clean));
                let found = [way, end, way_firefly, end_firefly, share];
                let most: [f64; 5] = std::array::from_fn(|i| f64::max(worst[i], found[i]));
                Ok::<_, String>(most)
            });
            let came = worst.and_then(|[way, end, way_firefly, end_firefly, share]| {
                let said = format!(
                    "other pixels (relative): off by {} at 64 samples and by {} at the end; firefly (absolute): off by \
                     {} and by {}",
                    about(way),
                    about(end),
                    about(way_firefly),
                    about(end_firefly)
                );
                held(way < OTHERS && end < OTHERS && share < 1.0, said)
            });
            let most = match space {
                Space::Linear => "0.06 of radiance (the spacing of single precision at 1e6)",
                Space::Log1p => "1e-6 (1 + value) of radiance (the spacing of single precision at log(1e6))",
            };
            add(
                format!(
                    "{} with exact predictions in {} space, 1 to 1,000 steps, with a firefly of 1e6 whose true value \
                     is 0.4",
                    kind.name(),
                    space.name()
                ),
                &format!(
                    "at 64 samples of 512, the fraction tau of the way; at the end the clean image; tolerance for the \
                     firefly {most} times the square root of four roundings per step, absolute; for the other pixels \
                     1e-4, relative"
                ),
                came,
            );
        }
        let came = [1usize, 9, 1000].into_iter().try_fold(0.0f64, |worst, steps| {
            let [a, b] = [Parameterization::McNoise, Parameterization::McVelocity]
                .map(|kind| on_the_way(kind, space, steps, &noisy, &clean));
            Ok::<_, String>(worst.max(difference(&a?, &b?)))
        });
        add(
            format!(
                "mc_noise and mc_velocity with the same exact predictions, v = -eps/(1 - tau), 1 to 1,000 steps to 64 \
                 samples of 512, {} space",
                space.name()
            ),
            "the same image",
            came.and_then(|apart| held(apart < 1e-4, format!("within {} of each other", about(apart)))),
        );
    }
    super::drift::oracles(&mut add);
    for (name, value) in [("black", 0.0f32), ("constant", 0.7)] {
        let flat = image(&[value; 8]);
        let came = Parameterization::ALL.into_iter().try_fold(0.0f64, |worst, kind| {
            let off = difference(&run(kind, Space::Log1p, 9, &flat, &flat)?, &flat);
            Ok::<_, String>(worst.max(off).max(difference(&on_the_way(kind, Space::Log1p, 9, &flat, &flat)?, &flat)))
        });
        let came = came.and_then(|off| held(off < 1e-5, format!("to {}", about(off))));
        add(
            format!("a {name} image that is already clean, all four parameterizations, at 64 samples and at the end"),
            "unchanged",
            came,
        );
    }
    // Where 1 - tau is small, v = -eps/(1 - tau) is large: endpoints next to the last rung of a long ladder.
    let late = VarianceTime::new(1, 1 << 40).expect("a ladder");
    let (from, half) = ((1u64 << 40) - (1 << 20), ((1u64 << 40) - (1 << 19)) as f64);
    let share = (late.tau(half) - late.tau(from as f64)) / (1.0 - late.tau(from as f64));
    let expected = between(Space::Linear, share, &noisy, &clean);
    let came =
        [Parameterization::McNoise, Parameterization::McVelocity].into_iter().try_fold([0.0f64; 4], |worst, kind| {
            let oracle = Oracle { kind, space: Space::Linear, clock: late, start: noisy.clone(), clean: clean.clone() };
            let course = Course { from, steps: 50, grid: TimeGrid::Ladder };
            let way = rollout_to(&oracle, &noisy, None, course, half).map_err(|e| e.to_string())?;
            let end = rollout(&oracle, &noisy, None, course).map_err(|e| e.to_string())?;
            let ([way, way_firefly], [end, end_firefly]) = (apart(&way, &expected), apart(&end, &clean));
            let found = [way, end, way_firefly, end_firefly];
            let most: [f64; 4] = std::array::from_fn(|i| f64::max(worst[i], found[i]));
            Ok::<_, String>(most)
        });
    add(
        "both from 2^40 - 2^20 to 2^40 samples, where 1 - tau is 5e-13".into(),
        "half of the samples later, half of the way; at the end the clean image; tolerance for the firefly 0.06 of \
         radiance times the square root of four roundings per step, absolute; for the other pixels 1e-4, relative",
        came.and_then(|[way, end, way_firefly, end_firefly]| {
            let said = format!(
                "other pixels (relative): off by {} half of the way and by {} at the end; firefly (absolute): off by \
                 {} and by {}",
                about(way),
                about(end),
                about(way_firefly),
                about(end_firefly)
            );
            let firefly = way_firefly.max(end_firefly) < digits(Space::Linear, 50, 0.4);
            held((share - 0.5).abs() < 1e-3 && way < OTHERS && end < OTHERS && firefly, said)
        }),
    );
    let outside = [(0usize, 1u64), (2, 512), (2, 513), (2, 0)].into_iter().all(|(steps, from)| {
        let oracle = Oracle {
            kind: Parameterization::McNoise,
            space: Space::Linear,
            clock,
            start: noisy.clone(),
            clean: clean.clone(),
        };
        rollout(&oracle, &noisy, None, Course { from, steps, grid: TimeGrid::Ladder }).is_err()
    });
    add(
        "no steps; a start at the last rung, after the last rung, and at 0".into(),
        "refused",
        held(outside, "refused".into()),
    );
    for (space, value) in [(Space::Log1p, 1e38f32), (Space::Log1p, -1e38)] {
        let came = match run(Parameterization::McNoise, space, 2, &image(&[1.0, value]), &image(&[1.0, 1.0])) {
            Err(told) => held(told.contains("exceed") && told.contains("log1p"), "refused, with their number".into()),
            Ok(_) => Err("accepted".into()),
        };
        add(
            format!("an endpoint of {value:.0e} in log1p space, whose limit is 6e37"),
            "refused with a specific error: nothing is clamped",
            came,
        );
    }
    for value in [f32::NAN, f32::INFINITY] {
        let mut gbuffer = Image::new(noisy.width(), noisy.height(), 6);
        gbuffer.data_mut()[3] = value;
        let oracle = Oracle {
            kind: Parameterization::McNoise,
            space: Space::Linear,
            clock,
            start: noisy.clone(),
            clean: clean.clone(),
        };
        let course = Course { from: 1, steps: 2, grid: TimeGrid::Ladder };
        let came = match rollout(&oracle, &noisy, Some(&gbuffer), course).map_err(|e| e.to_string()) {
            Err(told) => held(told.contains("G-buffer") && told.contains('1'), "refused, with their number".into()),
            Ok(_) => Err("accepted".into()),
        };
        add(format!("a G-buffer with a value of {value}"), "refused with a specific error", came);
    }
    for value in [f32::NAN, f32::INFINITY] {
        let mut broken = noisy.clone();
        broken.data_mut()[4] = value;
        let came = match run(Parameterization::McNoise, Space::Linear, 2, &broken, &clean) {
            Err(told) => held(told.contains("finite") && told.contains('1'), "refused, with their number".into()),
            Ok(_) => Err("accepted".into()),
        };
        add(format!("an endpoint with a pixel of {value}"), "refused with a specific error", came);
    }
    out
}
