//! From errors and times of each scene to tables: summaries, times to an error, the path tracer at equal time.

use crate::{
    bootstrap::{Resampled, Table},
    evaluation::stratum,
    groups::Groups,
    time_course::{Course, decibels},
    time_params::TimeErrorParams,
    time_samples::{Measured, Sample, quartiles},
};
use serde_json::Value;
use std::collections::BTreeMap;
use tauflow_contract::KindError;
use tauflow_data::{
    maths::{exp, log, pow},
    methods::{Conditioning, PATH_TRACER},
    records::{
        Estimate, PSNR_CEILING, TimeError, TimeTo, TimedMethod, TimedPoint, TimedScene, TimedSummary, VersusRendering,
    },
};

/// Columns of a point in the table that is resampled: logarithms of the speed-up and of the crossover, and three gains.
const COLUMNS: usize = 5;

/// Sums scenes up; the caller knows the machine that measured.
///
/// # Errors
/// If there are none, they differ in what was measured, or one is of no group.
pub(crate) fn summarise(
    scenes: &[Measured],
    groups: &Groups,
    params: &TimeErrorParams,
    reference_spp: u64,
    notes: Vec<String>,
    seed: u64,
) -> Result<TimeError, KindError> {
    let first = scenes.first().ok_or_else(|| KindError::Input("there are no scenes to measure".into()))?;
    let layout = first.layout();
    if let Some(other) = scenes.iter().find(|scene| scene.layout() != layout) {
        return Err(KindError::Input(format!(
            "`{}` was measured with different methods, samples or NFE than `{}`; measure all scenes in the same way",
            other.scene, first.scene
        )));
    }
    let mut by_stratum: BTreeMap<String, Vec<&Measured>> = BTreeMap::new();
    for scene in scenes {
        by_stratum.entry(stratum(&scene.scene)).or_default().push(scene);
    }
    let all = Together::new(scenes.iter().collect(), groups, params.resamples, seed)?;
    let strata = by_stratum
        .into_iter()
        .map(|(name, of)| Ok((name, Together::new(of, groups, params.resamples, seed)?)))
        .collect::<Result<BTreeMap<_, _>, KindError>>()?;
    let mut methods = Vec::with_capacity(layout.len());
    // Columns go on from method to method; the path tracer has none.
    let mut at = 0;
    for (method, (name, points)) in layout.iter().enumerate() {
        let mut found = Vec::with_capacity(points.len());
        for (point, (from_spp, nfe)) in points.iter().enumerate() {
            let column = name.is_some().then_some(at);
            found.push(TimedPoint {
                from_spp: *from_spp,
                nfe: *nfe,
                scenes: all.scenes(method, point),
                all: all.summary(method, point, column),
                strata: strata.iter().map(|(name, of)| (name.clone(), of.summary(method, point, column))).collect(),
                versus: column.map(|column| all.versus(method, point, column)),
            });
            at += if name.is_some() { COLUMNS } else { 0 };
        }
        methods.push(TimedMethod {
            method: name.map_or(PATH_TRACER, |of| &of.method).to_owned(),
            conditioning: name.map_or(Conditioning::Rgb.name(), |of| &of.conditioning).to_owned(),
            cell: name.map(|of| of.cell.clone()).unwrap_or_default(),
            points: found,
            targets: targets(&all.scenes, method, params),
            strata_targets: strata
                .iter()
                .map(|(name, of)| (name.clone(), targets(&of.scenes, method, params)))
                .collect(),
        });
    }
    Ok(TimeError {
        machine: Value::Null,
        reference_spp,
        scenes: scenes.len() as u64,
        groups: groups.count(scenes.iter().map(|of| of.scene.as_str()))?,
        resamples: params.resamples,
        methods,
        notes,
    })
}

/// Scenes that are summed up together.
struct Together<'a> {
    scenes: Vec<&'a Measured>,
    /// How many groups they are of; none where each stands for itself.
    groups: Option<u64>,
    resampled: Resampled,
}

impl<'a> Together<'a> {
    fn new(scenes: Vec<&'a Measured>, groups: &Groups, resamples: u64, seed: u64) -> Result<Self, KindError> {
        let points = scenes.first().map_or(0, |of| of.methods.values().map(Vec::len).sum::<usize>());
        let mut table = Table::new(points * COLUMNS);
        for scene in scenes.iter().filter(|_| points > 0) {
            let course = Course(&scene.own);
            let columns = |s: &Sample| {
                let (spp, speed_up) = course.against(s);
                let same_time = course.spp_after(s.wall_s[1]);
                let psnr = |s: &Sample| s.hdr_psnr.min(PSNR_CEILING);
                let preview = |s: &Sample| s.preview_psnr.min(PSNR_CEILING);
                [
                    log(speed_up),
                    log(spp),
                    psnr(s) - course.at(same_time, psnr, decibels()),
                    preview(s) - course.at(same_time, preview, decibels()),
                    s.ssim - course.at(same_time, |s| s.ssim, 0.0),
                ]
            };
            let row: Vec<f64> = scene.methods.values().flatten().flat_map(columns).collect();
            table.push(groups.of(&scene.scene)?, &row);
        }
        // If only the path tracer was measured, there is nothing to resample.
        let resampled =
            if points > 0 { Resampled::new(&table, resamples as usize, seed) } else { Resampled::new(&one(), 1, 0) };
        let resampled = resampled.ok_or_else(|| KindError::Internal("a group without scenes".into()))?;
        let groups = groups.count(scenes.iter().map(|of| of.scene.as_str()))?;
        Ok(Self { scenes, groups, resampled })
    }

    fn samples(&self, method: usize, point: usize) -> Vec<&'a Sample> {
        self.scenes.iter().filter_map(|scene| scene.samples().nth(method)?.get(point)).collect()
    }

    /// Each scene at a point.
    fn scenes(&self, method: usize, point: usize) -> Vec<TimedScene> {
        let scene = |(of, s): (&&Measured, &Sample)| {
            let against = (method > 0).then(|| Course(&of.own).against(s));
            TimedScene {
                scene: of.scene.clone(),
                wall_s: s.wall_s,
                cpu_s: s.cpu_s,
                mse: s.mse,
                rel_mse: s.rel_mse,
                hdr_psnr: s.hdr_psnr.min(PSNR_CEILING),
                preview_psnr: s.preview_psnr.min(PSNR_CEILING),
                ssim: s.ssim,
                unresolved: s.unresolved,
                crossover_spp: against.map(|(spp, _)| spp),
                speed_up: against.map(|(_, speed_up)| speed_up),
            }
        };
        self.scenes.iter().zip(self.samples(method, point)).map(scene).collect()
    }

    fn summary(&self, method: usize, point: usize, column: Option<usize>) -> TimedSummary {
        let samples = self.samples(method, point);
        let power = |at: usize| {
            let Estimate { mean, low, high } = self.resampled.estimate(|m| m[at]);
            Estimate { mean: exp(mean), low: exp(low), high: exp(high) }
        };
        let beyond = |(scene, s): &(&&Measured, &&Sample)| {
            let course = Course(&scene.own);
            course.against(s).0 > course.spp(course.last())
        };
        let extrapolated = self.scenes.iter().zip(&samples).filter(|_| column.is_some()).filter(beyond).count();
        let mean = |of: &dyn Fn(&Sample) -> f64| samples.iter().map(|s| of(s)).sum::<f64>() / samples.len() as f64;
        TimedSummary {
            scenes: samples.len() as u64,
            groups: self.groups,
            wall_s: quartiles(samples.iter().map(|s| s.wall_s[1])),
            cpu_s: quartiles(samples.iter().map(|s| s.cpu_s[1])),
            mse: exp(mean(&|s| log(s.mse))),
            rel_mse: exp(mean(&|s| log(s.rel_mse))),
            hdr_psnr: mean(&|s| s.hdr_psnr.min(PSNR_CEILING)),
            preview_psnr: mean(&|s| s.preview_psnr.min(PSNR_CEILING)),
            ssim: mean(&|s| s.ssim),
            crossover_spp: column.map(|at| power(at + 1)),
            extrapolated: extrapolated as f64 / samples.len() as f64,
            speed_up: column.map(power),
        }
    }

    fn versus(&self, method: usize, point: usize, column: usize) -> VersusRendering {
        let samples = self.samples(method, point);
        let spp = |(scene, s): (&&Measured, &&Sample)| Course(&scene.own).spp_after(s.wall_s[1]);
        let better = |(scene, s): &(&&Measured, &&Sample)| {
            let course = Course(&scene.own);
            s.hdr_psnr > course.at(course.spp_after(s.wall_s[1]), |s| s.hdr_psnr, decibels())
        };
        VersusRendering {
            spp: quartiles(self.scenes.iter().zip(&samples).map(spp))[1],
            hdr_psnr: self.resampled.estimate(|m| m[column + 2]),
            preview_psnr: self.resampled.estimate(|m| m[column + 3]),
            ssim: self.resampled.estimate(|m| m[column + 4]),
            better: self.scenes.iter().zip(&samples).filter(better).count() as f64 / samples.len() as f64,
        }
    }
}

/// A table of nothing.
fn one() -> Table {
    let mut table = Table::new(1);
    table.push(None, &[0.0]);
    table
}

/// How long a method takes to each target.
fn targets(scenes: &[&Measured], method: usize, params: &TimeErrorParams) -> Vec<TimeTo> {
    let time_to = |metric: &str, target: f64, most: f64, error: &dyn Fn(&Sample) -> f64| {
        let least = |scene: &&Measured| {
            // Rendering alone can stop at any sample, between the rungs too.
            if method == 0 {
                return Course(&scene.own).wall_to(error, most);
            }
            let of = scene.samples().nth(method).into_iter().flatten();
            of.filter(|s| error(s) <= most).map(|s| s.wall_s[1]).fold(f64::INFINITY, f64::min)
        };
        let mut times: Vec<f64> = scenes.iter().map(least).collect();
        times.sort_by(f64::total_cmp);
        let reached = times.iter().filter(|t| t.is_finite()).count() as f64 / times.len() as f64;
        // Of an even number the later of the two in the middle: with infinities among them there is no mean.
        let middle = times[times.len() / 2];
        TimeTo { metric: metric.to_owned(), target, reached, wall_s: middle.is_finite().then_some(middle) }
    };
    let psnr = params.psnr_targets.iter().map(|t| time_to("hdr_psnr", *t, pow(10.0, -t / 10.0), &|s| s.mse));
    let relative = params.rel_mse_targets.iter().map(|t| time_to("rel_mse", *t, *t, &|s| s.rel_mse));
    psnr.chain(relative).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time_samples::tests::{near, sample, scene};
    use tauflow_data::{
        maths::log10,
        records::{SceneGroup, SplitReport},
        scene::Side,
    };

    #[test]
    fn summaries_say_what_was_put_in() {
        let scenes: Vec<Measured> = (0..12).map(scene).collect();
        let params = TimeErrorParams { resamples: 200, psnr_targets: vec![15.0, 60.0], ..TimeErrorParams::default() };
        let result = summarise(&scenes, &Groups::none(), &params, 4096, vec!["a note".into()], 1).expect("alike");
        assert_eq!((result.scenes, result.methods.len(), result.methods[0].points.len()), (12, 2, 8));
        let point = &result.methods[1].points[0];
        let crossover = point.all.crossover_spp.expect("a solver");
        near(crossover.mean, 100.0);
        near(crossover.low, 100.0);
        assert_eq!((point.all.extrapolated, result.methods[0].points[7].all.extrapolated), (0.0, 0.0));
        // 100 samples take 1.1 s.
        let speed_up = point.all.speed_up.expect("a solver");
        near(speed_up.mean, 1.1 / 0.31);
        near(speed_up.high, 1.1 / 0.31);
        let versus = point.versus.as_ref().expect("a solver");
        near(versus.spp, 21.0);
        near(versus.better, 1.0);
        // Between the rungs of 16 and 32, too, the error falls along a straight line of logarithms.
        near(versus.hdr_psnr.mean, 10.0 * log10(100.0 / 21.0));
        near(versus.preview_psnr.low, 10.0 * log10(100.0 / 21.0));
        assert_eq!(point.strata.keys().collect::<Vec<_>>(), ["L0-open", "L1-open"]);
        near(point.all.wall_s[1], 0.31);
        assert_eq!((point.scenes.len(), point.scenes[5].scene.as_str()), (12, "L1-open-000005"));
        near(point.scenes[5].speed_up.expect("a solver"), 1.1 / 0.31);
        near(point.scenes[5].crossover_spp.expect("a solver"), 100.0);
        assert_eq!(result.methods[0].points[0].scenes[0].speed_up, None);
        near(point.all.cpu_s[2], 0.62);
        // Nobody gets to 60 dB; the solver gets to 15 dB in its one time.
        let targets = &result.methods[1].targets;
        let reached = [targets[0].reached, targets[1].reached];
        assert_eq!((reached, targets[0].wall_s, targets[1].wall_s), ([1.0, 0.0], Some(0.31), None));
        let open = &result.methods[1].strata_targets["L1-open"];
        assert_eq!((open[0].reached, open[0].wall_s, open[1].wall_s), (1.0, Some(0.31), None));
        assert_eq!(result.notes, ["a note"]);
    }

    #[test]
    fn a_crossover_beyond_what_was_timed_is_counted() {
        // Of the two scenes one solver is worth 100 samples, the other 200, where 128 is the last rung.
        let mut scenes: Vec<Measured> = (0..2).map(scene).collect();
        let own = scenes[1].own[0].mse;
        scenes[1].methods.values_mut().flatten().for_each(|s| *s = sample(1, 1, 0.31, own / 200.0));
        let result = summarise(&scenes, &Groups::none(), &TimeErrorParams::default(), 1, Vec::new(), 1).expect("alike");
        let point = &result.methods[1].points[0];
        assert_eq!((point.all.extrapolated, point.strata["L1-open"].extrapolated), (0.5, 1.0));
        let crossover = point.all.crossover_spp.expect("a solver");
        near(crossover.mean, (100.0 * 200.0f64).sqrt());
        near(crossover.low, 100.0);
        near(crossover.high, 200.0);
    }

    #[test]
    fn strata_say_of_how_many_groups_they_are() {
        let scenes: Vec<Measured> = (0..4).map(scene).collect();
        let keys: Vec<String> = scenes.iter().map(|of| of.scene.clone()).collect();
        let group = |of: &[usize]| SceneGroup {
            signature: keys[of[0]].clone(),
            side: Side::Test,
            items: of.iter().map(|at| keys[*at].clone()).collect(),
        };
        // Even scenes are in one stratum, odd ones in the other.
        let groups = vec![group(&[0, 2]), group(&[1]), group(&[3])];
        let groups = Groups::of_split(&SplitReport { groups, ..SplitReport::default() });
        let result = summarise(&scenes, &groups, &TimeErrorParams::default(), 1, Vec::new(), 1).expect("alike");
        let point = &result.methods[1].points[0];
        let of = |summary: &TimedSummary| (summary.groups, summary.has_intervals());
        let [even, odd] = [0, 1].map(|at| of(&point.strata[keys[at].rsplit_once('-').expect("a stratum").0]));
        assert_eq!((of(&point.all), even, odd), ((Some(3), true), (Some(1), false), (Some(2), true)));
    }

    #[test]
    fn scenes_that_differ_are_refused_and_rendering_alone_is_no_mistake() {
        let mut scenes: Vec<Measured> = (0..2).map(scene).collect();
        scenes[1].own.pop();
        let error = summarise(&scenes, &Groups::none(), &TimeErrorParams::default(), 1, Vec::new(), 1)
            .expect_err("other rungs")
            .to_string();
        assert!(error.contains("L1-open-000001") && error.contains("L0-open-000000"), "{error}");
        assert!(summarise(&[], &Groups::none(), &TimeErrorParams::default(), 1, Vec::new(), 1).is_err());
        let mut alone = vec![scene(1)];
        alone[0].methods.clear();
        let result =
            summarise(&alone, &Groups::none(), &TimeErrorParams::default(), 1, Vec::new(), 1).expect("one method");
        assert_eq!((result.methods.len(), result.methods[0].points.len()), (1, 8));
    }
}
