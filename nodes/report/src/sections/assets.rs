//! Which HDRIs and objects of the scenes came from files.

use crate::{
    material::{Assets, Uses},
    page::Section,
    text::{count, escape, plural},
};
use std::fmt::Write as _;
use tauflow_data::records::AssetReport;

/// The section.
pub fn section(assets: &Assets) -> Section {
    Section::new("assets", "Assets from files", opening(assets) + &table(assets))
}

/// One row per file.
pub fn csv(assets: &Assets) -> String {
    let mut out = String::from("file,sort,accepted,train_scenes,test_scenes,reason\n");
    for of in &assets.reports {
        let scenes = |uses: &Option<Uses>| uses.as_ref().map_or(String::new(), |uses| uses.of(&of.name).to_string());
        let _ = writeln!(
            out,
            "{},{},{},{},{},{}",
            crate::csv::field(&of.name),
            of.sort.as_deref().unwrap_or_default(),
            of.accepted,
            scenes(&assets.train),
            scenes(&assets.test),
            crate::csv::field(of.reason.as_deref().unwrap_or_default())
        );
    }
    out
}

fn of_sort<'a>(assets: &'a Assets, sort: &'a str) -> impl Iterator<Item = &'a AssetReport> {
    assets.reports.iter().filter(move |of| of.accepted && of.sort.as_deref() == Some(sort))
}

fn opening(assets: &Assets) -> String {
    let refused = assets.reports.iter().filter(|of| !of.accepted).count() as u64;
    if assets.reports.is_empty() {
        return "<p>All objects and environments of the scenes are procedural: no file was used.</p>".to_owned();
    }
    let (maps, objects) = (of_sort(assets, "environment").count(), of_sort(assets, "object").count());
    let mut out = format!(
        "<p>{} and {} were imported from files; all others are procedural.{}",
        plural(maps as u64, "environment map"),
        plural(objects as u64, "object"),
        if refused == 0 { String::new() } else { format!(" {} could not be imported.", plural(refused, "file")) }
    );
    for (side, uses) in [("training", &assets.train), ("test", &assets.test)] {
        let Some(uses) = uses else { continue };
        let _ = write!(
            out,
            " Of {}, {} an object from a file, and {} an environment map.",
            plural(uses.scenes, &format!("{side} scene")),
            has(uses.with_object),
            has(uses.with_environment)
        );
    }
    if let (Some(train), Some(test)) = (&assets.train, &assets.test) {
        let both = assets.reports.iter().filter(|of| train.of(&of.name) > 0 && test.of(&of.name) > 0).count() as u64;
        let unseen = assets.reports.iter().filter(|of| train.of(&of.name) == 0 && test.of(&of.name) > 0).count() as u64;
        if unseen > 0 || both > 0 {
            let _ = write!(out, " {} in test scenes only, and {} on both sides.", are(unseen), are(both));
        }
    }
    out + "</p>"
}

fn has(scenes: u64) -> String {
    if scenes == 1 { "1 has".to_owned() } else { format!("{} have", count(scenes)) }
}

fn are(files: u64) -> String {
    if files == 1 { "1 file is".to_owned() } else { format!("{} files are", count(files)) }
}

fn table(assets: &Assets) -> String {
    if assets.reports.is_empty() {
        return String::new();
    }
    let sides = [("Training scenes", &assets.train), ("Test scenes", &assets.test)];
    let sides: Vec<(&str, &Uses)> = sides.into_iter().filter_map(|(name, of)| Some((name, of.as_ref()?))).collect();
    let mut out =
        "<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>File</th><th class=\"left\">Sort</th>".to_owned();
    out.extend(sides.iter().map(|(name, _)| format!("<th>{name}</th>")));
    out.push_str("<th class=\"left\">Import</th></tr></thead><tbody>");
    for of in &assets.reports {
        let sort = match of.sort.as_deref() {
            Some("environment") => "environment map",
            Some(sort) => sort,
            None => "–",
        };
        let _ = write!(out, "<tr><td>{}</td><td class=\"left\">{}</td>", escape(&of.name), escape(sort));
        for (_, uses) in &sides {
            let n = uses.of(&of.name);
            let shown = if n == 0 { r#"<span class="zero">0</span>"#.to_owned() } else { count(n) };
            let _ = write!(out, "<td>{shown}</td>");
        }
        let import = match &of.reason {
            Some(reason) => format!("refused: {}", escape(reason)),
            None if of.repairs.is_empty() => "accepted".to_owned(),
            None => format!("accepted, {}", plural(of.repairs.len() as u64, "sort of repair")),
        };
        let _ = write!(out, "<td class=\"left\">{import}</td></tr>");
    }
    out + "</tbody></table></div>"
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn file(name: &str, sort: &str, reason: Option<&str>) -> AssetReport {
        AssetReport {
            name: name.into(),
            sort: Some(sort.into()),
            accepted: reason.is_none(),
            reason: reason.map(str::to_owned),
            ..AssetReport::default()
        }
    }

    fn uses(of: &[(&str, u64)]) -> Option<Uses> {
        let by_name: BTreeMap<String, u64> = of.iter().map(|(name, n)| ((*name).to_owned(), *n)).collect();
        Some(Uses { scenes: 12, with_object: 1, with_environment: 4, by_name })
    }

    #[test]
    fn the_page_tells_what_was_real_and_on_which_side() {
        let reports = vec![
            file("cat.glb", "object", None),
            file("dawn.hdr", "environment", None),
            file("torn.glb", "object", Some("torn.glb: ends early")),
        ];
        let mut assets = Assets { reports, train: uses(&[("cat.glb", 1)]), test: uses(&[("dawn.hdr", 4)]) };
        let body = section(&assets).body;
        assert!(
            body.contains("1 environment map and 1 object were imported from files; all others are procedural. 1 file"),
            "{body}"
        );
        assert!(body.contains("Of 12 training scenes, 1 has an object from a file, and 4 have an environment map."));
        assert!(body.contains("1 file is in test scenes only, and 0 files are on both sides."), "{body}");
        assert!(body.contains("refused: torn.glb: ends early"));
        let rows = csv(&assets);
        assert_eq!(rows.lines().nth(1), Some("cat.glb,object,true,1,0,"));
        assert_eq!(rows.lines().nth(3), Some("torn.glb,object,false,0,0,torn.glb: ends early"));
        assets.train = uses(&[("cat.glb", 1), ("dawn.hdr", 2)]);
        assert!(section(&assets).body.contains("0 files are in test scenes only, and 1 file is on both sides."));
        (assets.train, assets.test) = (None, None);
        assert!(!section(&assets).body.contains("Training scenes"));
    }

    #[test]
    fn without_files_everything_is_procedural() {
        let none = Assets { reports: Vec::new(), train: uses(&[]), test: None };
        assert!(section(&none).body.contains("no file was used"));
        assert_eq!(csv(&none).lines().count(), 1);
    }
}
