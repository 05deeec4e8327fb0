//! Statistics of the scenes per stratum.

use crate::{
    page::Section,
    text::{compact, count, fixed, plural},
};
use std::{collections::BTreeMap, fmt::Write as _};
use tauflow_data::{Stratum, StratumName, records::SceneStatistics, statistics::quantile};

/// The section; none without statistics.
pub fn section(statistics: &[(String, SceneStatistics)]) -> Option<Section> {
    let first = statistics.first()?;
    let mut strata: BTreeMap<String, Vec<&SceneStatistics>> = BTreeMap::new();
    for (key, of) in statistics {
        let stratum = StratumName::group_of(key);
        strata.entry(stratum).or_default().push(of);
    }
    let [spp, reference] = first.1.spp;
    let mut out = format!(
        "<p>Do scenes have the light transport that their stratum names? Medians over the scenes of each stratum, \
         with quartiles below. The columns of light are shares of the image: light of the sky; light that meets only \
         diffuse surfaces; light through glass; caustics, which reach a scattering surface over a specular one. RMSE \
         is for one sample per pixel, relative to the image's mean. Slopes are of log RMSE over log n, up to {} \
         samples per pixel, against a held-out reference of {}, with one ladder per scene.</p><div \
         class=\"scroll\"><table class=\"wide\"><thead><tr><th>Stratum</th><th>Scenes</th><th>Path \
         length</th><th>From the sky</th><th>Diffuse only</th><th>Through glass</th><th>Caustic</th><th>RMSE at \
         1</th><th>Slope</th><th>Variance in the top 1%</th></tr></thead><tbody>",
        count(spp),
        count(reference)
    );
    // Context by context, so that regimes stand below each other.
    let mut names = StratumName::in_order(strata.keys());
    names.sort_by_cached_key(|name| match name.parse::<Stratum>() {
        Ok(stratum) => (false, Some((stratum.context, stratum.regime))),
        Err(_) => (true, None),
    });
    let mut context = None;
    for name in names {
        let scenes = &strata[&name];
        let own = name.parse::<Stratum>().ok().map(|s| s.context);
        let class = if context != own { " class=\"group\"" } else { "" };
        context = own;
        let _ = write!(out, "<tr{class}><td>{}</td><td>{}</td>", StratumName::label(&name), count(scenes.len() as u64));
        type Value = (fn(&SceneStatistics) -> Option<f64>, fn(f64) -> String);
        let columns: [Value; 8] = [
            (|s| Some(s.mean_path_length), |v| fixed(v, 2)),
            (|s| Some(s.environment_share), percent),
            (|s| Some(s.diffuse_share), percent),
            (|s| Some(s.refractive_share), percent),
            (|s| Some(s.caustic_share), percent),
            (|s| Some(s.relative_rmse), compact),
            (|s| s.slope, |v| fixed(v, 2)),
            (|s| Some(s.tail_share), percent),
        ];
        for (value, show) in columns {
            let mut values: Vec<f64> = scenes.iter().filter_map(|s| value(s)).collect();
            if values.is_empty() {
                out.push_str("<td>–</td>");
                continue;
            }
            values.sort_by(f64::total_cmp);
            let [low, middle, high] = [0.25, 0.5, 0.75].map(|share| show(quantile(&values, share)));
            let quartiles = format!("<span class=\"ci\">{low} – {high}</span>");
            let _ = write!(out, "<td>{middle}{}</td>", if values.len() > 1 { &quartiles } else { "" });
        }
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table></div>");
    let still = statistics.iter().filter(|(_, of)| of.slope.is_none()).count() as u64;
    if still > 0 {
        let _ = write!(out, "<p class=\"note\">Slopes exclude {} without noise.</p>", plural(still, "scene"));
    }
    let dropped: Vec<u64> = statistics.iter().map(|(_, of)| of.dropped).filter(|dropped| *dropped > 0).collect();
    if !dropped.is_empty() {
        let (triangles, scenes) = (plural(dropped.iter().sum(), "triangle"), plural(dropped.len() as u64, "scene"));
        let _ = write!(
            out,
            "<p class=\"note\">{triangles} in {scenes} are omitted, because they have no area or a vertex that is not \
             finite.</p>"
        );
    }
    Some(Section::new("scenes", "Scene statistics", out))
}

fn percent(share: f64) -> String {
    let digits = if share > 0.0 && share < 0.0995 { 1 } else { 0 };
    format!("{}%", fixed(share * 100.0, digits))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_shares_keep_a_digit() {
        assert_eq!([percent(0.0), percent(0.004), percent(0.5)], ["0%", "0.4%", "50%"]);
    }
}
