//! `check`, `graph`, `kinds`, `init`: what can be said without a cache.

use crate::Place;
use std::{
    fs,
    io::Read,
    process::{Command, Stdio},
};
use tauflow_testing::{Need, skip};

#[test]
fn check_finds_nothing_wrong_with_a_good_pipeline() {
    let place = Place::new();
    let said = place.tauflow(&["check", "small.yaml"]).ends(0);
    assert_eq!(said.out, "small.yaml: no problems; 3 nodes, 3 cells\n");
    assert_eq!(said.err, "");
    assert!(!place.path("store").exists(), "a check needs no cache");
}

#[test]
fn check_names_every_problem_at_its_place() {
    let place = Place::with(
        "pipeline: small\nnodes:\n  scenes:\n    kind: scene_generaton\n  split:\n    \
         kind: content_signature_split\n    inputs: { scenes: scnes }\n    params: { test_shar: 0.5 }\n",
    );
    let said = place.tauflow(&["check", "small.yaml"]).ends(2);
    assert_eq!(said.out, "");
    for part in [
        "small.yaml:4:11",
        "unknown kind `scene_generaton`",
        "did you mean `scene_generation`?",
        "small.yaml:7:",
        "unknown node `scnes`",
        "small.yaml:8:",
        "did you mean `test_share`?",
        "3 problems found",
    ] {
        assert!(said.err.contains(part), "`{part}` is not in\n{}", said.err);
    }
}

#[test]
fn the_graph_is_drawn_in_three_formats() {
    let place = Place::new();
    let dot = place.tauflow(&["graph", "small.yaml"]).ends(0).out;
    assert!(dot.starts_with("digraph {") && dot.contains("scene_generation") && dot.contains("0 -> 1"), "{dot}");
    let mermaid = place.tauflow(&["graph", "small.yaml", "--format", "mermaid"]).ends(0).out;
    assert!(mermaid.starts_with("flowchart LR\n") && mermaid.contains("n0 --> n1"), "{mermaid}");
    let svg = place.tauflow(&["graph", "small.yaml", "--format", "svg"]).ends(0).out;
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"), "{svg}");
    assert_eq!(svg.matches("<rect ").count(), 1 + 3, "a background and three boxes");
    assert_eq!(svg.matches("<path ").count(), 3, "an arrow for each pair of ports");
    assert!(svg.contains("<title>split.test to sampling.test</title>") && !svg.contains("result"), "{svg}");
    place.tauflow(&["run", "small.yaml"]).ends(0);
    let svg = place.tauflow(&["graph", "small.yaml", "--format", "svg"]).ends(0).out;
    assert!(svg.contains(">8 results, "), "times come from the cache: {svg}");
}

#[test]
fn kinds_are_listed_and_explained() {
    let place = Place::new();
    let list = place.tauflow(&["kinds"]).ends(0);
    let names: Vec<&str> = list.lines().iter().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.is_sorted() && names.contains(&"scene_generation"), "{names:?}");
    assert!(list.lines().iter().all(|line| line.split_whitespace().count() > 3), "each has a summary: {}", list.out);
    let manual = place.tauflow(&["kinds", "stratified_sampling"]).ends(0).out;
    for part in ["# stratified_sampling\n", "```yaml", "## Ports", "## Params", "| `train` |"] {
        assert!(manual.contains(part), "`{part}` is not in\n{manual}");
    }
    let said = place.tauflow(&["kinds", "stratified_samplng"]).ends(2);
    assert_eq!(said.err, "error: unknown kind `stratified_samplng`; did you mean `stratified_sampling`?\n");
}

#[test]
fn init_writes_a_pipeline_that_checks_and_overwrites_nothing() {
    let place = Place::new();
    let said = place.tauflow(&["init", "first"]).ends(0);
    assert_eq!(said.lines(), ["first/pipeline.yaml", "first/tauflow.schema.json"]);
    assert!(said.err.contains("tauflow run first/pipeline.yaml"), "{}", said.err);
    place.tauflow(&["check", "first/pipeline.yaml"]).ends(0);
    place.write("first/pipeline.yaml", "mine");
    let said = place.tauflow(&["init", "first"]).ends(2);
    assert!(said.err.contains("first/pipeline.yaml already exists"), "{}", said.err);
    assert_eq!(fs::read_to_string(place.path("first/pipeline.yaml")).expect("it is there"), "mine");
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let place = Place::new();
    let mut child =
        place.command(&["schema"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the program starts");
    // Closed before a byte is read; the schema is longer than a pipe's buffer, or its write fails at once.
    drop(child.stdout.take());
    let mut err = String::new();
    child.stderr.take().expect("it was asked for").read_to_string(&mut err).expect("text");
    assert!(child.wait().expect("it ends").success());
    assert_eq!(err, "");
}

#[test]
fn a_run_of_which_nobody_reads_the_progress_goes_on() {
    for executor in ["threads", "process"] {
        let place = Place::new();
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut run = place.command(&["run", "small.yaml", "--executor", executor]);
        // A run that waited for a thread that is gone would never end.
        let mut run = run.stdout(Stdio::null()).stderr(writer).spawn().expect("the program starts");
        let ended = (0..600).find_map(|_| {
            std::thread::sleep(std::time::Duration::from_millis(100));
            run.try_wait().expect("a child of ours")
        });
        let _ = run.kill();
        assert!(ended.expect("it ends").success(), "{executor}");
        let said = place.tauflow(&["run", "small.yaml"]).ends(0);
        assert!(said.err.contains("nothing to do"), "{executor}: {}", said.err);
    }
}

/// What a shell writes, if there is one.
fn shell(place: &Place, name: &str, arguments: &[&str], need: Need) -> Option<String> {
    match Command::new(name).args(arguments).current_dir(place.path("")).stdin(Stdio::null()).output() {
        Ok(said) => Some(format!("{}{}", String::from_utf8_lossy(&said.stdout), String::from_utf8_lossy(&said.stderr))),
        Err(error) => {
            skip(need, format_args!("{name} does not start: {error}"));
            None
        }
    }
}

/// A terminal of zsh's own, as it completes in none else; the last key writes down what the line has become.
const ZSH: &str = r#"
zmodload zsh/zpty
zpty inner zsh -f -i
zpty -w inner 'fpath=($PWD $fpath); autoload -U compinit; compinit -u -d ./dump'
zpty -w inner 'tell() { print -r -- "$BUFFER" >> lines; BUFFER= }; zle -N tell; bindkey "^X" tell; print re"ady"'
zpty -r -m inner line '*ready*'
ask() {
    zpty -w -n inner "$1"
    for i in {1..600}; do
        [[ -f lines && $(wc -l < lines) -ge $2 ]] && return
        sleep 0.1
    done
}
ask $'tauflow cac\t\C-X' 1
# Another line is typed once there is a prompt for it.
sleep 0.5
ask $'tauflow run --loc\t\C-X' 2
cat lines
"#;

/// Shells read the script and complete by it.
#[test]
fn commands_and_options_complete_in_a_shell() {
    let place = Place::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = place.tauflow(&["completions", shell]).ends(0).out;
        assert!(script.contains("recheck") && script.contains("mitsuba"), "{shell}: {script}");
    }
    for (shell, file) in [("bash", "complete.sh"), ("fish", "complete.fish"), ("zsh", "_tauflow")] {
        place.write(file, &place.tauflow(&["completions", shell]).ends(0).out);
    }
    let asks = "source ./complete.sh; COMP_WORDS=(tauflow ca); COMP_CWORD=1; _tauflow tauflow ca tauflow; \
                echo ${COMPREPLY[@]}; COMP_WORDS=(tauflow run --loc); COMP_CWORD=2; _tauflow tauflow --loc run; \
                echo ${COMPREPLY[@]}";
    if let Some(said) = shell(&place, "bash", &["-c", asks], Need::Bash) {
        assert_eq!(said, "cache\n--locked\n");
    }
    let asks = "source ./complete.fish; complete -C 'tauflow ca'; complete -C 'tauflow run --loc'";
    if let Some(said) = shell(&place, "fish", &["--no-config", "-c", asks], Need::Fish) {
        let words: Vec<&str> = said.lines().filter_map(|line| line.split('\t').next()).collect();
        assert_eq!(words, ["cache", "--locked"], "{said}");
    }
    place.write("asks.zsh", ZSH);
    if let Some(said) = shell(&place, "zsh", &["-f", "asks.zsh"], Need::Zsh) {
        let lines: Vec<&str> = said.lines().map(str::trim_end).collect();
        assert_eq!(lines, ["tauflow cache", "tauflow run --locked"], "{said}");
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let place = Place::new();
    place.tauflow(&["man", "pages"]).ends(0);
    let help = place.tauflow(&["help"]).ends(0).out;
    let commands: Vec<&str> = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert!(commands.len() > 10, "{help}");
    for command in commands {
        let page = fs::read_to_string(place.path(&format!("pages/tauflow-{command}.1"))).expect(command);
        assert!(page.contains(".SH SYNOPSIS"), "{page}");
    }
    let Some(shown) = shell(&place, "man", &["-l", "pages/tauflow-run.1"], Need::Man) else { return };
    if shown.contains("has been minimized") {
        skip(Need::Man, "`man` is a stand-in that says how to install it");
        return;
    }
    // Bold letters are struck twice.
    let letters: Vec<char> = shown.chars().collect();
    let plain: String = (0..letters.len())
        .filter(|i| letters[*i] != '\u{8}' && letters.get(i + 1) != Some(&'\u{8}'))
        .map(|i| letters[i])
        .collect();
    assert!(plain.contains("SYNOPSIS") && plain.contains("--update-lock"), "{shown}");
    place.write("taken", "a file");
    let said = place.tauflow(&["man", "taken"]).ends(3);
    assert!(said.err.contains("cannot write into taken"), "{}", said.err);
}

/// `script` gives the program a terminal; without it there is none to look at.
#[test]
fn a_terminal_shows_colours_unless_it_is_asked_not_to() {
    let place = Place::with("pipeline: small\nnodes:\n  scenes:\n    kind: scene_generaton\n");
    let shown = |variables: &[(&str, &str)]| {
        let program = format!("{} check small.yaml", env!("CARGO_BIN_EXE_tauflow"));
        let mut command = Command::new("script");
        command.args(["-qec", &program, "/dev/null"]).current_dir(place.path("")).stdin(Stdio::null());
        command.env_remove("NO_COLOR").env("TERM", "xterm-256color").envs(variables.iter().copied());
        command.output().map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
    };
    match shown(&[]) {
        Err(error) => skip(Need::Script, format_args!("`script` does not start: {error}")),
        Ok(text) => {
            assert!(text.contains("\u{1b}["), "{text}");
            for quiet in [("NO_COLOR", "1"), ("TERM", "dumb")] {
                let text = shown(&[quiet]).expect("it started before");
                assert!(text.contains("scene_generaton") && !text.contains('\u{1b}'), "{quiet:?}: {text}");
            }
            assert!(shown(&[("NO_COLOR", "")]).expect("it started before").contains("\u{1b}["), "empty asks nothing");
        }
    }
}
