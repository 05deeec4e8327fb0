//! Predictions of the variance law for solvers: rollouts of a network that knows the converged image and predicts the
//! expectation of its target. `cargo test --release -p tauflow-train --test law -- --nocapture` prints the figures that
//! docs/study quotes.

use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    time::{TimeGrid, VarianceTime},
};
use tauflow_train::{Course, Denoiser, Parameterization, Space, bridge_stop, local_steps, rollout};

const LAST: u64 = 512;
const CALLS: [usize; 5] = [1, 2, 9, 20, 50];

/// The mean is 0, so that a state is its own noise.
struct Informed(Parameterization);

impl Denoiser for Informed {
    fn parameterization(&self) -> Parameterization {
        self.0
    }

    fn space(&self) -> Space {
        Space::Linear
    }

    fn clock(&self) -> VarianceTime {
        VarianceTime::new(1, LAST).expect("a ladder")
    }

    fn predict(&self, state: &Image, _: Option<&Image>, tau: Option<f64>) -> Result<Image, KindError> {
        let tau = tau.expect("a rollout tells the time");
        let (clock, count) = (self.clock(), self.clock().count(tau));
        // Given I_n, the expectation of I_m is (1 - n/m) of the way to the mean.
        let way = |to: f64| 1.0 - count / to;
        let factor = match self.0 {
            Parameterization::McNoise => way(LAST as f64),
            Parameterization::McVelocity => -way(LAST as f64) / (1.0 - tau),
            // Between rungs as at rungs: to twice as many samples.
            Parameterization::LocalVelocity => -way(2.0 * count) / (clock.tau(2.0 * count) - tau),
            Parameterization::VanillaRf => unreachable!("its inputs are interpolants, of which the law says nothing"),
        };
        Ok(state.map(|noise| noise * factor as f32))
    }
}

/// One pixel, of noise 1.
fn noisy() -> Image {
    Image::from_data(1, 1, 3, vec![1.0; 3]).expect("fits")
}

/// What is left of the noise of 1 sample after a rollout.
fn left(parameterization: Parameterization, steps: usize, grid: TimeGrid) -> f64 {
    let end = rollout(&Informed(parameterization), &noisy(), None, Course { from: 1, steps, grid }).expect("in range");
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
fn by_the_law_a_local_step_is_the_better_bridge() {
    let adjacent: Vec<(u64, u64)> = (1..10).map(|k| (k, k + 1)).collect();
    let direct: Vec<(u64, u64)> = (1..9).map(|k| (k, 10)).collect();
    let noise = Informed(Parameterization::McNoise);
    let local = Informed(Parameterization::LocalVelocity);
    let along_time = |k, m| f64::from(bridge_stop(&noise, &noisy(), None, k, m).expect("within the ladder").data()[0]);
    let stepped = |k, m| f64::from(local_steps(&local, &noisy(), None, k, m).expect("within the ladder").data()[0]);
    for (name, cases, least) in [("adjacent", &adjacent, 0.1), ("direct", &direct, 0.5)] {
        let (along, stepped) = (gain(cases, along_time), gain(cases, stepped));
        let best = gain(cases, |k, m| k as f64 / m as f64);
        println!(
            "bridge, {name}: {along:.2} dB above hold along variance time, {stepped:.2} by local steps, \
             {best:.2} at best"
        );
        assert!(along > 0.0 && stepped > along + least, "{name}: {along} {stepped}");
        assert!(best >= stepped && best < stepped + 0.1, "local steps take the expectation: {best} {stepped}");
    }
}
