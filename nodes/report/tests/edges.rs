//! The report over unusual material: scores without bounds, a single scene, held-out references, other solvers.

mod common;

use common::{extras, run};
use std::{collections::BTreeMap, sync::atomic::AtomicBool};
use tauflow_contract::{Collection, Context, FileTree, Handle, MemoryBlobs, Silent};
use tauflow_data::{
    methods::HOLD,
    records::{Evaluation, PSNR_CEILING},
};
use tauflow_report::ReportParams;

/// Every input of a report.
struct Bench {
    blobs: MemoryBlobs,
    inputs: BTreeMap<&'static str, Collection>,
    stop: AtomicBool,
}

impl Bench {
    fn new() -> Self {
        let blobs = MemoryBlobs::default();
        let inputs = extras::all(&blobs, 12);
        Self { blobs, inputs, stop: AtomicBool::new(false) }
    }

    /// Changes the evaluation.
    fn evaluation(&mut self, change: impl FnOnce(&mut Evaluation)) -> Evaluation {
        let ctx = Context::new(&self.blobs, &Silent, &self.stop);
        let (_, artifact) = self.inputs["evaluation"].iter().next().expect("one item");
        let mut evaluation = Handle::<Evaluation>::new(artifact).and_then(|it| it.load(&ctx)).expect("an evaluation");
        change(&mut evaluation);
        let item = common::item(&ctx, "evaluation", &evaluation);
        self.inputs.insert("evaluation", [item].into_iter().collect());
        evaluation
    }

    fn files(&self) -> FileTree {
        run(&self.blobs, ReportParams::default(), &self.inputs).expect("a report")
    }
}

fn text(files: &FileTree, name: &str) -> String {
    String::from_utf8(files[name].clone()).expect("text files are UTF-8")
}

/// A section of the page.
fn section<'a>(html: &'a str, id: &str) -> &'a str {
    let start = html.find(&format!("<section id=\"{id}\"")).unwrap_or_else(|| panic!("no section {id}"));
    &html[start..start + html[start..].find("</section>").expect("it ends")]
}

#[test]
fn an_input_that_equals_its_reference_leaves_the_mean_of_its_stratum_finite() {
    let mut bench = Bench::new();
    let mut stratum = String::new();
    let evaluation = bench.evaluation(|of| {
        let row = of.per_scene.iter_mut().find(|row| row.score.method == HOLD).expect("a score of the input");
        row.score.metrics.hdr_psnr = f64::INFINITY;
        stratum = row.stratum.clone();
    });
    let own = |row: &&tauflow_data::records::SceneRow| row.score.method == HOLD && row.stratum == stratum;
    let psnr: Vec<f64> = evaluation.per_scene.iter().filter(own).map(|row| row.score.metrics.hdr_psnr).collect();
    let mean = psnr.iter().map(|value| value.min(PSNR_CEILING)).sum::<f64>() / psnr.len() as f64;
    let html = text(&bench.files(), "report.html");
    let strata = section(&html, "strata");
    assert!(!strata.contains('∞'), "a gain or a mean is infinite");
    assert!(strata.contains(&format!("<td>{mean:.2}</td>")), "{mean}");
    let gain = evaluation.methods[0].at[0].strata[&stratum]["hdr_psnr"] - mean;
    assert!(strata.contains(&format!(">{gain:.2}</td>").replace('-', "−")), "{gain}");
    // The picture of the scene says what it is.
    assert!(section(&html, "pictures").contains("∞"));
}
