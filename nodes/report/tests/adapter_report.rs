//! The kind `adapter_report` over made-up samples and scores.

mod made_up;

use made_up::{files, quality};
use tauflow_report::AdapterReportParams;

fn text(files: &tauflow_contract::FileTree, name: &str) -> String {
    String::from_utf8(files[name].clone()).expect("text")
}

#[test]
fn the_page_shows_all_there_is() {
    let files = files(AdapterReportParams::default(), &quality(), 2).expect("sound inputs");
    let names: Vec<&str> = files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "adapter_report.html",
            "claims.csv",
            "energy.csv",
            "gains.csv",
            "montage-ddpm_own.png",
            "montage-rf_own.png",
            "per_sample.csv",
            "quality.json",
            "scores.csv",
            "viewer.html"
        ]
    );
    let page = text(&files, "adapter_report.html");
    for part in [
        // Each section, and the paper's figures beside ours.
        "id=\"scores\"",
        "id=\"verdicts\"",
        "id=\"pictures\"",
        "id=\"energy\"",
        "id=\"trajectories\"",
        "<td>0.324 (+21.8%)</td>",
        "<td>57.184 (+9.5%)</td>",
        // The change of ours: 2 x 0.04 of 2 x 0.1 is 60% less.
        "0.0800 (−60.0%)",
        "physical gain <b>held</b>",
        "physical gain <b>undecided</b>",
        "control: shuffled residuals",
        "<th>difference</th>",
        "<th>step 32</th>",
        "CLIPIQA is left out",
        "<code>quality.json</code>",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script") && !page.contains(">NaN") && !page.contains("not connected"));
    // Frozen and controls of two samples: 7 pictures each; frames: 9 of each of two variants, 8 of them shown.
    assert_eq!(page.matches("<img ").count(), 2 * (2 * 7 + 2 * 8));
    // Three lines for each backbone, in the drawing for wide windows and in that for phones: what injects nothing has
    // none.
    assert_eq!(page.matches("class=\"line ").count(), 2 * 6);
    // Every picture leads to its frame in the viewer, and the difference to the adapted image.
    assert_eq!(page.matches("<a href=\"viewer.html#scene=").count(), page.matches("<img ").count());
    assert!(page.contains("<a href=\"viewer.html#scene=rf%5Fown%2D0001&amp;a=images%2Fadapted&amp;mode=wipe\">"));
    assert!(
        page.contains("<a href=\"viewer.html#scene=rf%5Fown%2D0000&amp;a=trajectory%3A%20adapted%2Fstep%2032&amp;")
    );
    let viewer = text(&files, "viewer.html");
    assert!(viewer.contains("\"content\":\"display\"") && viewer.contains("\"id\":\"trajectory: frozen/step 0\""));
    let claims = text(&files, "claims.csv");
    assert!(claims.lines().count() == 11 && claims.contains("rf_own") && claims.contains("over Gaussian residuals"));
    assert_eq!(text(&files, "energy.csv").lines().count(), 1 + 6 * (100 + 32));
    assert_eq!(text(&files, "scores.csv").lines().count(), 1 + 2 * 6 * 4);
    assert_eq!(text(&files, "gains.csv").lines().count(), 1 + 2 * 5 * 4);
}

#[test]
fn what_is_not_there_is_left_out() {
    let mut bare = quality();
    bare.backbones.truncate(1);
    bare.per_sample.clear();
    let own = &mut bare.backbones[0];
    own.variants.truncate(1);
    own.gains.clear();
    (own.claim, own.gaussian) = (None, None);
    let files = files(AdapterReportParams::default(), &bare, 0).expect("sound inputs");
    let page = text(&files, "adapter_report.html");
    for section in ["verdicts", "pictures", "energy", "trajectories"] {
        assert!(!page.contains(&format!("id=\"{section}\"")), "{section}");
    }
    assert!(
        page.contains("id=\"scores\"") && page.contains("Omitted, because these inputs are not connected: generated.")
    );
    assert!(!files.contains_key("claims.csv") && !files.contains_key("per_sample.csv"));
    assert!(!files.contains_key("viewer.html"));
    // Fewer samples in the viewer than on the page: the others are no links.
    let params = AdapterReportParams { viewer_samples: 1, ..AdapterReportParams::default() };
    let page = text(&self::files(params, &quality(), 2).expect("sound inputs"), "adapter_report.html");
    assert!(page.contains("a=images%2Fadapted") && !page.contains("own%2D0001"));
}
