//! Looking at a pipeline: `plan`, `explain`, `check` and `graph` start none of its programs.

use crate::{
    Said,
    programs::{with, with_renderer},
};

#[test]
fn looking_starts_no_program_and_a_plan_knows_what_the_last_run_was_told() {
    let place = with_renderer();
    let tauflow = |arguments: &[&str]| -> Said { with(&place, arguments, &[]) };
    let asked = || place.path("asked").exists();
    let look = || {
        tauflow(&["check", "small.yaml"]).ends(0);
        tauflow(&["graph", "small.yaml"]).ends(0);
        let explained = tauflow(&["explain", "small.yaml", "rendered"]).ends(0);
        (tauflow(&["plan", "small.yaml"]).ends(0), explained)
    };
    look();
    assert!(!asked(), "nothing has run, and nothing may");
    tauflow(&["run", "small.yaml", "--target", "scenes"]).ends(0);
    assert!(!asked(), "what is not asked for is not asked");
    // The items are known now, and their keys are not.
    let (plan, explained) = look();
    assert!(!asked());
    let row = plan.lines().into_iter().find(|line| line.starts_with("rendered")).unwrap_or_default().to_owned();
    assert!(row.contains("2 unknown") && row.contains(" 0 "), "{}", plan.out);
    assert!(plan.out.contains("rendered: 2 x unknown: the version of a program is needed"), "{}", plan.out);
    assert!(!plan.out.contains("nothing to do"), "{}", plan.out);
    assert!(explained.out.contains("2 x unknown: the version of a program is needed"), "{}", explained.out);
    let one = tauflow(&["explain", "small.yaml", "rendered", "L0-open-000000"]).ends(0);
    assert!(
        one.lines().contains(&"key        unknown") && one.out.contains("\nunknown: the version of a program"),
        "{}",
        one.out
    );
    assert!(!asked());
    tauflow(&["run", "small.yaml"]).ends(0);
    assert!(asked(), "a run asks");
    std::fs::remove_file(place.path("asked")).expect("it was there");
    let (plan, explained) = look();
    assert!(plan.out.contains("nothing to do"), "{}", plan.out);
    assert!(explained.out.contains("no input has changed"), "{}", explained.out);
    tauflow(&["export", "small.yaml", "rendered", "--out", "images"]).ends(0);
    assert!(!asked(), "what the last run was told is known");
    // Another program is another question.
    place.write("version.sh", &format!("touch {} # and more\necho 1\n", place.path("asked").display()));
    let (plan, _) = look();
    assert!(plan.out.contains("2 unknown") && !asked(), "{}", plan.out);
}
