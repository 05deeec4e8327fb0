use super::*;
use crate::{
    law::{Factors, Law},
    network::{Features, Output, Preset},
    space::Space,
};
use std::collections::BTreeSet;
use tauflow_data::methods::Parameterization;

const COUNTS: [u64; 3] = [1, 4, 16];
const SIDE: usize = 12;
const PLAIN: Draw = Draw { seed: 3, batch: 6, side: 8, ..Draw::PLAIN };

/// Pixels that name themselves: scene, rung and place.
fn set(scenes: usize) -> DataSet {
    DataSet::new(
        (0..scenes).map(|s| ("scene", sized(SIDE, SIDE, 10_000.0 * s as f32))).collect(),
        "train",
        Conditioning::Gbuffer,
    )
    .expect("fits")
}

/// A scene of so many columns and rows, whose values are this and their place, and 1,000 more for each rung.
fn sized(width: usize, height: usize, of: f32) -> PackedScene {
    let image = |rung: usize| {
        let data = (0..width * height * 3).map(|i| of + (1000 * rung + i) as f32).collect();
        Image::from_data(width, height, 3, data).expect("fits")
    };
    let gbuffer = (0..width * height * 6).map(|i| i as f32).collect();
    PackedScene {
        counts: COUNTS.to_vec(),
        states: (0..3).map(image).collect(),
        gbuffer: Some(Image::from_data(width, height, 6, gbuffer).expect("fits")),
        sampler: Default::default(),
    }
}

#[test]
fn films_of_several_sizes_give_windows_from_all_over_each() {
    let scenes = vec![("small", sized(12, 10, 0.0)), ("large", sized(20, 16, 100_000.0))];
    let set = DataSet::new(scenes, "train", Conditioning::Gbuffer).expect("rungs are the same");
    assert_eq!((set.side(64, 2, Loss::Squared).expect("fits"), set.side(9, 4, Loss::Squared).expect("fits")), (10, 8));
    let encoding = encoding(Parameterization::McNoise);
    let mut seen = [BTreeSet::new(), BTreeSet::new()];
    for step in 0..400 {
        for shuffle_targets in [false, true] {
            let batch = set.draw(&encoding, &Draw { shuffle_targets, ..PLAIN }, step);
            for (i, state) in batch.states.iter().enumerate() {
                let scene = usize::from(state[0] >= 100_000.0);
                let gbuffer = batch.gbuffers[i].as_ref().expect("asked for");
                for (state, gbuffer) in state.chunks_exact(3).zip(gbuffer.chunks_exact(6)) {
                    let place = (state[0] - 100_000.0 * scene as f32) % 1000.0;
                    assert_eq!(gbuffer[0], 2.0 * place);
                    seen[scene].insert(place as usize / 3);
                }
            }
        }
    }
    assert_eq!(seen.map(|places| places.len()), [120, 320], "every pixel is seen");
    let all: usize = set.all(&encoding, 8, 4).map(|batch| batch.states.len()).sum();
    assert_eq!(all, 4);
}

fn encoding(parameterization: Parameterization) -> Encoding {
    let factors = Factors::new(parameterization, &[1, 4, 16], Law::Covariances).expect("a ladder");
    let (space, features, output, preset) = (Space::Linear, Features::Contrast, Output::Means, Preset::Tiny);
    Encoding { factors, space, gbuffer: true, features, output, preset }
}

#[test]
fn targets_are_those_of_the_real_rungs_pixel_by_pixel() {
    let (set, draw) = (set(4), Draw { seed: 3, batch: 6, shuffle_targets: false, ..PLAIN });
    let encoding = encoding(Parameterization::McNoise);
    let mut rungs = BTreeSet::new();
    for step in 0..20 {
        let batch = set.draw(&encoding, &draw, step);
        for (i, state) in batch.states.iter().enumerate() {
            let target = &batch.targets[i * 192..(i + 1) * 192];
            let rung = (state[0] as usize % 10_000) / 1000;
            rungs.insert(rung);
            // I_k - I_last, whatever the turn: 1000 for each rung between.
            assert!(target.iter().all(|t| *t == 1000.0 * (rung as f32 - 2.0)));
            let tau = batch.tau[i].expect("the network is told");
            assert!((tau - encoding.factors.clock().tau(COUNTS[rung] as f64)).abs() < 1e-12);
            // The G-buffer moves with the state: its first channel is twice the state's place.
            let gbuffer = batch.gbuffers[i].as_ref().expect("asked for");
            for (state, gbuffer) in state.chunks_exact(3).zip(gbuffer.chunks_exact(6)) {
                assert_eq!(gbuffer[0], 2.0 * (state[0] % 1000.0));
            }
        }
    }
    assert_eq!(rungs, BTreeSet::from([0, 1]));
}

#[test]
fn rungs_are_drawn_as_often_as_their_exponent_says() {
    let (set, encoding) = (set(3), encoding(Parameterization::McNoise));
    for (rung_exponent, expected) in [(0.0, 0.5), (0.5, 2.0 / 3.0), (1.0, 0.8), (4.0, 256.0 / 257.0)] {
        let draw = Draw { rung_exponent, batch: 50, ..PLAIN };
        let first =
            (0..80).flat_map(|step| set.draw(&encoding, &draw, step).tau).filter(|tau| *tau == Some(0.0)).count();
        let (share, deviation) = (first as f64 / 4000.0, (expected * (1.0f64 - expected) / 4000.0).sqrt());
        assert!((share - expected).abs() < 4.0 * deviation, "{rung_exponent}: {share} {expected}");
    }
}

#[test]
fn counts_are_hidden_as_often_as_asked_and_nothing_else_changes() {
    let (set, encoding) = (set(3), encoding(Parameterization::McNoise));
    let told = Draw { batch: 50, ..PLAIN };
    let mut hidden = 0;
    for step in 0..80 {
        let told = set.draw(&encoding, &told, step);
        let some = set.draw(&encoding, &Draw { unknown_counts: 0.3, batch: 50, ..PLAIN }, step);
        assert!(told.tau.iter().all(Option::is_some) && told.states == some.states && told.targets == some.targets);
        hidden += some.tau.iter().filter(|tau| tau.is_none()).count();
    }
    let deviation = (0.3f64 * 0.7 * 4000.0).sqrt();
    assert!((hidden as f64 - 1200.0).abs() < 4.0 * deviation, "{hidden}");
}

#[test]
fn targets_without_a_count_are_the_other_samples_of_the_last_rung() {
    let (set, encoding) = (set(3), encoding(Parameterization::McNoise));
    let plain = Draw { unknown_counts: 0.5, batch: 50, ..PLAIN };
    for step in 0..4 {
        let before = set.draw(&encoding, &plain, step);
        let after = set.draw(&encoding, &Draw { independent_targets: true, ..plain }, step);
        assert!(before.states == after.states && before.tau == after.tau);
        for (i, tau) in after.tau.iter().enumerate() {
            let rung = (after.states[i][0] as usize % 10_000) / 1000;
            // I_n - (N I_N - n I_n)/(N - n) = (I_n - I_N) N/(N - n).
            let (n, last) = (COUNTS[rung] as f32, COUNTS[2] as f32);
            let factor = if tau.is_none() { last / (last - n) } else { 1.0 };
            for at in i * 192..(i + 1) * 192 {
                let (found, expected) = (after.targets[at], before.targets[at] * factor);
                assert!((found - expected).abs() < 1.0, "{found} {expected}");
            }
        }
        assert!(after.tau.contains(&None) && after.tau.iter().any(Option::is_some));
    }
    assert_eq!(others((4.0, 1.0), (1.0, 4.0)), 0.0, "three others of 0");
    assert_eq!(others((4.1, 1.0), (1.0, 4.0)), 0.0, "rounding");
    assert_eq!(others((1.0, 1.0), (4.0, 4.0)), 5.0);
}

/// A scene whose rungs are even images of these values.
fn even(rungs: &[(u64, f32)]) -> DataSet {
    let scene = PackedScene {
        counts: rungs.iter().map(|(count, _)| *count).collect(),
        states: rungs.iter().map(|(_, v)| Image::from_data(8, 8, 3, vec![*v; 192]).expect("fits")).collect(),
        gbuffer: None,
        sampler: Default::default(),
    };
    DataSet::new(vec![("scene", scene)], "train", Conditioning::Rgb).expect("fits")
}

#[test]
fn corrected_targets_are_those_of_each_pixels_own_rung() {
    const RUNGS: [(u64, f32); 4] = [(2, 0.1), (4, 0.15), (8, 0.2), (16, 0.3)];
    let factors = Factors::new(Parameterization::McNoise, &RUNGS.map(|(count, _)| count), Law::Covariances);
    let encoding = Encoding {
        factors: factors.expect("a ladder"),
        space: Space::Log1p,
        gbuffer: false,
        ..encoding(Parameterization::McNoise)
    };
    let apart = Draw { unknown_counts: 1.0, independent_targets: true, batch: 20, ..PLAIN };
    for draw in [Draw { batch: 20, ..PLAIN }, apart, Draw { uneven_counts: 1.0, ..apart }] {
        let apart = draw.independent_targets;
        let mut seen = BTreeSet::new();
        for (loss, step) in
            [Loss::UnbiasedPreview, Loss::Structural, Loss::Preview].into_iter().flat_map(|loss| [(loss, 0), (loss, 1)])
        {
            let set = even(&RUNGS).for_loss(loss).expect("independent samples");
            let batch = set.draw(&encoding, &draw, step);
            for (at, (state, target)) in batch.states.concat().iter().zip(batch.targets.iter()).enumerate() {
                let rung = RUNGS.iter().position(|(_, value)| (value.ln_1p() - state).abs() < 1e-6).expect("a rung");
                let input = (RUNGS[rung].1, RUNGS[rung].0 as f32);
                let corrected = |f: &dyn Fn(f32) -> f32| unbiased([input, (0.2, 8.0), (0.3, 16.0)], apart, f);
                let expected = |f: &dyn Fn(f32) -> f32| match loss {
                    Loss::Preview => f(if apart { others(input, (0.3, 16.0)) } else { 0.3 }),
                    _ => corrected(f).0,
                };
                let log = state - target;
                assert!((log - expected(&f32::ln_1p)).abs() < 1e-5, "{rung}: {log} {}", expected(&f32::ln_1p));
                let preview = batch.previews.as_ref().map(|previews| previews[at]);
                assert_eq!(preview.is_some(), loss.is_unbiased());
                let noise = batch.noise.as_ref().map(|noise| noise[at]);
                assert_eq!(noise, loss.is_structural().then(|| corrected(&preview_of).1));
                assert!(preview.is_none_or(|preview| (preview - expected(&preview_of)).abs() < 1e-5));
                seen.insert(rung);
            }
        }
        assert_eq!(seen.len(), 3);
    }
    let mut correlated = even(&RUNGS);
    correlated.sampler = SamplerKind::Sobol;
    let told = correlated.for_loss(Loss::UnbiasedPreview).expect_err("Sobol' points").to_string();
    assert!(told.contains("independent"), "{told}");
}

#[test]
fn corrections_have_no_bias_whatever_the_noise_of_the_input() {
    // 32 samples of exponential distribution, mean 0.3. Groups of dark, middling and bright inputs of 4 or 8 of them.
    const DRAWS: usize = 150_000;
    let mut stream = Stream::new(1, &[]);
    let mut exponential = |count: usize| (0..count).map(|_| -0.3 * maths::log(1.0 - stream.uniform())).sum::<f64>();
    for count in [4usize, 8] {
        for apart in [false, true] {
            // By group, curve, and whether it is corrected: draws, sum and sum of squares of the errors.
            let mut found = [[[[0.0; 3]; 2]; 2]; 3];
            // The variances that are estimated for the second curve.
            let mut variances = [0.0; 3];
            for _ in 0..DRAWS {
                let sums = [exponential(count), exponential(16 - count), exponential(16)];
                let mean = |sum: f64, count: usize| ((sum / count as f64) as f32, count as f32);
                let input = mean(sums[0], count);
                let rungs = [input, mean(sums[0] + sums[1], 16), mean(sums.iter().sum(), 32)];
                let group = if input.0 < 0.25 {
                    0
                } else if input.0 < 0.35 {
                    1
                } else {
                    2
                };
                // The target's expectation, of the input's samples as they are.
                let clean = if apart { 0.3 } else { (sums[0] as f32 + 0.3 * (32 - count) as f32) / 32.0 };
                let plain = if apart { others(rungs[0], rungs[2]) } else { rungs[2].0 };
                let curves: [&dyn Fn(f32) -> f32; 2] = [&f32::ln_1p, &preview_of];
                variances[group] += f64::from(unbiased(rungs, apart, preview_of).1);
                for (found, f) in found[group].iter_mut().zip(curves) {
                    for (found, value) in found.iter_mut().zip([f(plain), unbiased(rungs, apart, f).0]) {
                        let error = f64::from(value - f(clean));
                        found.iter_mut().zip([1.0, error, error * error]).for_each(|(sum, part)| *sum += part);
                    }
                }
            }
            for (group, found) in found.iter().enumerate() {
                let [draws, sum, squares] = found[1][0];
                let (estimated, variance) = (variances[group] / draws, squares / draws - (sum / draws).powi(2));
                assert!((estimated / variance - 1.0).abs() < 0.25, "{group}: {estimated} {variance}");
                let of = |[draws, sum, squares]: [f64; 3]| {
                    let mean = sum / draws;
                    (mean, mean / ((squares / draws - mean * mean) / draws).sqrt())
                };
                let found = found.map(|curve| curve.map(of));
                println!("{count} samples, apart {apart}, group {group}: bias and standard errors {found:?}");
                for [(plain, _), (corrected, errors)] in found {
                    assert!(plain < 0.0, "noise makes curves darker: {found:?}");
                    assert!(errors.abs() < 4.0 || corrected.abs() < 0.1 * plain.abs(), "{found:?}");
                }
            }
        }
    }
}

#[test]
fn uneven_examples_have_tiles_of_two_rungs_and_targets_of_each_pixels_own() {
    let (set, encoding) = (set(3), encoding(Parameterization::McNoise));
    let even = Draw { unknown_counts: 0.5, independent_targets: true, batch: 50, ..PLAIN };
    let (mut mixed, mut rungs) = (0, BTreeSet::new());
    for step in 0..8 {
        let [before, after] = [0.0, 1.0].map(|uneven_counts| {
            let draw = Draw { uneven_counts, ..even };
            set.draw(&encoding, &draw, step)
        });
        assert_eq!(before.tau, after.tau);
        for (i, tau) in after.tau.iter().enumerate() {
            let (state, target) = (&after.states[i], &after.targets[i * 192..(i + 1) * 192]);
            if tau.is_some() {
                assert!(*state == before.states[i] && *target == before.targets[i * 192..(i + 1) * 192]);
                continue;
            }
            let own: Vec<usize> = state.iter().map(|value| *value as usize % 10_000 / 1000).collect();
            for (rung, target) in own.iter().zip(target) {
                let (n, last) = (COUNTS[*rung] as f32, COUNTS[2] as f32);
                let expected = (*rung as f32 - 2.0) * 1000.0 * last / (last - n);
                assert!((target - expected).abs() < 1.0, "{rung}: {target} {expected}");
            }
            rungs.extend(own.iter().copied());
            mixed += usize::from(own.iter().any(|rung| *rung != own[0]));
        }
    }
    // Tiles are as large as the window, or larger, and half of the pairs of rungs are pairs of one.
    assert!(mixed > 20, "{mixed}");
    assert_eq!(rungs, BTreeSet::from([0, 1]));
}

#[test]
fn shuffled_targets_come_from_another_scene() {
    // From rung to rung scene s rises by 1000 (s + 1), so that a target tells whose it is, and a state by 100,000 s.
    let packed = |scene: usize| {
        let image = |rung: usize| {
            let value = (100_000 * scene + 1000 * rung * (scene + 1)) as f32;
            Image::from_data(SIDE, SIDE, 3, vec![value; SIDE * SIDE * 3]).expect("fits")
        };
        let gbuffer = Some(Image::new(SIDE, SIDE, 6));
        (
            "scene",
            PackedScene {
                counts: COUNTS.to_vec(),
                states: (0..3).map(image).collect(),
                gbuffer,
                sampler: Default::default(),
            },
        )
    };
    let set = DataSet::new((0..3).map(packed).collect(), "train", Conditioning::Gbuffer).expect("fits");
    let encoding = encoding(Parameterization::McNoise);
    let mut pairs = BTreeSet::new();
    for step in 0..20 {
        for shuffle_targets in [false, true] {
            let batch = set.draw(&encoding, &Draw { shuffle_targets, ..PLAIN }, step);
            for (state, target) in batch.states.iter().zip(batch.targets.chunks_exact(192)) {
                let scene = (state[0] / 100_000.0).floor() as usize;
                let rung = ((state[0] - 100_000.0 * scene as f32) / (1000.0 * (scene + 1) as f32)).round();
                let whose = (-target[0] / (1000.0 * (2.0 - rung))).round() as usize - 1;
                assert_eq!(whose != scene, shuffle_targets, "{scene} {rung} {}", target[0]);
                pairs.insert((scene, whose));
            }
        }
    }
    assert_eq!(pairs.len(), 9, "every scene's targets reach every other scene: {pairs:?}");
}

/// A window of scene 0 that is not changed.
const UNTURNED: Pick = Pick {
    scene: 0,
    target: 0,
    rung: 0,
    t: 0.0,
    left: 2,
    top: 1,
    turn: 0,
    scale: 1.0,
    colours: 0,
    told: true,
    apart: false,
    patches: None,
    tiles: None,
};

#[test]
fn turns_are_eight_and_lose_no_pixel() {
    let pick = |turn| Pick { turn, ..UNTURNED };
    let all: BTreeSet<Vec<usize>> = (0..8).map(|turn| pick(turn).places((SIDE, SIDE), 4)).collect();
    assert_eq!(all.len(), 8);
    for places in &all {
        let sorted: BTreeSet<usize> = places.iter().copied().collect();
        assert_eq!(sorted, pick(0).places((SIDE, SIDE), 4).into_iter().collect());
        assert_eq!(sorted.len(), 16);
    }
    assert_eq!(pick(0).places((SIDE, SIDE), 4)[..2], [SIDE + 2, SIDE + 3]);
}

#[test]
fn shorter_ladders_give_examples_without_a_count_and_targets_of_their_own() {
    let short = |of: f32| {
        let scene = sized(SIDE, SIDE, of);
        PackedScene { counts: COUNTS[..2].to_vec(), states: scene.states[..2].to_vec(), ..scene }
    };
    let scenes = || vec![("short", short(0.0)), ("whole", sized(SIDE, SIDE, 10_000.0)), ("other", short(20_000.0))];
    let set = DataSet::new(scenes(), "train", Conditioning::Gbuffer).expect("rungs of one ladder");
    assert!(set.counts == COUNTS && !set.is_whole());
    let encoding = encoding(Parameterization::McNoise);
    let draw = Draw { unknown_counts: 0.5, independent_targets: true, batch: 50, rung_exponent: 0.5, ..PLAIN };
    let mut seen = BTreeSet::new();
    for (step, uneven_counts) in (0..20).flat_map(|step| [0.0, 0.5].map(|uneven| (step, uneven))) {
        let batch = set.draw(&encoding, &Draw { uneven_counts, ..draw }, step);
        for (i, tau) in batch.tau.iter().enumerate() {
            let targets = batch.targets[i * 192..].iter();
            for (state, target) in batch.states[i].iter().zip(targets) {
                let (scene, rung) = ((*state / 10_000.0) as usize, *state as usize % 10_000 / 1000);
                let last = if scene == 1 { 2 } else { 1 };
                let counts = [rung, last].map(|rung| COUNTS[rung] as f32);
                let factor = if tau.is_none() { counts[1] / (counts[1] - counts[0]) } else { 1.0 };
                let expected = 1000.0 * (rung as f32 - last as f32) * factor;
                assert!((target - expected).abs() < 1.0, "{scene} {rung}: {target} {expected}");
                seen.insert((scene, rung, tau.is_some()));
            }
        }
    }
    let whole = [(1, 0, false), (1, 0, true), (1, 1, false), (1, 1, true)];
    assert_eq!(seen, BTreeSet::from_iter(whole.into_iter().chain([(0, 0, false), (2, 0, false)])));
    // Other rungs, not fewer.
    let mut scenes = scenes();
    scenes[0].1.counts = vec![1, 8];
    let told = DataSet::new(scenes, "train", Conditioning::Gbuffer).expect_err("no rung of 8").to_string();
    assert!(told.contains("scene short") && told.contains("[1, 8]") && told.contains("whole has [1, 4, 16]"), "{told}");
    let one = PackedScene { counts: vec![1], ..sized(SIDE, SIDE, 0.0) };
    let told = DataSet::new(vec![("one", one)], "train", Conditioning::Gbuffer).expect_err("one rung").to_string();
    assert!(told.contains("1 rungs; training needs at least two"), "{told}");
}

#[test]
fn patches_lie_over_states_targets_and_gbuffers_alike_and_change_nothing_else() {
    let (set, encoding) = (set(3), encoding(Parameterization::McNoise));
    let draw = Draw { unknown_counts: 0.5, independent_targets: true, uneven_counts: 0.5, batch: 50, ..PLAIN };
    let (mut patched, mut covered, mut edges) = (0, 0, 0);
    for step in 0..8 {
        let [before, after] =
            [0.0, 0.4].map(|patches| set.draw(&encoding, &Draw { patches, permute_colours: true, ..draw }, step));
        assert_eq!(before.tau, after.tau);
        for i in 0..50 {
            let of = |batch: &Batch| {
                let gbuffer = batch.gbuffers[i].clone().expect("asked for");
                (batch.states[i].clone(), batch.targets[i * 192..(i + 1) * 192].to_vec(), gbuffer)
            };
            let (before, after) = (of(&before), of(&after));
            patched += usize::from(before != after);
            for pixel in 0..64 {
                let (colours, features) = (3 * pixel..3 * pixel + 3, 6 * pixel..6 * pixel + 6);
                if after.2[features.clone()] == before.2[features.clone()] {
                    assert!(after.0[colours.clone()] == before.0[colours.clone()]);
                    assert!(after.1[colours.clone()] == before.1[colours]);
                } else {
                    // The G-buffer of the scene has values of some hundreds. Where nothing of it is seen, nothing is
                    // noise, but for pixels between two patches.
                    let noise_free = after.1[colours].iter().all(|target| target.abs() < 0.05);
                    let hidden = after.2[features].iter().all(|value| value.abs() <= 1.0);
                    covered += usize::from(noise_free && hidden);
                    edges += usize::from(!noise_free || !hidden);
                }
            }
        }
    }
    let deviation = (0.4f64 * 0.6 * 400.0).sqrt();
    // Some patches lie beside the window.
    assert!((patched as f64) < 160.0 + 4.0 * deviation && patched > 80, "{patched}");
    assert!(covered > 1000 && edges > 100 && edges < covered, "{covered} {edges}");
}

#[test]
fn exposure_and_colours_change_on_state_target_and_albedo_alike() {
    let set = set(4);
    let encoding = encoding(Parameterization::McNoise);
    let draw = Draw { exposure_jitter: 2.0, permute_colours: true, ..PLAIN };
    let mut orders = BTreeSet::new();
    for step in 0..20 {
        let batch = set.draw(&encoding, &draw, step);
        for (i, state) in batch.states.iter().enumerate() {
            let target = &batch.targets[i * 192..(i + 1) * 192];
            let gbuffer = batch.gbuffers[i].as_ref().expect("asked for");
            // Channels of a pixel follow each other by 1 where colours are in order, whatever the exposure.
            let order = [gbuffer[1] - gbuffer[0], gbuffer[2] - gbuffer[0]];
            let scale = (state[1] - state[0]) / order[0];
            assert!((0.25..=4.0).contains(&scale), "{scale}");
            assert!((state[2] - state[0] - scale * order[1]).abs() < 1e-2 * scale);
            let rung = (target[0] / (1000.0 * scale)).round();
            assert!(rung == -1.0 || rung == -2.0, "{rung}");
            // Differences of 1 between values of 10,000: a scale of three digits.
            assert!(target.iter().all(|t| (t / scale - 1000.0 * rung).abs() < 30.0));
            orders.insert(order.map(|o| o as i32));
        }
    }
    assert_eq!(orders.len(), 6);
}

/// A bump seen from the front: normals lean away from the middle, so that turning it as a picture changes nothing.
#[test]
fn normals_turn_with_the_picture() {
    let side = 6;
    let bump = |i: usize| {
        let (right, down) = ((i % side) as f32 - 2.5, (i / side) as f32 - 2.5);
        [0.1, 0.2, 0.3, right, -down, 1.0]
    };
    let image = Image::from_data(side, side, 6, (0..side * side).flat_map(bump).collect()).expect("fits");
    for turn in 0..8 {
        let pick = Pick { left: 0, top: 0, turn, ..UNTURNED };
        let turned = pick.turned(&image, &pick.places((side, side), side));
        assert_eq!(turned, image.data(), "{turn}");
    }
}

#[test]
fn a_batch_depends_on_seed_and_step_alone() {
    let (set, encoding) = (set(3), encoding(Parameterization::McVelocity));
    let draw = Draw { seed: 3, batch: 4, shuffle_targets: false, ..PLAIN };
    let states = |draw: &Draw, step| set.draw(&encoding, draw, step).states;
    assert_eq!(states(&draw, 7), states(&draw, 7));
    assert_ne!(states(&draw, 7), states(&draw, 8));
    assert_ne!(states(&draw, 7), states(&Draw { seed: 4, ..draw }, 7));
    let varied = Draw { exposure_jitter: 2.0, permute_colours: true, ..draw };
    let (plain, varied) = (set.draw(&encoding, &draw, 7), set.draw(&encoding, &varied, 7));
    assert_ne!(plain.states, varied.states);
    assert_eq!(set.side(128, 8, Loss::Squared).expect("12 pixels"), 8);
    assert!(set.side(4, 8, Loss::Squared).is_err());
    let told = set.side(128, 8, Loss::Structural).expect_err("its window has 11 pixels").to_string();
    assert!(told.contains("12 x 12") && told.contains("the minimum of 16 pixels"), "{told}");
}
