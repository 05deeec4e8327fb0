//! Holds what `deny.toml` says of dependencies: their licences, which crates are banned, and where all come from.
//! It needs neither the net nor `cargo deny`. Advisories are `cargo deny`'s alone.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::PathBuf,
    process::Command,
};

fn text(file: &str) -> String {
    fs::read_to_string(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(file)).expect("a file of the repository")
}

fn tree(more: &[&str]) -> Vec<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["tree", "--offline", "--workspace"])
        .args(["--edges", "normal,build,dev", "--prefix", "none"])
        .args(more)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs this test, so it can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: BTreeSet<String> = String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect();
    lines.into_iter().filter(|line| !line.is_empty()).collect()
}

/// What `deny.toml` says.
#[derive(Default)]
struct Policy {
    /// Licences that any crate may have.
    licenses: BTreeSet<String>,
    /// Further ones of single crates.
    exceptions: BTreeMap<String, BTreeSet<String>>,
    /// Crates that nobody may depend on but those that are listed.
    banned: BTreeMap<String, BTreeSet<String>>,
}

/// All texts in quotation marks.
fn quoted(text: &str) -> impl Iterator<Item = String> + '_ {
    text.split('"').skip(1).step_by(2).map(str::to_owned)
}

/// The list of a key in a section, without comments.
fn list(text: &str, section: &str, key: &str) -> String {
    let plain: Vec<&str> = text.lines().map(|line| line.split('#').next().unwrap_or_default()).collect();
    let plain = plain.join("\n");
    let (_, after) = plain.split_once(&format!("[{section}]")).expect("the section is there");
    let (_, list) = after.split_once(&format!("\n{key} = [")).expect("the key is there");
    let (list, _) = list.split_once("\n]").expect("the list ends on a line of its own");
    list.to_owned()
}

impl Policy {
    fn parse(text: &str) -> Self {
        let entries = |section: &str, key: &str| -> BTreeMap<String, BTreeSet<String>> {
            let list = list(text, section, key);
            let entries = list.split("crate = ").skip(1).map(|entry| {
                let mut texts = quoted(entry);
                (texts.next().expect("a crate's name"), texts.collect())
            });
            entries.collect()
        };
        Self {
            licenses: quoted(&list(text, "licenses", "allow")).collect(),
            exceptions: entries("licenses", "exceptions"),
            banned: entries("bans", "deny"),
        }
    }

    /// Whether a crate may have a licence: an SPDX expression, or the older form with `/` for `OR`.
    fn allows(&self, name: &str, license: &str) -> bool {
        let spaced = license.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
        let words: Vec<&str> = spaced.split_whitespace().collect();
        let mut rest = &words[..];
        let fine = self.either(name, &mut rest);
        fine && rest.is_empty() && !words.is_empty()
    }

    fn either(&self, name: &str, rest: &mut &[&str]) -> bool {
        let mut fine = self.both(name, rest);
        while let Some(("OR", after)) = rest.split_first().map(|(word, after)| (*word, after)) {
            *rest = after;
            fine |= self.both(name, rest);
        }
        fine
    }

    fn both(&self, name: &str, rest: &mut &[&str]) -> bool {
        let mut fine = self.one(name, rest);
        while let Some(("AND", after)) = rest.split_first().map(|(word, after)| (*word, after)) {
            *rest = after;
            fine &= self.one(name, rest);
        }
        fine
    }

    fn one(&self, name: &str, rest: &mut &[&str]) -> bool {
        let Some((word, after)) = rest.split_first() else { return false };
        *rest = after;
        if *word == "(" {
            let fine = self.either(name, rest);
            let closed = rest.first() == Some(&")");
            *rest = rest.get(1..).unwrap_or_default();
            return fine && closed;
        }
        let mut license = (*word).to_owned();
        if let ["WITH", exception, after @ ..] = *rest {
            license = format!("{license} WITH {exception}");
            *rest = after;
        }
        self.licenses.contains(&license) || self.exceptions.get(name).is_some_and(|own| own.contains(&license))
    }
}

fn name(line: &str) -> &str {
    line.split(' ').next().unwrap_or_default()
}

#[test]
fn licences_are_on_the_list() {
    let policy = Policy::parse(&text("deny.toml"));
    let lines = tree(&["--no-dedupe", "--format", "{p}|{l}"]);
    assert!(lines.len() > 100, "{lines:?}");
    let split = |line: &String| -> (String, String) {
        let (package, license) = line.rsplit_once('|').expect("as the format says");
        (name(package).to_owned(), license.to_owned())
    };
    let crates: Vec<(String, String)> = lines.iter().map(split).collect();
    let bad: Vec<_> = crates.iter().filter(|(name, license)| !policy.allows(name, license)).collect();
    assert!(bad.is_empty(), "licences that deny.toml does not allow; look at them, or choose other crates: {bad:?}");
    for exception in policy.exceptions.keys() {
        assert!(crates.iter().any(|(name, _)| name == exception), "deny.toml excepts `{exception}`, which is gone");
    }
}

#[test]
fn licences_are_read_as_expressions() {
    let policy = Policy::parse(&text("deny.toml"));
    for fine in ["MIT", "MIT/GPL-3.0", "(MIT OR GPL-3.0) AND Zlib", "Apache-2.0 WITH LLVM-exception OR GPL-2.0"] {
        assert!(policy.allows("x", fine), "{fine}");
    }
    for bad in ["", "GPL-3.0", "MIT AND GPL-3.0", "MPL-2.0", "MIT WITH nothing", "(MIT", "MIT)"] {
        assert!(!policy.allows("x", bad), "{bad}");
    }
    assert!(policy.allows("colored", "MPL-2.0"));
}

#[test]
fn banned_crates_come_in_through_nobody_but_those_that_are_named() {
    let policy = Policy::parse(&text("deny.toml"));
    let crates: BTreeSet<String> = tree(&["--no-dedupe"]).iter().map(|line| name(line).to_owned()).collect();
    assert!(policy.banned.contains_key("serde_yaml") && crates.contains("burn"));
    for (banned, through) in &policy.banned {
        assert!(through.iter().all(|name| !name.starts_with("tauflow")), "`{banned}` is ours to leave out");
        if !crates.contains(banned) {
            assert!(through.is_empty(), "`{banned}` is gone: take {through:?} out of deny.toml");
            continue;
        }
        let users = tree(&["--invert", banned, "--depth", "1"]);
        let users: BTreeSet<String> = users.iter().map(|l| name(l).to_owned()).filter(|n| n != banned).collect();
        assert_eq!(&users, through, "who brings `{banned}`, and who may by deny.toml");
    }
}

#[test]
fn all_crates_come_from_the_registry() {
    let lock = text("Cargo.lock");
    let sources: BTreeSet<&str> = lock.lines().filter_map(|line| line.strip_prefix("source = ")).collect();
    assert_eq!(sources, BTreeSet::from(["\"registry+https://github.com/rust-lang/crates.io-index\""]));
}
