//! Error against time as CSV: points, scenes, times to an error.

use crate::csv::field;
use std::fmt::Write as _;
use tauflow_data::{
    records::{Estimate, TimeError, TimeTo, TimedMethod, TimedSummary},
    tabular::csv_estimate,
};

/// A method's columns.
fn method(of: &TimedMethod) -> String {
    let cell: Vec<String> = of.cell.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
    format!("{},{},{}", field(&of.method), field(&of.conditioning), field(&cell.join("+")))
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

/// Every point, over all scenes and by stratum.
pub fn points(of: &TimeError) -> String {
    let mut out = String::from(
        "method,conditioning,cell,stratum,scenes,from_spp,nfe,wall_s_q1,wall_s,wall_s_q3,\
         cpu_s,mse,rel_mse,hdr_psnr,preview_psnr,ssim,speed_up,speed_up_low,speed_up_high,\
         crossover_spp,crossover_spp_low,crossover_spp_high,extrapolated\n",
    );
    for timed in &of.methods {
        let method = method(timed);
        for point in &timed.points {
            let all = std::iter::once(("all", &point.all));
            for (stratum, at) in all.chain(point.strata.iter().map(|(name, at)| (name.as_str(), at))) {
                let three = |of: Option<Estimate>| csv_estimate(of.as_ref(), at.has_intervals());
                let TimedSummary { scenes, wall_s, cpu_s, mse, rel_mse, hdr_psnr, preview_psnr, ssim, .. } = at;
                let _ = writeln!(
                    out,
                    "{method},{stratum},{scenes},{},{},{},{},{},{},{mse},{rel_mse},\
                     {hdr_psnr},{preview_psnr},{ssim},{},{},{}",
                    point.from_spp,
                    point.nfe,
                    wall_s[0],
                    wall_s[1],
                    wall_s[2],
                    cpu_s[1],
                    three(at.speed_up),
                    three(at.crossover_spp),
                    at.extrapolated
                );
            }
        }
    }
    out
}

/// Every point of every scene.
pub fn scenes(of: &TimeError) -> String {
    let mut out = String::from(
        "method,conditioning,cell,scene,from_spp,nfe,wall_s_q1,wall_s,wall_s_q3,cpu_s_q1,cpu_s,cpu_s_q3,\
         mse,rel_mse,hdr_psnr,preview_psnr,ssim,speed_up,crossover_spp,unresolved\n",
    );
    for timed in &of.methods {
        let method = method(timed);
        for point in &timed.points {
            for s in &point.scenes {
                let [wall, cpu] = [s.wall_s, s.cpu_s].map(|of| of.map(|v| v.to_string()).join(","));
                let _ = writeln!(
                    out,
                    "{method},{},{},{},{wall},{cpu},{},{},{},{},{},{},{},{}",
                    field(&s.scene),
                    point.from_spp,
                    point.nfe,
                    s.mse,
                    s.rel_mse,
                    s.hdr_psnr,
                    s.preview_psnr,
                    s.ssim,
                    optional(s.speed_up),
                    optional(s.crossover_spp),
                    s.unresolved
                );
            }
        }
    }
    out
}

/// Times to errors, over all scenes and by stratum.
pub fn targets(of: &TimeError) -> String {
    let mut out = String::from("method,conditioning,cell,stratum,metric,target,reached,wall_s\n");
    for timed in &of.methods {
        let method = method(timed);
        let mut put = |stratum: &str, targets: &[TimeTo]| {
            for t in targets {
                let _ =
                    writeln!(out, "{method},{stratum},{},{},{},{}", t.metric, t.target, t.reached, optional(t.wall_s));
            }
        };
        put("all", &timed.targets);
        timed.strata_targets.iter().for_each(|(stratum, targets)| put(stratum, targets));
    }
    out
}
