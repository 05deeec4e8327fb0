//! Predictions of the variance law for solvers: rollouts of a network that knows the converged image and predicts the
//! expectation of its target. `cargo test --release -p tauflow-train --test law -- --nocapture` prints the figures that
//! docs/study quotes.

use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    rng::Stream,
    time::{TimeGrid, VarianceTime},
};
use tauflow_train::{
    Course, Denoiser, Factors, Law, LocalRule, Parameterization, Space, bridge_stop, local_path, rollout,
};

const LAST: u64 = 512;
const RUNGS: [u64; 10] = [1, 2, 4, 8, 16, 32, 64, 128, 256, LAST];
const CALLS: [usize; 5] = [1, 2, 9, 20, 50];

/// Predicts as the head of a trained network does with the right mean, which is 0: a state is its own noise.
struct Informed(Factors);

impl Informed {
    fn new(parameterization: Parameterization) -> Self {
        Self(Factors::new(parameterization, &RUNGS, Law::Covariances).expect("a ladder"))
    }
}

impl Denoiser for Informed {
    fn parameterization(&self) -> Parameterization {
        self.0.parameterization()
    }

    fn space(&self) -> Space {
        Space::Linear
    }

    fn clock(&self) -> VarianceTime {
        self.0.clock()
    }

    fn predict(&self, state: &Image, _: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        let factor = self.0.at(tau);
        Ok(state.map(|noise| (f64::from(-noise) * factor) as f32))
    }
}

/// One pixel, of noise 1.
fn noisy() -> Image {
    Image::from_data(1, 1, 3, vec![1.0; 3]).expect("fits")
}

/// What is left of the noise of 1 sample after a rollout.
fn left(parameterization: Parameterization, steps: usize, grid: TimeGrid) -> f64 {
    let end =
        rollout(&Informed::new(parameterization), &noisy(), None, Course { from: 1, steps, grid }).expect("in range");
    f64::from(end.data()[0])
}

#[test]
fn a_local_velocity_that_is_poor_at_50_calls_is_not_so_by_the_law() {
    for grid in [TimeGrid::Ladder, TimeGrid::Uniform] {
        let noise = CALLS.map(|steps| left(Parameterization::LocalVelocity, steps, grid));
        println!("noise left by local velocity, grid {grid:?}, NFE {CALLS:?}: {noise:.4?}");
        // One secant, taken for the whole way, goes far beyond the mean.
        assert!((noise[0] + 0.632).abs() < 1e-3, "{}", noise[0]);
        // The reference has a share of 1/sqrt(512) = 0.044 of that noise itself.
        assert!(noise[2..].iter().all(|noise| noise.abs() < 0.005), "{noise:?}");
    }
    // On the ladder's own rungs each step halves what there is.
    let halved = left(Parameterization::LocalVelocity, 9, TimeGrid::Ladder);
    assert!((halved - 0.5f64.powi(9)).abs() < 1e-6, "{halved}");
}

#[test]
fn mc_velocity_and_mc_noise_go_the_same_way_by_the_law() {
    for grid in [TimeGrid::Ladder, TimeGrid::Uniform] {
        let [velocity, noise] = [Parameterization::McVelocity, Parameterization::McNoise]
            .map(|parameterization| CALLS.map(|steps| left(parameterization, steps, grid)));
        println!("noise left by mc_velocity and mc_noise, grid {grid:?}, NFE {CALLS:?}: {noise:.4?}");
        assert!(velocity.iter().zip(&noise).all(|(a, b)| (a - b).abs() < 1e-6), "{velocity:?} {noise:?}");
        // Both go to the last rung, which has kept a share of the state's noise: that is not on the way.
        assert!(
            (noise[0] - 1.0 / LAST as f64).abs() < 1e-6 && noise.iter().all(|noise| noise.abs() < 0.02),
            "{noise:?}"
        );
    }
}

#[test]
fn vanilla_rectified_flow_keeps_the_noise_of_the_last_rung_by_the_law() {
    let noise = CALLS.map(|steps| left(Parameterization::VanillaRf, steps, TimeGrid::Uniform));
    println!("noise left by vanilla_rf, grid Uniform, NFE {CALLS:?}: {noise:.4?}");
    // One call goes to the expectation of the last rung.
    assert!((noise[0] - 1.0 / LAST as f64).abs() < 1e-6, "{noise:?}");
    // Its flow turns the distribution of the first rung into that of the last, of 1/sqrt(512) of the deviation.
    let whole = left(Parameterization::VanillaRf, 20_000, TimeGrid::Uniform);
    assert!((whole - (LAST as f64).sqrt().recip()).abs() < 1e-4, "{whole}");
    assert!(noise.windows(2).all(|pair| pair[0] < pair[1]) && noise[4] < whole, "{noise:?}");
}

/// The share of the way to the mean that targets go, by least squares over draws and by the law.
///
/// The draws are states of a pixel of mean 1 in a space, with their targets.
fn shares(
    factors: &Factors,
    counts: &[u64],
    (rung, t): (usize, f64),
    space: Space,
    mut sample: impl FnMut() -> f64,
) -> (f64, f64) {
    let (clock, last) = (factors.clock(), counts.len() - 1);
    let tau = |rung: usize| clock.tau(counts[rung] as f64);
    let centre = f64::from(space.encode(1.0));
    let (mut product, mut square) = (0.0, 0.0);
    for _ in 0..60_000 {
        let (mut sum, mut drawn) = (0.0, 0);
        let rungs: Vec<f64> = counts
            .iter()
            .map(|count| {
                (drawn..*count).for_each(|_| sum += sample());
                drawn = *count;
                f64::from(space.encode((sum / *count as f64) as f32))
            })
            .collect();
        let (state, target) = match factors.parameterization() {
            Parameterization::McNoise => (rungs[rung], rungs[rung] - rungs[last]),
            Parameterization::McVelocity => (rungs[rung], (rungs[last] - rungs[rung]) / (1.0 - tau(rung))),
            Parameterization::LocalVelocity => {
                (rungs[rung], (rungs[rung + 1] - rungs[rung]) / (tau(rung + 1) - tau(rung)))
            }
            Parameterization::VanillaRf => ((1.0 - t) * rungs[0] + t * rungs[last], rungs[last] - rungs[0]),
        };
        product += target * (centre - state);
        square += (centre - state).powi(2);
    }
    let time = if factors.parameterization() == Parameterization::VanillaRf { t } else { tau(rung) };
    (product / square, factors.at(Some(time)))
}

#[test]
fn factors_of_heads_are_the_least_squares_of_targets_on_states() {
    let ladders: [&[u64]; 3] = [&[1, 2, 4, 8, 16], &[1, 3, 4, 12], &[4, 8, 32]];
    for (ladder, counts) in ladders.into_iter().enumerate() {
        for parameterization in Parameterization::ALL {
            let factors = Factors::new(parameterization, counts, Law::Covariances).expect("a ladder");
            for (place, (rung, t)) in [(0, 0.0), (1, 0.4), (counts.len() - 2, 0.8)].into_iter().enumerate() {
                let seed = [ladder as u64, place as u64];
                let found = |space: Space, deviation: f64| {
                    let mut stream = Stream::new(7, &seed);
                    shares(&factors, counts, (rung, t), space, || 1.0 + deviation * stream.normal())
                };
                let (linear, law) = found(Space::Linear, 1.0);
                assert!(
                    (linear - law).abs() < 0.04 * law.abs(),
                    "{parameterization:?} {counts:?} {rung}: {linear} {law}"
                );
                // Logarithms are linear where noise is small.
                let (log, _) = found(Space::Log1p, 0.05);
                assert!((log - law).abs() < 0.04 * law.abs(), "{parameterization:?} {counts:?} {rung}: {log} {law}");
                // Samples of path tracers: of heavy tails, as deviations of their mean.
                let mut stream = Stream::new(8, &seed);
                let mut draw = || -(1.0 - stream.uniform()).ln();
                let (loud, _) = shares(&factors, counts, (rung, t), Space::Log1p, &mut draw);
                println!(
                    "{} {counts:?}, rung {rung} or t {t}: law {law:.3}, linear {linear:.3}, log1p {log:.3} with noise \
                     of 5%, {loud:.3} with exponential samples",
                    parameterization.name()
                );
                assert!((loud - law).abs() < 0.35 * law.abs(), "{parameterization:?} {counts:?} {rung}: {loud} {law}");
            }
        }
    }
}

#[test]
fn by_the_law_of_earlier_versions_local_steps_were_too_long() {
    let at = |law| Factors::new(Parameterization::LocalVelocity, &RUNGS, law).expect("a ladder").at(Some(0.0));
    let ratio = at(Law::Covariances) / at(Law::Limits);
    assert!((ratio - 0.8536).abs() < 1e-3, "{ratio}");
}

/// The mean of gains over hold in dB of a stop from k to m, against the real I_m, which keeps k/m of I_k's noise and
/// has its own.
fn gain(cases: &[(u64, u64)], stop: impl Fn(u64, u64) -> f64) -> f64 {
    let error = |share: f64, k: u64, m: u64| {
        let (k, m) = (k as f64, m as f64);
        (share - k / m).powi(2) / k + (m - k) / (m * m)
    };
    let gains = cases.iter().map(|(k, m)| 10.0 * (error(1.0, *k, *m) / error(stop(*k, *m), *k, *m)).log10());
    gains.sum::<f64>() / cases.len() as f64
}

#[test]
fn by_the_law_a_local_step_is_the_better_bridge_and_a_local_delta_the_worse() {
    let adjacent: Vec<(u64, u64)> = (1..10).map(|k| (k, k + 1)).collect();
    let direct: Vec<(u64, u64)> = (1..9).map(|k| (k, 10)).collect();
    let noise = Informed::new(Parameterization::McNoise);
    let local = Informed::new(Parameterization::LocalVelocity);
    let only = |image: &Image| f64::from(image.data()[0]);
    let along_time =
        |k, m| only(&bridge_stop(&noise, &noisy(), None, (k, m), Space::Linear).expect("within the ladder"));
    let rolled = |rule| {
        let (local, only) = (&local, &only);
        move |k, m| {
            let path = local_path(local, &noisy(), None, (k, m), (Space::Linear, rule)).expect("within the ladder");
            only(path.last().expect("a step"))
        }
    };
    for (name, cases, least, deltas) in [("adjacent", &adjacent, 0.1, -1.27), ("direct", &direct, 0.5, 1.76)] {
        let (along, stepped) = (gain(cases, along_time), gain(cases, rolled(LocalRule::Step)));
        let whole = gain(cases, rolled(LocalRule::Delta));
        let best = gain(cases, |k, m| k as f64 / m as f64);
        println!(
            "bridge, {name}: {along:.2} dB above hold along variance time, {stepped:.2} by local steps, {whole:.2} by \
             local deltas, {best:.2} at best"
        );
        assert!(along > 0.0 && stepped > along + least, "{name}: {along} {stepped}");
        assert!(best >= stepped && best < stepped + 0.1, "local steps take the expectation: {best} {stepped}");
        assert!((whole - deltas).abs() < 0.005 && whole < along, "{name}: {whole}");
    }
}
