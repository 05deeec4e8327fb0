//! What `plan`, `explain` and `run` say, word for word, with times, sizes and digests blanked out.

use crate::{PIPELINE, Place, json};
use insta::assert_snapshot;
use serde_json::Value;

/// The text with every time, size and digest replaced, and blanks between words counted as one.
fn plain(text: &str) -> String {
    let is_number = |word: &str| word.trim_start_matches('(').parse::<f64>().is_ok();
    let unit = |word: &str| match word.trim_end_matches([',', ')', ';']) {
        "s" | "min" | "h" => Some("TIME"),
        "B" | "KiB" | "MiB" | "GiB" => Some("SIZE"),
        _ => None,
    };
    let is_digest = |word: &str| {
        let hex: String = word.trim_matches('"').chars().take_while(char::is_ascii_hexdigit).collect();
        hex.len() >= 8 && hex.chars().any(|c| c.is_ascii_digit()) && !word.contains('.')
    };
    let line = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let mut out: Vec<String> = Vec::new();
        let mut at = 0;
        while at < words.len() {
            let word = words[at];
            let next = words.get(at + 1).and_then(|next| unit(next));
            if is_number(word)
                && let Some(what) = next
            {
                let open = if word.starts_with('(') { "(" } else { "" };
                let close: String = words[at + 1].chars().filter(|c| ",);".contains(*c)).collect();
                out.push(format!("{open}{what}{close}"));
                at += 2;
                continue;
            }
            out.push(if is_digest(word) { "DIGEST".into() } else { word.to_owned() });
            at += 1;
        }
        let indent = line.len() - line.trim_start().len();
        format!("{}{}", " ".repeat(indent), out.join(" "))
    };
    // What takes long is told, if anything does: that is the machine's.
    text.lines().filter(|text| !text.starts_with("slowest: ")).map(line).collect::<Vec<_>>().join("\n")
}

#[test]
fn plans() {
    let place = Place::new();
    let said = |more: &[&str]| place.tauflow(&[&["plan", "small.yaml"], more].concat()).ends(0).out;
    // The ends of a range may look alike, and are shown as one then.
    let plan = |more: &[&str]| plain(&said(more)).replace("TIME to TIME", "TIME").replace("SIZE to SIZE", "SIZE");
    assert_snapshot!("plan_of_an_empty_cache", plan(&[]));
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert_snapshot!("plan_with_nothing_to_do", plan(&[]));
    assert_snapshot!("plan_of_more_scenes", plan(&["--profile", "more"]));
    assert_snapshot!("plan_of_another_param", plan(&["--set", "split.test_share=0.4"]));
}

#[test]
fn explanations() {
    let place = Place::new();
    let explain = |rest: &[&str]| plain(&place.tauflow(&[&["explain", "small.yaml"], rest].concat()).ends(0).out);
    assert_snapshot!("explain_before_anything_ran", explain(&["split"]));
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert_snapshot!("explain_a_node_of_many_items", explain(&["scenes"]));
    assert_snapshot!("explain_an_item_in_full", explain(&["scenes", "L0-open-000000"]));
    assert_snapshot!("explain_another_param", explain(&["split", "--set", "split.test_share=0.4"]));
}

#[test]
fn runs() {
    let place = Place::new();
    let run = |code: i32| plain(&place.tauflow(&["run", "small.yaml"]).ends(code).err);
    // How far it is at which moment differs from run to run; the account at the end does not.
    let account = |text: &str| {
        let at = text.lines().position(|line| line.starts_with("node ")).unwrap_or(0);
        text.lines().skip(at).collect::<Vec<_>>().join("\n")
    };
    assert_snapshot!("run_from_an_empty_cache", account(&run(0)));
    assert_snapshot!("run_with_nothing_to_do", run(0));
    place.write("small.yaml", &PIPELINE.replace("train: 2,", "train: 200,"));
    assert_snapshot!("run_with_a_failure", account(&run(1)));
}

#[test]
fn events() {
    let place = Place::with(&PIPELINE.replace("train: 2,", "train: 200,"));
    let said = place.tauflow(&["run", "small.yaml", "--events", "json", "--jobs", "1"]).ends(1);
    let blank = |line: &str| {
        let mut event = json(line);
        blank_out(&mut event);
        event.to_string()
    };
    // Of the many that tell what begins and ends, one of each.
    let mut seen = std::collections::BTreeSet::new();
    let lines: Vec<String> = said.lines().into_iter().map(blank).collect();
    let first = lines.iter().filter(|line| seen.insert(line.split("\"event\":").nth(1).unwrap_or("")[..8].to_owned()));
    assert_snapshot!("events_of_a_run", first.cloned().collect::<Vec<_>>().join("\n"));
}

/// Numbers that differ from run to run, and which item came first.
fn blank_out(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                let varies =
                    name.ends_with("_s") || name.ends_with("_us") || ["bytes", "written"].contains(&name.as_str());
                if varies && field.is_number() {
                    *field = Value::from(0);
                } else if name == "item" && field.as_str().is_some_and(|item| item.contains("00")) {
                    *field = Value::from("ITEM");
                } else if name == "slowest" {
                    *field = Value::Array(Vec::new());
                } else {
                    blank_out(field);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(blank_out),
        _ => {}
    }
}
