//! `status` and the page of a run: what others see of a run that goes on, that was killed, and that has ended.

use crate::{Place, Said, json};
use serde_json::Value;
use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    process::{Child, Stdio},
    thread,
    time::{Duration, Instant},
};

/// A program that says that it began, and waits until it is let go or told to fail.
const PIPELINE: &str = "\
pipeline: small
nodes:
  first:
    kind: command
    params:
      run: [sh, -c, mkdir out/first/a; echo 1 > out/first/a/n]
      mode: gather
      outputs: { first: tauflow/files }
  waits:
    kind: command
    inputs: { first: first }
    params:
      run: [sh, wait.sh]
      inputs: { first: tauflow/files }
      outputs: { waits: tauflow/files }
";

const WAIT: &str = "\
touch HERE/began
while ! test -e HERE/go; do test -d HERE || exit 1; sleep 0.05; done
if grep -q fail HERE/go; then echo 'no <luck> today' >&2; exit 7; fi
echo 1 > out/waits/n
";

fn place() -> Place {
    let place = Place::with(PIPELINE);
    place.write("wait.sh", &WAIT.replace("HERE", &place.path("").display().to_string()));
    place
}

/// A run that has come to the program that waits.
fn begun(place: &Place) -> Child {
    let mut command = place.command(&["run", "small.yaml"]);
    let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    soon("the program runs", || place.path("began").exists().then_some(()));
    child
}

/// What is so before long.
fn soon<T>(what: &str, mut of: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = of() {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "in vain: {what}");
        thread::sleep(Duration::from_millis(50));
    }
}

fn page(place: &Place) -> Option<String> {
    fs::read_to_string(place.path("out/small/index.html")).ok()
}

fn value(said: &Said) -> Value {
    json(said.out.lines().last().unwrap_or_default())
}

#[test]
fn a_run_is_seen_while_it_goes_on_after_it_was_killed_and_at_its_end() {
    let place = place();
    let none = place.tauflow(&["status"]).ends(2);
    assert!(none.err.contains("there is no cache at"), "{}", none.err);

    let mut run = begun(&place);
    let seen = soon("its action is shown", || {
        let said = place.tauflow(&["status", "small.yaml"]).ends(0);
        said.out.contains("\n  waits/a").then_some(said)
    });
    assert!(seen.out.contains("going for ") && seen.out.contains(&format!("process {}", run.id())), "{}", seen.out);
    let first = seen.lines().into_iter().find(|line| line.starts_with("first ")).unwrap_or_default();
    assert_eq!(first.split_whitespace().nth(1), Some("1"), "{}", seen.out);
    let json = value(&place.tauflow(&["status", "--json"]).ends(0));
    assert_eq!((&json["outcome"], &json["standing"]), (&"running".into(), &"going".into()));
    assert_eq!(json["state"]["running"][0]["node"], "waits");
    let html = soon("its page", || page(&place).filter(|html| html.contains("waits/a")));
    assert!(html.contains("http-equiv=\"refresh\"") && html.contains("class=\"state running\""), "{html}");
    assert!(place.tauflow(&["runs"]).ends(0).out.contains(" running "));

    run.kill().expect("our own");
    run.wait().expect("our own");
    let killed = place.tauflow(&["status"]).ends(0);
    assert!(killed.out.starts_with("no run is going in "), "{}", killed.out);
    assert!(
        killed.out.contains(" of small was killed after ") && killed.out.contains("with 1 action run"),
        "{}",
        killed.out
    );
    let record = value(&place.tauflow(&["runs", "--json"]).ends(0));
    assert_eq!((&record["outcome"], &record["nodes"][0]["ran"]), (&"killed".into(), &1.into()));
    assert!(record["elapsed_s"].as_f64().is_some_and(|seconds| seconds > 0.0), "{record}");

    place.write("go", "");
    // A part does not make the whole good.
    place.tauflow(&["run", "small.yaml", "--target", "first"]).ends(0);
    assert!(place.tauflow(&["status"]).ends(0).out.contains("was killed"));
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let ended = place.tauflow(&["status"]).ends(0);
    assert!(ended.out.contains("last run: ") && ended.out.contains(" of small: done after "), "{}", ended.out);
    assert!(!ended.out.contains("was killed"), "what a later run has done is told no more: {}", ended.out);
    let states = fs::read_dir(place.path("store/runs")).expect("records");
    let live = states.filter(|entry| entry.as_ref().is_ok_and(|e| e.path().extension().is_some_and(|e| e == "live")));
    assert_eq!(live.count(), 1, "that of the run that was killed");
    let html = page(&place).expect("a page");
    assert!(!html.contains("http-equiv=\"refresh\"") && html.contains("class=\"state done\""), "{html}");
    assert!(html.contains("<h2>Timeline</h2>") && html.contains("<h2>Graph</h2>"), "{html}");
    let outside = html.replace("http://www.w3.org/2000/svg", "");
    assert!(!outside.contains("://"), "it needs no network: {html}");
    place.tauflow(&["run", "small.yaml"]).ends(0);
    assert_eq!(page(&place), Some(html), "a run that does nothing leaves the page of the one that did the work");
}

#[test]
fn a_page_tells_failures_with_their_messages_and_how_to_retry() {
    let place = place();
    place.write("go", "fail");
    place.tauflow(&["run", "small.yaml"]).ends(1);
    let html = page(&place).expect("a page");
    assert!(html.contains("class=\"state failed\"") && html.contains("<h2>Failures: 1</h2>"), "{html}");
    assert!(html.contains("no &lt;luck&gt; today") && html.contains("run small.yaml --only waits/a"), "{html}");
    // Items that fail for one cause have one message.
    let first = "mkdir out/first/a; echo 1 > out/first/a/n";
    let more = "for i in a b c; do mkdir out/first/$i; echo $i > out/first/$i/n; done";
    place.write("small.yaml", &PIPELINE.replace(first, &format!("'{more}'")));
    place.tauflow(&["run", "small.yaml"]).ends(1);
    let html = page(&place).expect("a page");
    assert!(html.contains("<h2>Failures: 3</h2>") && html.contains("and 2 others with the same cause"), "{html}");
    assert_eq!(html.matches("no &lt;luck&gt; today").count(), 1, "{html}");
}

#[test]
fn the_end_of_a_run_is_posted_and_a_deaf_server_is_only_a_note() {
    let place = place();
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}/secret", listener.local_addr().expect("bound"));
    let serving = thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a client");
        let (mut asked, mut chunk) = (String::new(), [0; 4096]);
        while !asked.ends_with('}') {
            let count = stream.read(&mut chunk).expect("readable");
            assert!(count > 0, "{asked}");
            asked += &String::from_utf8_lossy(&chunk[..count]);
        }
        stream.write_all(b"HTTP/1.1 200 OK\r\n\r\n").expect("writable");
        asked
    });
    place.write("go", "fail");
    place.tauflow(&["run", "small.yaml", "--notify", &url]).ends(1);
    let asked = serving.join().expect("it served");
    let (head, body) = asked.split_once("\r\n\r\n").expect("a body");
    assert!(head.starts_with("POST /secret HTTP/1.1\r\n"), "{head}");
    let body = json(body);
    assert_eq!((&body["pipeline"], &body["state"], &body["failures"]), (&"small".into(), &"failed".into(), &1.into()));
    assert_eq!(body["first_failure"]["action"], "waits/a");
    let record = value(&place.tauflow(&["runs", "--json"]).ends(0));
    assert_eq!(record["id"], body["id"]);
    assert!(!record.to_string().contains("secret"), "{record}");
    // Nobody listens there any more.
    place.write("go", "");
    let alone = place.tauflow(&["run", "small.yaml", "--notify", &url]).ends(0);
    assert!(alone.err.contains("/... was not notified: "), "{}", alone.err);
    let bad = place.tauflow(&["run", "small.yaml", "--notify", "example.org"]).ends(2);
    assert!(bad.err.contains("it must begin with http:// or https://"), "{}", bad.err);
}
