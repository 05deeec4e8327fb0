//! The kind `evaluation` over scores in memory: means, paired gains, curves, strata, infinite PSNRs, refusals.

use std::{
    collections::BTreeMap,
    sync::atomic::{AtomicBool, Ordering},
};
use tauflow_contract::{Action, Collection, Context, Handle, ItemKey, Kind, KindError, Media, MemoryBlobs, Silent};
use tauflow_data::{
    Stratum,
    methods::{HOLD, OIDN, Parameterization},
    records::{BASIC, ClaimVerdict, Evaluation, Metrics, SceneGroup, SceneScores, Score, SplitReport},
    scene::Side,
};
use tauflow_eval::{EvaluationKind, EvaluationParams, PSNR_CEILING, kinds};

const MC_NOISE: &str = Parameterization::McNoise.name();
const NFE: [u64; 5] = [1, 2, 9, 20, 50];

fn metrics(psnr: f64) -> Metrics {
    Metrics {
        hdr_psnr: psnr,
        hdr_psnr_max: psnr + 6.0,
        hdr_mae: 0.1 - psnr.min(90.0) / 1000.0,
        preview_psnr: psnr + 1.0,
        preview_mae: 0.05,
        ssim: 0.5,
        ..Metrics::default()
    }
}

fn score(method: &str, nfe: u64, psnr: f64) -> Score {
    Score { method: method.into(), from_spp: 1, to_spp: 256, nfe, metrics: metrics(psnr) }
}

/// PSNR of a scene's endpoint: scenes differ by far more than methods do.
fn base(index: u64) -> f64 {
    10.0 + 3.0 * (index % 7) as f64
}

fn scenes() -> Vec<(String, u64)> {
    Stratum::all().enumerate().map(|(i, s)| (s.item_key(i as u64).to_string(), i as u64)).collect()
}

/// The key of a view: of view 0 it is the scene's own.
fn view(scene: &str, view: u64) -> String {
    let (stratum, index) = Stratum::of_key(scene).expect("a scene's key");
    stratum.item_key(index + 1000 * view).to_string()
}

struct Bench {
    blobs: MemoryBlobs,
    stop: AtomicBool,
    scores: Collection,
    hold: Collection,
    baselines: Collection,
    split: Option<Collection>,
}

impl Bench {
    fn new() -> Self {
        Self::with_views(1)
    }

    /// So many scenes of each content, all of them with its scores.
    fn with_views(views: u64) -> Self {
        let mut bench = Self {
            blobs: MemoryBlobs::default(),
            stop: AtomicBool::new(false),
            scores: Collection::default(),
            hold: Collection::default(),
            baselines: Collection::default(),
            split: None,
        };
        for (scene, i) in scenes().iter().flat_map(|(scene, i)| (0..views).map(move |v| (view(scene, v), *i))) {
            bench.put(true, &scene, 256, vec![score(HOLD, 0, base(i))]);
            for conditioning in ["rgb", "gbuffer"] {
                let gain = if conditioning == "rgb" { 4.0 } else { 5.0 };
                // A little scatter that scenes do not share, and a curve that falls by 0.5 dB a step.
                let at = |(step, n): (usize, &u64)| {
                    score(MC_NOISE, *n, base(i) + gain + 0.1 * (i % 3) as f64 - 0.5 * step as f64)
                };
                let key = format!("parameterization=mc_noise+conditioning={conditioning}/{scene}");
                bench.put(false, &key, 256, NFE.iter().enumerate().map(at).collect());
            }
        }
        bench
    }

    fn put(&mut self, hold: bool, key: &str, reference_spp: u64, scores: Vec<Score>) {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let of = SceneScores { reference_spp, scores, note: None };
        let stored = of.store(&ctx).expect("stored");
        let to = if hold { &mut self.hold } else { &mut self.scores };
        to.items.insert(ItemKey::new(key).expect("a valid key"), stored.into_artifact());
    }

    fn run(&self, seed: u64) -> Result<Evaluation, KindError> {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let mut all = BTreeMap::from([("scores", &self.scores), ("hold", &self.hold), ("baselines", &self.baselines)]);
        all.extend(self.split.as_ref().map(|split| ("split", split)));
        let params = EvaluationParams { resamples: 500 };
        let action = Action { params, item: None, group: "main", seed, each: BTreeMap::new(), all };
        let out = EvaluationKind::run(&ctx, &action)?;
        Handle::<Evaluation>::new(out.collections["tables"].get("evaluation").expect("the item"))?.load(&ctx)
    }

    /// Connects a split that has so many views of each content.
    fn split_of(&mut self, views: u64) {
        let group = |(scene, i): (String, u64)| SceneGroup {
            signature: format!("content-{i}"),
            side: Side::Test,
            items: (0..views).map(|v| view(&scene, v)).collect(),
        };
        let report = SplitReport { groups: scenes().into_iter().map(group).collect(), ..SplitReport::default() };
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let stored = report.store(&ctx).expect("stored").into_artifact();
        self.split = Some([(ItemKey::new("report").expect("a valid key"), stored)].into_iter().collect());
    }

    fn refusal(&self) -> String {
        self.run(0).expect_err("refused").to_string()
    }
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found}, expected {expected}");
}

#[test]
fn solvers_are_held_against_baselines_and_absent_ones_are_told() {
    let mut bench = Bench::new();
    let ctx = Context::new(&bench.blobs, &Silent, &bench.stop);
    let mut baselines = Collection::default();
    for (scene, i) in scenes() {
        // Better than RGB by 1 dB in even scenes, worse by 2 dB in odd ones.
        let value = base(i) + 0.1 * (i % 3) as f64 + 4.0 + if i % 2 == 0 { 1.0 } else { -2.0 };
        let there = SceneScores { reference_spp: 256, scores: vec![score(OIDN, 1, value)], note: None };
        let absent = SceneScores { reference_spp: 256, scores: Vec::new(), note: Some("other: not here".into()) };
        for (cell, of) in [("method=oidn+conditioning=gbuffer", there), ("method=other", absent)] {
            let key = ItemKey::new(format!("{cell}/{scene}")).expect("a valid key");
            baselines.items.insert(key, of.store(&ctx).expect("stored").into_artifact());
        }
    }
    bench.baselines = baselines;
    let e = bench.run(7).expect("sound scores");
    assert_eq!(e.notes, ["other: not here"]);
    let [oidn] = &e.baselines[..] else { panic!("{:?}", e.baselines) };
    assert_eq!((oidn.method.as_str(), oidn.conditioning.as_str(), oidn.at.len()), ("oidn", "gbuffer", 1));
    assert!(oidn.auc.is_empty());
    assert_eq!(e.versus.len(), 2 * NFE.len());
    let versus = e.versus.iter().find(|v| v.nfe == 1 && v.cell["conditioning"] == "rgb").expect("a row");
    near(versus.gain["hdr_psnr"].mean, 0.5);
    near(versus.better["hdr_psnr"], 0.5);
    assert!(versus.gain["hdr_psnr"].low < 0.0 && versus.gain["hdr_psnr"].high > 0.0);
    assert_eq!(e.per_scene.len(), 12 + 2 * 12 * 5 + 12);
}

#[test]
fn means_gains_curves_and_strata() {
    let bench = Bench::new();
    let e = bench.run(7).expect("sound scores");
    assert_eq!((e.reference_spp, e.from_spp, e.scenes, e.resamples, e.nfe.as_slice()), (256, 1, 12, 500, &NFE[..]));
    assert_eq!(e.per_scene.len(), 12 + 2 * 12 * 5);
    let mean_base = scenes().iter().map(|(_, i)| base(*i)).sum::<f64>() / 12.0;
    near(e.hold["hdr_psnr"].mean, mean_base);
    assert_eq!(e.hold.len(), BASIC.len());

    let rgb = e.methods.iter().find(|m| m.conditioning == "rgb").expect("the cell");
    assert_eq!((rgb.method.as_str(), rgb.space.as_str(), rgb.cell.len()), ("mc_noise", "", 2));
    // 12 scenes have the scatters 0, .1, .2 alike often: .1 on average.
    let first = &rgb.at[0];
    near(first.metrics["hdr_psnr"].mean, mean_base + 4.1);
    let gain = first.gain["hdr_psnr"];
    near(gain.mean, 4.1);
    // Paired: the interval knows of the scatter of .1, not of the scenes' spread of some 6 dB.
    assert!(gain.low > 4.03 && gain.low < 4.1 && gain.high > 4.1 && gain.high < 4.17, "{gain:?}");
    assert!(e.hold["hdr_psnr"].high - e.hold["hdr_psnr"].low > 3.0);
    near(first.gain["hdr_mae"].mean, -4.1 / 1000.0);

    // Values fall by .5 dB at each of four steps; areas with the widths ln 2, ln 4.5, ln 20/9, ln 2.5.
    let (widths, range) = ([2f64.ln(), 4.5f64.ln(), (20.0f64 / 9.0).ln(), 2.5f64.ln()], 50f64.ln());
    let drop = widths.iter().zip([0.25, 0.75, 1.25, 1.75]).map(|(w, q)| w * q).sum::<f64>() / range;
    near(rgb.auc["hdr_psnr"].mean, mean_base + 4.1 - drop);
    near(rgb.tv["hdr_psnr"].mean, 2.0 / range);
    near(rgb.tv["ssim"].mean, 0.0);

    assert_eq!(first.strata.len(), 12);
    near(first.strata["L0-environment"]["hdr_psnr"], base(0) + 4.0);
    near(first.strata["L3-enclosed"]["hdr_psnr"], base(11) + 4.2);
    assert_eq!(bench.run(7).expect("again"), e, "the same seed gives the same tables");
    assert_ne!(bench.run(8).expect("again").hold, e.hold);
}

#[test]
fn an_infinite_psnr_counts_as_the_ceiling() {
    let mut bench = Bench::new();
    let (scene, _) = scenes().swap_remove(0);
    bench.put(true, &scene, 256, vec![score(HOLD, 0, f64::INFINITY)]);
    let e = bench.run(0).expect("sound scores");
    let rest = scenes().iter().skip(1).map(|(_, i)| base(*i)).sum::<f64>();
    near(e.hold["hdr_psnr"].mean, (rest + PSNR_CEILING) / 12.0);
    assert!(e.hold["hdr_psnr"].high.is_finite());
    let own = e.per_scene.iter().find(|r| r.cell.is_empty() && r.scene == scene).expect("a row of hold");
    assert!(own.score.metrics.hdr_psnr.is_infinite(), "the scene's own score keeps it");
}

#[test]
fn one_nfe_has_no_curve_and_plain_scores_need_no_cell() {
    let mut bench = Bench::new();
    bench.scores = Collection::default();
    for (scene, i) in scenes() {
        bench.put(false, &scene, 256, vec![score("my_solver", 1, base(i) + 1.0)]);
    }
    let e = bench.run(0).expect("sound scores");
    let method = &e.methods[0];
    assert_eq!((method.method.as_str(), method.conditioning.as_str()), ("my_solver", "rgb"));
    assert!(method.auc.is_empty() && method.tv.is_empty() && method.cell.is_empty());
    near(method.at[0].gain["hdr_psnr"].low, 1.0);
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let cell = "parameterization=mc_noise+conditioning=rgb";
    let key = |i: usize| format!("{cell}/{}", scenes()[i].0);
    let all = |psnr: f64| NFE.iter().map(|n| score(MC_NOISE, *n, psnr)).collect::<Vec<_>>();

    let mut bench = Bench::new();
    bench.scores.items.remove(key(3).as_str());
    let refusal = bench.refusal();
    assert!(refusal.contains(cell) && refusal.contains("L1-environment-000003"), "{refusal}");

    let mut bench = Bench::new();
    bench.hold.items.remove(scenes()[3].0.as_str());
    assert!(bench.refusal().contains("`hold` lacks a score of the scene `L1-environment-000003`"));

    let mut bench = Bench::new();
    bench.put(false, &key(0), 512, all(20.0));
    assert!(bench.refusal().contains("the reference is 256 samples"));

    let mut bench = Bench::new();
    let other = all(20.0).into_iter().map(|s| Score { from_spp: 4, ..s }).collect();
    bench.put(false, &key(0), 256, other);
    assert!(bench.refusal().contains("the start is 1 samples"));

    let mut bench = Bench::new();
    bench.put(false, &key(0), 256, all(20.0).split_off(1));
    assert!(bench.refusal().contains("refine all alike"));

    let mut bench = Bench::new();
    bench.put(true, &scenes()[0].0, 256, Vec::new());
    assert!(bench.refusal().contains("one score at each"));

    let mut bench = Bench::new();
    (bench.scores, bench.hold) = (Collection::default(), Collection::default());
    assert!(bench.refusal().contains("no scores"));

    let bench = Bench::new();
    bench.stop.store(true, Ordering::Relaxed);
    assert!(matches!(bench.run(0), Err(KindError::Cancelled)));
}

#[test]
fn every_kind_resolves_its_defaults() {
    for kind in kinds() {
        let spec = kind.spec();
        let resolved = kind.resolve(&serde_json::json!({})).expect("defaults are sound");
        assert_eq!(kind.resolve(&resolved).expect("resolved params are sound"), resolved, "{}", spec.name);
        assert!(spec.manual.contains(&format!("kind: {}", spec.name)), "{}", spec.name);
        assert!(kind.resolve(&serde_json::json!({"no_such_param": 1})).is_err(), "{}", spec.name);
    }
}

/// What schemas say is refused before params are read.
#[test]
fn schemas_refuse_what_no_kind_could_use() {
    let mut bounded = 0;
    for kind in kinds() {
        let (name, schema) = (kind.spec().name, kind.params_schema());
        let properties = &schema["properties"];
        if let Some(resamples) = properties.get("resamples") {
            assert_eq!((&resamples["minimum"], &resamples["maximum"]), (&100.into(), &100_000.into()), "{name}");
            bounded += 1;
        }
        for targets in ["psnr_targets", "rel_mse_targets"].iter().filter_map(|of| properties.get(*of)) {
            assert_eq!(targets["items"]["exclusiveMinimum"], 0.0, "{name}");
            bounded += 1;
        }
    }
    assert_eq!(bounded, 5 + 2);
}

#[test]
fn views_of_one_content_do_not_make_intervals_narrower() {
    let single = Bench::new().run(3).expect("sound scores");
    assert_eq!((single.scenes, single.groups), (12, None));
    let mut views = Bench::with_views(4);
    let plain = views.run(3).expect("sound scores");
    views.split_of(4);
    let grouped = views.run(3).expect("sound scores");
    assert_eq!((plain.scenes, plain.groups, grouped.scenes, grouped.groups), (48, None, 48, Some(12)));
    let width = |of: &Evaluation| of.hold["hdr_psnr"].high - of.hold["hdr_psnr"].low;
    // Four scenes that are one content count as one: the interval is that of the contents, and twice that of scenes.
    // Items come in another order, so the draws are others: 500 of them leave a tenth.
    assert!((width(&grouped) / width(&single) - 1.0).abs() < 0.2, "{} {}", width(&grouped), width(&single));
    assert!((width(&grouped) / width(&plain) - 2.0).abs() < 0.5, "{} {}", width(&grouped), width(&plain));
    for (a, b) in [(&grouped, &single), (&plain, &single)] {
        near(a.hold["hdr_psnr"].mean, b.hold["hdr_psnr"].mean);
        near(a.methods[0].at[0].gain["hdr_psnr"].mean, b.methods[0].at[0].gain["hdr_psnr"].mean);
    }
    let gain = |of: &Evaluation| of.methods[0].at[0].gain["hdr_psnr"];
    assert!(gain(&grouped).high - gain(&grouped).low > 1.3 * (gain(&plain).high - gain(&plain).low));
    // A split of other scenes is no help.
    views.split_of(3);
    let refused = views.refusal();
    assert!(refused.contains("`split` does not have the scene"), "{refused}");
}

#[test]
fn one_scene_or_one_content_decides_no_claim() {
    let verdicts = |of: &Evaluation| of.claims.iter().map(|claim| claim.verdict).collect::<Vec<_>>();
    let many = Bench::new().run(3).expect("sound scores");
    assert!(many.has_intervals() && verdicts(&many).contains(&ClaimVerdict::Held), "{:?}", many.claims);
    let first = |views: u64| {
        let mut bench = Bench::with_views(views);
        let own: Vec<String> = (0..views).map(|v| view(&scenes()[0].0, v)).collect();
        for of in [&mut bench.hold, &mut bench.scores] {
            of.items.retain(|key, _| own.iter().any(|scene| key.as_str().ends_with(scene.as_str())));
        }
        bench
    };
    let single = first(1).run(3).expect("sound scores");
    let mut views = first(4);
    views.split_of(4);
    let content = views.run(3).expect("sound scores");
    assert_eq!((single.scenes, content.scenes, content.groups), (1, 4, Some(1)));
    for of in [&single, &content] {
        assert!(!of.has_intervals());
        assert_eq!(verdicts(of), vec![ClaimVerdict::Undecided; many.claims.len()]);
        assert!(of.claims.iter().all(|claim| claim.evidence.iter().all(|e| e.difference.low == e.difference.high)));
    }
}

#[test]
fn metrics_on_request_are_summed_up_where_all_scores_have_them() {
    let flip = |of: &mut Collection, bench: &MemoryBlobs, value: f64| {
        let stop = AtomicBool::new(false);
        let ctx = Context::new(bench, &Silent, &stop);
        let changed: Collection = of
            .items
            .iter()
            .map(|(key, artifact)| {
                let mut scores = SceneScores::load(&ctx, artifact).expect("own scores");
                scores.scores.iter_mut().for_each(|score| score.metrics.flip = Some(value));
                (key.clone(), scores.store(&ctx).expect("in memory").into_artifact())
            })
            .collect();
        *of = changed;
    };
    let mut bench = Bench::new();
    flip(&mut bench.hold, &bench.blobs, 0.5);
    let partial = bench.run(1).expect("an evaluation");
    assert!(!partial.hold.contains_key("flip"));
    assert!(
        partial.notes[0].contains("`flip`") && partial.notes[0].contains("parameterization="),
        "{:?}",
        partial.notes
    );
    flip(&mut bench.scores, &bench.blobs, 0.125);
    let whole = bench.run(1).expect("an evaluation");
    assert!(whole.notes.is_empty(), "{:?}", whole.notes);
    assert_eq!(whole.hold.len(), BASIC.len() + 1);
    let method = &whole.methods[0];
    assert_eq!((method.at[0].metrics["flip"].mean, method.at[0].gain["flip"].mean), (0.125, -0.375));
    near(method.auc["flip"].mean, 0.125);
    near(method.tv["flip"].mean, 0.0);
    // No other figure changes.
    assert_eq!(method.at[0].metrics["hdr_psnr"], partial.methods[0].at[0].metrics["hdr_psnr"]);
    assert_eq!(whole.claims, partial.claims);
}
