//! One run of a program: the folder that it works in, and the outputs that it leaves there. Knows no keys.

use super::{CommandMode, CommandParams, ImageFiles};
use crate::{
    pfm::{as_pfm, from_pfm},
    process::{Ended, Launch, Ran, tail},
};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    time::Duration,
};
use tauflow_contract::{
    Action, Artifact, Collection, Context, FileTree, ItemKey, KindError, MediaRow, Outputs, ReadFiles, WriteFiles,
    pretty_json,
};
use tauflow_data::{folder::DiskFolder, records::media};

/// A run of a program for one item, or for all items.
pub(super) struct Invocation<'a> {
    pub ctx: &'a Context<'a>,
    pub params: &'a CommandParams,
    pub action: &'a Action<'a, CommandParams>,
}

impl Invocation<'_> {
    pub fn failed(&self, what: &str) -> KindError {
        KindError::Environment(format!("the command `{}` {what}", self.params.run.join(" ")))
    }

    fn no_folder(&self, error: &std::io::Error) -> KindError {
        self.failed(&format!("got no folder to work in: {error}"))
    }

    /// Runs it in a folder of its own, and reads its outputs.
    pub fn once(&self) -> Result<Outputs, KindError> {
        let own = tempfile::tempdir().map_err(|e| self.no_folder(&e))?;
        let (folder, temporary) = (own.path().join("work"), own.path().join("tmp"));
        for made in [&folder, &temporary] {
            fs::create_dir(made).map_err(|e| self.no_folder(&e))?;
        }
        self.lay_out(&folder)?;
        let words: Vec<String> = self.params.run.iter().enumerate().map(|(at, word)| whole(at, word)).collect();
        self.ctx.check_cancelled()?;
        let launch = Launch {
            words: &words,
            folder: Some(&folder),
            temporary: &temporary,
            own: own.path(),
            variables: &self.params.variables,
            trace: true,
            time: Some(Duration::from_secs_f64(self.params.time)),
            memory: self.params.memory.map(|mib| mib << 20),
        };
        let Ran { ended, seen, .. } = launch.run(self.ctx)?;
        match ended {
            Ended::Not(error) => Err(self.failed(&format!("cannot be started: {error}; install it, or correct `run`"))),
            Ended::Late(told) => {
                let time = self.params.time;
                Err(self.failed(&format!("took longer than {time} s (`time`) and was ended{}", tail(&told))))
            }
            Ended::Itself(status, told) if !status.success() => {
                let limit = self.params.memory.map(|mib| format!(" (`memory` allows {mib} MiB)"));
                let limit = limit.unwrap_or_default();
                Err(self.failed(&format!("failed with {status}{limit}{}", tail(&told))))
            }
            Ended::Itself(_, told) => match self.outputs(&folder.join("out")) {
                Ok(outputs) => Ok(Outputs { seen, ..outputs }),
                Err(KindError::Environment(what)) => Err(KindError::Environment(format!("{what}{}", tail(&told)))),
                Err(other) => Err(other),
            },
        }
    }

    /// Writes `params.json` and the inputs, and makes the folders of outputs.
    fn lay_out(&self, folder: &Path) -> Result<(), KindError> {
        let Self { ctx, params, action } = self;
        let mut files = DiskFolder::new(folder);
        let keys = |all: &&Collection| all.iter().map(|(key, _)| key.as_str().to_owned()).collect::<Vec<_>>();
        let items: BTreeMap<_, _> = action.all.iter().map(|(port, all)| (*port, keys(all))).collect();
        let told = json!({
            "values": params.values, "mode": params.mode, "inputs": params.inputs, "collections": params.collections,
            "outputs": params.outputs, "items": items,
        });
        files.put("params.json", &pretty_json(&told)?)?;
        for (name, _, is_whole) in params.sources() {
            let within = folder.join("in").join(name);
            fs::create_dir_all(&within).map_err(|e| self.no_folder(&e))?;
            if is_whole {
                let all = action.all.get(name.as_str()).copied();
                for (key, artifact) in all.into_iter().flat_map(Collection::iter) {
                    check_apart(name, key, all)?;
                    self.hand_over(ctx, artifact, &within.join(key.as_str()))?;
                }
            } else if let Some(artifact) = action.each.get(name.as_str()) {
                self.hand_over(ctx, artifact, &within)?;
            }
        }
        for name in params.outputs.keys() {
            fs::create_dir_all(folder.join("out").join(name)).map_err(|e| self.no_folder(&e))?;
        }
        Ok(())
    }

    fn hand_over(&self, ctx: &Context<'_>, artifact: &Artifact, to: &Path) -> Result<(), KindError> {
        let mut files = FileTree::new();
        (row(&artifact.media)?.export)(ctx, artifact, &mut files)?;
        if self.params.images == ImageFiles::Pfm {
            files = as_pfm(&files)?;
        }
        let mut folder = DiskFolder::new(to);
        files.iter().try_for_each(|(name, bytes)| folder.put(name, bytes))
    }

    fn outputs(&self, out: &Path) -> Result<Outputs, KindError> {
        let declared: BTreeSet<&str> = self.params.outputs.keys().map(String::as_str).collect();
        let extra = entries(out)?.into_iter().find(|name| !declared.contains(name.as_str()));
        if let Some(extra) = extra {
            return Err(self.failed(&format!(
                "left `out/{extra}`, which is not declared; its outputs are `{}`",
                declared.into_iter().collect::<Vec<_>>().join("`, `")
            )));
        }
        let mut outputs = Outputs::default();
        for (name, of) in &self.params.outputs {
            let folder = out.join(name);
            if self.params.mode == CommandMode::Map {
                outputs.items.insert(name.clone(), self.read(&folder, &format!("out/{name}"), of)?);
                continue;
            }
            let mut keys = Vec::new();
            self.find_items(&folder, &format!("out/{name}"), "", &mut keys)?;
            if keys.is_empty() {
                return Err(self.failed(&format!(
                    "left nothing in `out/{name}`; write each item into a directory `out/{name}/KEY`"
                )));
            }
            let item = |key: String| {
                let place = format!("out/{name}/{key}");
                let artifact = self.read(&folder.join(&key), &place, of)?;
                let key = ItemKey::new(key).map_err(|e| self.failed(&format!("left `{place}`: {e}")))?;
                Ok((key, artifact))
            };
            outputs.collections.insert(name.clone(), keys.into_iter().map(item).collect::<Result<_, KindError>>()?);
        }
        Ok(outputs)
    }

    /// The folders below `place` that have files, by their paths; what is below such a folder belongs to it.
    fn find_items(&self, folder: &Path, place: &str, prefix: &str, found: &mut Vec<String>) -> Result<(), KindError> {
        if folder.is_symlink() {
            return Err(self.link(&format!("{place}/{prefix}")));
        }
        for name in entries(folder)? {
            let path = folder.join(&name);
            if path.is_symlink() {
                return Err(self.link(&format!("{place}/{prefix}{name}")));
            }
            if !path.is_dir() {
                let what = format!("left the file `{prefix}{name}` outside of the directory of an item");
                return Err(self.failed(&what));
            }
            let key = format!("{prefix}{name}");
            let below = entries(&path)?;
            if below.is_empty() {
                return Err(self.failed(&format!("left the empty directory `{key}` for an item")));
            }
            if below.iter().any(|name| !path.join(name).is_dir()) {
                found.push(key);
            } else {
                self.find_items(&path, place, &format!("{key}/"), found)?;
            }
        }
        Ok(())
    }

    fn link(&self, place: &str) -> KindError {
        let place = place.trim_end_matches('/');
        self.failed(&format!("left the link `{place}`; put a copy of the file there"))
    }

    /// Refuses files that would be left out of an output, and links: the file that a link leads to may change, and
    /// nobody would know.
    fn check_names(&self, folder: &Path, place: &str) -> Result<(), KindError> {
        for name in entries(folder)? {
            let (path, place) = (folder.join(&name), format!("{place}/{name}"));
            if name.starts_with('.') {
                return Err(self.failed(&format!(
                    "left `{place}`, whose name begins with a dot; such files are never read: rename or remove it"
                )));
            }
            if path.is_symlink() {
                return Err(self.link(&place));
            }
            if path.is_dir() {
                self.check_names(&path, &place)?;
            }
        }
        Ok(())
    }

    /// An output, as `import` reads what `export` wrote.
    fn read(&self, folder: &Path, place: &str, of: &str) -> Result<Artifact, KindError> {
        let row = row(of)?;
        let unreadable = |error: KindError| match error {
            KindError::Input(what) => self.failed(&format!("left no `{of}` in `{place}`: {what}")),
            other => other,
        };
        if folder.is_symlink() {
            return Err(self.link(place));
        }
        if !folder.is_dir() {
            return Err(self.failed(&format!("removed the directory `{place}`")));
        }
        self.check_names(folder, place)?;
        let disk = DiskFolder::new(folder);
        let mut files = FileTree::new();
        for name in disk.names().map_err(unreadable)? {
            files.insert(name.clone(), disk.need(&name).map_err(unreadable)?);
        }
        if files.is_empty() {
            return Err(self.failed(&format!("left no files in `{place}`, expected a `{of}`: {}", row.doc)));
        }
        if self.params.images == ImageFiles::Pfm {
            files = from_pfm(files).map_err(unreadable)?;
        }
        let artifact = (row.import)(self.ctx, &files).map_err(unreadable)?;
        // What `export` does not write, `import` did not read.
        let mut known = FileTree::new();
        (row.export)(self.ctx, &artifact, &mut known)?;
        match files.keys().find(|name| !known.contains_key(*name)) {
            None => Ok(artifact),
            Some(extra) => Err(self.failed(&format!(
                "left `{place}/{extra}`, which is no file of this `{of}`; its files are `{}`",
                known.into_keys().collect::<Vec<_>>().join("`, `")
            ))),
        }
    }
}

/// The row of a media type, which `check` has found.
fn row(name: &str) -> Result<&'static MediaRow, KindError> {
    media(name).ok_or_else(|| KindError::Internal(format!("`{name}` is no media type")))
}

/// Refuses an item whose folder would lie in the folder of another.
fn check_apart(port: &str, key: &ItemKey, all: Option<&Collection>) -> Result<(), KindError> {
    let key = key.as_str();
    let mut above = key.match_indices('/').map(|(at, _)| &key[..at]);
    match above.find(|above| all.is_some_and(|all| all.get(above).is_some())) {
        None => Ok(()),
        Some(above) => Err(KindError::Input(format!(
            "input `{port}` has the items `{above}` and `{key}`, whose directories would lie in each other; rename one"
        ))),
    }
}

/// A word of a command line; the path of a file as a whole path, since the program works in another folder.
fn whole(at: usize, word: &str) -> String {
    let path = Path::new(word);
    let names = path.is_relative() && path.is_file() && (at > 0 || word.contains('/'));
    let absolute: Option<PathBuf> = names.then(|| std::path::absolute(path).ok()).flatten();
    absolute.map_or_else(|| word.to_owned(), |path| path.to_string_lossy().into_owned())
}

/// Names in a folder, sorted.
fn entries(folder: &Path) -> Result<Vec<String>, KindError> {
    let failed = |e: std::io::Error| KindError::Environment(format!("cannot list {}: {e}", folder.display()));
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        names.push(entry.map_err(failed)?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}
