//! Artifacts as folders on disk: what `export` writes, and what is imported from there.
//!
//! A folder of items has a [`Manifest`], which is written last: where it stands, all that it lists is whole. Knows no
//! media type; each writes and reads its own files (see [`crate::records`]).

use crate::records;
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    ops::Bound,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};
use tauflow_contract::{
    Artifact, Collection, Context, Digest, ItemKey, KindError, ReadFiles, WriteFiles, parse_json, pretty_json,
};

/// File that lists the items of a folder.
pub const MANIFEST: &str = "manifest.json";

/// What a folder of items holds, and where it came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The pipeline; empty for what another program made.
    #[serde(default)]
    pub pipeline: String,
    /// The node.
    #[serde(default)]
    pub node: String,
    /// Its output port.
    #[serde(default)]
    pub port: String,
    /// The items.
    pub items: Vec<ExportedItem>,
}

/// An item in a folder of its own, which is named by its key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExportedItem {
    /// Its key.
    pub item: ItemKey,
    /// Name of its media type.
    pub media: String,
    /// Content digest of the artifact that was exported; none for what another program made.
    #[serde(default)]
    pub digest: Option<Digest>,
    /// Content digests of its parts, for `cache pin` and such.
    #[serde(default)]
    pub parts: BTreeMap<String, Digest>,
    /// Its files; none for whatever there is.
    #[serde(default)]
    pub files: Option<Vec<String>>,
}

/// A folder on disk. Each file is written whole or not at all, and no name leads out of it.
#[derive(Clone, Debug)]
pub struct DiskFolder {
    path: PathBuf,
    /// The files that are looked at; none for all.
    listed: Option<BTreeSet<String>>,
    written: BTreeSet<String>,
    /// The item whose folder it is, and the files of all items that were written with it.
    item: Option<ItemKey>,
    taken: Arc<Mutex<BTreeMap<PathBuf, ItemKey>>>,
}

impl DiskFolder {
    /// A folder, which is made once something is written.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        let (listed, written, taken) = Default::default();
        Self { path: path.into(), listed, written, item: None, taken }
    }

    /// The folder of an item.
    fn of_item(&self, item: &ItemKey) -> Self {
        // A key is a path below the folder: that is what `ItemKey::new` checks.
        let path = self.path.join(item.as_str());
        Self { path, item: Some(item.clone()), taken: self.taken.clone(), ..Self::new("") }
    }

    /// Takes a file for this folder's item: the folders of items may lie in each other, and their files may meet.
    fn take(&self, path: &Path) -> Result<(), KindError> {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        let others = |item: &&ItemKey| Some(*item) != self.item.as_ref();
        let above = path.ancestors().find_map(|above| taken.get(above).filter(others));
        let below = taken.range::<Path, _>((Bound::Excluded(path), Bound::Unbounded)).next();
        let below = below.filter(|(other, _)| other.starts_with(path)).map(|(_, item)| item).filter(others);
        if let Some(other) = above.or(below) {
            let own = self.item.as_ref().map_or_else(|| "the list of all items".to_owned(), |item| format!("`{item}`"));
            return Err(KindError::Input(format!(
                "`{other}` and {own} meet in the file {}; export them one by one, or give one of them another key",
                path.display()
            )));
        }
        if let Some(item) = &self.item {
            taken.insert(path.to_owned(), item.clone());
        }
        Ok(())
    }

    /// The file of a name: names of files are held to the rule of keys, so that none leads out of the folder.
    fn file(&self, name: &str) -> Result<PathBuf, KindError> {
        ItemKey::check(name)
            .map_err(|error| KindError::Input(format!("a file in {}: {error}", self.path.display())))?;
        Ok(self.path.join(name))
    }

    fn list(&self, below: &Path, prefix: &str, found: &mut Vec<String>) -> Result<(), KindError> {
        let failed = |e: io::Error| KindError::Environment(format!("cannot list {}: {e}", below.display()));
        for entry in fs::read_dir(below).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let name = entry.file_name().into_string().map_err(|name| {
                KindError::Input(format!("{}: the name {name:?} is not UTF-8; rename the file", below.display()))
            })?;
            // No export writes such names: they are of file managers, of version control, or of a process that was
            // killed at its work.
            if name.starts_with('.') {
                continue;
            }
            let full = format!("{prefix}{name}");
            if entry.file_type().map_err(failed)?.is_dir() {
                self.list(&entry.path(), &format!("{full}/"), found)?;
            } else {
                found.push(full);
            }
        }
        Ok(())
    }
}

/// Name of the file that is written first, and then renamed; none that is listed.
fn temporary(name: &str) -> String {
    #[expect(clippy::disallowed_methods, reason = "the name of a file that does not stay; no output holds it")]
    let process = std::process::id();
    format!(".{name}.{process}.tmp")
}

impl WriteFiles for DiskFolder {
    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), KindError> {
        let path = self.file(name)?;
        self.take(&path)?;
        let failed = |e: io::Error| KindError::Environment(format!("cannot write {}: {e}", path.display()));
        let (Some(folder), Some(own)) = (path.parent(), path.file_name()) else {
            return Err(KindError::Internal(format!("`{name}` was checked, and has no folder")));
        };
        fs::create_dir_all(folder).map_err(failed)?;
        let temporary = folder.join(temporary(&own.to_string_lossy()));
        fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, &path)).map_err(|error| {
            // Nobody has a use for half of a file, and it may not be there at all.
            let _ = fs::remove_file(&temporary);
            failed(error)
        })?;
        self.written.insert(name.to_owned());
        Ok(())
    }
}

impl ReadFiles for DiskFolder {
    fn names(&self) -> Result<Vec<String>, KindError> {
        if let Some(listed) = &self.listed {
            return Ok(listed.iter().cloned().collect());
        }
        let mut found = Vec::new();
        self.list(&self.path, "", &mut found)?;
        found.sort();
        Ok(found)
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, KindError> {
        let path = self.file(name)?;
        if self.listed.as_ref().is_some_and(|listed| !listed.contains(name)) {
            return Ok(None);
        }
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(KindError::Environment(format!("cannot read {}: {error}", path.display()))),
        }
    }
}

/// The row of a media type.
fn row(media: &str) -> Result<&'static tauflow_contract::MediaRow, KindError> {
    records::media(media).ok_or_else(|| {
        let names: Vec<&str> = records::MEDIA.iter().map(|row| row.name).collect();
        KindError::Input(format!("there is no media type `{media}`; there are {}", names.join(", ")))
    })
}

/// Forgets what a folder held, so that a manifest stands for what is written now alone.
///
/// # Errors
/// If the manifest is there and cannot be removed.
pub fn begin(out: &DiskFolder) -> Result<(), KindError> {
    let path = out.file(MANIFEST)?;
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(KindError::Environment(format!("cannot remove {}: {error}", path.display())))
        }
        _ => Ok(()),
    }
}

/// Writes an item into a folder of its own.
///
/// # Errors
/// If it is not whole, its media type is unknown, or a file cannot be written.
pub fn export_item(
    ctx: &Context<'_>,
    item: &ItemKey,
    artifact: &Artifact,
    out: &DiskFolder,
) -> Result<ExportedItem, KindError> {
    let mut own = out.of_item(item);
    (row(&artifact.media)?.export)(ctx, artifact, &mut own)?;
    Ok(ExportedItem {
        item: item.clone(),
        media: artifact.media.clone(),
        digest: Some(artifact.digest()),
        parts: artifact.parts.iter().map(|(name, digest)| (name.clone(), *digest)).collect(),
        files: Some(own.written.into_iter().collect()),
    })
}

/// Ends what [`begin`] began: writes the manifest.
///
/// # Errors
/// If it cannot be written.
pub fn finish(out: &mut DiskFolder, manifest: &Manifest) -> Result<(), KindError> {
    out.put(MANIFEST, &pretty_json(manifest)?)
}

/// Stores the items of a folder that was exported, or that another program made alike.
///
/// # Errors
/// If the manifest or a file is missing or not what it should be; if the store cannot be written.
pub fn import_items(ctx: &Context<'_>, from: &DiskFolder) -> Result<Collection, KindError> {
    let manifest: Manifest = parse_json(MANIFEST, &from.need(MANIFEST)?)?;
    let import = |exported: &ExportedItem| {
        let mut own = from.of_item(&exported.item);
        own.listed = exported.files.as_ref().map(|files| files.iter().cloned().collect());
        let artifact = row(&exported.media)
            .and_then(|row| (row.import)(ctx, &own))
            .map_err(|error| in_item(&exported.item, error))?;
        Ok((exported.item.clone(), artifact))
    };
    manifest.items.iter().map(import).collect()
}

/// An error of an item, which it names.
fn in_item(item: &ItemKey, error: KindError) -> KindError {
    match error {
        KindError::Input(message) => KindError::Input(format!("`{item}`: {message}")),
        KindError::Environment(message) => KindError::Environment(format!("`{item}`: {message}")),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Image,
        records::{Exposure, Refined, RefinedImage},
    };
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{FileTree, Files, Media, MemoryBlobs, Silent};

    fn in_folder(test: impl FnOnce(&Context<'_>, &Path)) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        test(&Context::new(&blobs, &Silent, &stop), &folder.path().join("out"));
    }

    fn key(text: &str) -> ItemKey {
        ItemKey::new(text).expect("plain")
    }

    fn collection(ctx: &Context<'_>, rungs: u64) -> Collection {
        let image = |nfe| {
            let said = RefinedImage { method: "mc_noise".into(), from_spp: 1, to_spp: 4, nfe };
            (said, Image::from_data(2, 1, 3, vec![0.1, 1.0, 7.5, 0.0, 2.0, nfe as f32]).expect("fits"))
        };
        let refined = Refined { images: (1..=rungs).map(image).collect(), note: None };
        let exposure = Exposure { factor: 0.3, ev: 0.0, mean_luminance: 0.6 };
        let files = Files(FileTree::from([("maps/a.txt".into(), b"1".to_vec()), ("b".into(), Vec::new())]));
        [
            (key("a"), refined.store(ctx).expect("in memory").into_artifact()),
            (key("method=x/a"), exposure.store(ctx).expect("in memory").into_artifact()),
            // Its folder lies in that of the first.
            (key("a/b"), files.store(ctx).expect("in memory").into_artifact()),
        ]
        .into_iter()
        .collect()
    }

    fn export(ctx: &Context<'_>, of: &Collection, path: &Path) -> Manifest {
        let mut out = DiskFolder::new(path);
        begin(&out).expect("a folder that can be written");
        let items = of.iter().map(|(item, artifact)| export_item(ctx, item, artifact, &out).expect("whole"));
        let manifest = Manifest { node: "n".into(), items: items.collect(), ..Manifest::default() };
        finish(&mut out, &manifest).expect("a folder that can be written");
        manifest
    }

    #[test]
    fn what_is_exported_is_imported() {
        in_folder(|ctx, path| {
            // What an earlier, longer export left there is not read again.
            export(ctx, &collection(ctx, 2), path);
            assert!(path.join("a/mc_noise-1-to-4-nfe-2.exr").is_file());
            let items = collection(ctx, 1);
            let manifest = export(ctx, &items, path);
            assert_eq!(import_items(ctx, &DiskFolder::new(path)).expect("own files"), items);
            let first = &manifest.items[0];
            let files = first.files.as_ref().expect("listed");
            assert!(files.iter().all(|name| path.join(first.item.as_str()).join(name).is_file()), "{files:?}");
            assert_eq!(first.digest, items.get(first.item.as_str()).map(Artifact::digest));
            let all = DiskFolder::new(path).names().expect("listed");
            assert!(all.contains(&"a/b/maps/a.txt".to_owned()) && all.is_sorted(), "{all:?}");
            assert!(all.iter().all(|name| !name.ends_with(".tmp")), "{all:?}");
        });
    }

    #[test]
    fn other_programs_need_no_digests_and_may_change_values() {
        in_folder(|ctx, path| {
            let mut folder = DiskFolder::new(path);
            let manifest = r#"{"items": [{"item": "x", "media": "tauflow/exposure"}]}"#;
            folder.put(MANIFEST, manifest.as_bytes()).expect("a folder that can be written");
            let gone = import_items(ctx, &folder).expect_err("no file of the item").to_string();
            assert!(gone.contains("`x`") && gone.contains("value.json"), "{gone}");
            let value = br#"{"factor": 2.0, "ev": 0.0, "mean_luminance": 0.09}"#;
            folder.put("x/value.json", value).expect("a folder that can be written");
            let items = import_items(ctx, &folder).expect("all is there");
            let exposure = Exposure::load(ctx, items.get("x").expect("there")).expect("whole");
            assert_eq!(exposure.factor, 2.0);
            let unknown = manifest.replace("exposure", "exposition");
            folder.put(MANIFEST, unknown.as_bytes()).expect("a folder that can be written");
            let error = import_items(ctx, &folder).expect_err("no such type").to_string();
            assert!(error.contains("`tauflow/exposition`") && error.contains("tauflow/exposure,"), "{error}");
            let outside = manifest.replace("\"x\"", "\"../x\"");
            folder.put(MANIFEST, outside.as_bytes()).expect("a folder that can be written");
            assert!(import_items(ctx, &folder).is_err(), "a key that leads out of the folder");
        });
    }

    #[test]
    fn a_manifest_stands_for_a_whole_export_alone() {
        in_folder(|ctx, path| {
            let items = collection(ctx, 1);
            export(ctx, &items, path);
            let out = DiskFolder::new(path);
            begin(&out).expect("a folder that can be written");
            let item = key("new");
            let lost = Artifact::blob(Exposure::NAME, Digest::of(b"never stored"));
            assert!(matches!(export_item(ctx, &item, &lost, &out), Err(KindError::MissingBlob(_))));
            assert!(!path.join(MANIFEST).exists());
            let error = import_items(ctx, &out).expect_err("no manifest").to_string();
            assert!(error.contains(MANIFEST), "{error}");
            let alien = Artifact::blob("other/thing", Digest::of(b""));
            assert!(export_item(ctx, &item, &alien, &out).expect_err("unknown").to_string().contains("other/thing"));
        });
    }

    #[test]
    fn no_name_leads_out_of_the_folder() {
        in_folder(|ctx, path| {
            let mut folder = DiskFolder::new(path);
            for name in ["../a", "/a", "a/../../b", "", "a/", "..", "./..", "a\\b", "/tmp/../a", "."] {
                let error = folder.put(name, b"x").expect_err(name).to_string();
                assert!(error.contains(&format!("`{name}`")) && error.contains("out"), "{error}");
                assert!(folder.get(name).is_err(), "{name}");
            }
            // A tree that was stored with such a name writes none of it outside.
            let parts = [("../escaped".to_owned(), ctx.put(b"x").expect("in memory"))];
            let tree = Artifact::tree(Files::NAME, parts);
            assert!(export_item(ctx, &key("item"), &tree, &folder).is_err());
            assert!(!path.join("escaped").exists());
            assert!(folder.get("not-there").expect("a plain name").is_none());
        });
    }

    #[test]
    fn files_are_written_whole_and_leave_nothing_beside_them() {
        in_folder(|_, path| {
            let mut folder = DiskFolder::new(path);
            folder.put("a/b.txt", b"one").expect("a folder that can be written");
            folder.put("a/b.txt", b"two").expect("a file that can be replaced");
            assert_eq!(folder.get("a/b.txt").expect("there").as_deref(), Some(&b"two"[..]));
            // A folder stands where the file should: nothing of it is left.
            fs::create_dir_all(path.join("a/c/d")).expect("made");
            assert!(matches!(folder.put("a/c", b"x"), Err(KindError::Environment(_))));
            fs::write(path.join("a/.b.txt.1.tmp"), b"half").expect("written");
            let found: Vec<_> = fs::read_dir(path.join("a")).expect("listed").map(|e| e.expect("there")).collect();
            assert_eq!(found.len(), 3, "{found:?}");
            assert_eq!(folder.names().expect("listed"), ["a/b.txt"]);
        });
    }

    #[test]
    fn items_that_meet_in_a_file_are_both_named() {
        in_folder(|ctx, path| {
            let files = |name: &str, bytes: &[u8]| {
                let files = Files(FileTree::from([(name.to_owned(), bytes.to_vec())]));
                files.store(ctx).expect("in memory").into_artifact()
            };
            for (first, second) in [("b/x", "x"), ("b", "x"), ("b/x/y", "x")] {
                let out = DiskFolder::new(path);
                export_item(ctx, &key("a"), &files(first, b"1"), &out).expect("nothing is there");
                let error = export_item(ctx, &key("a/b"), &files(second, b"2"), &out).expect_err("they meet");
                let said = error.to_string();
                assert!(said.contains("`a` and `a/b` meet") && said.contains("a/b"), "{said}");
                let kept = fs::read(path.join("a").join(first)).expect("the first stays");
                assert_eq!(kept, b"1");
                // An item may be written again, and so may all in another folder of that name.
                export_item(ctx, &key("a"), &files(first, b"3"), &out).expect("its own");
                fs::remove_dir_all(path).expect("it is ours");
            }
            let mut out = DiskFolder::new(path);
            export_item(ctx, &key(MANIFEST), &files("x", b"1"), &out).expect("nothing is there");
            let said = finish(&mut out, &Manifest::default()).expect_err("it is a folder").to_string();
            assert!(said.contains("the list of all items"), "{said}");
        });
    }

    #[test]
    fn hidden_files_are_no_part_of_a_folder() {
        in_folder(|ctx, path| {
            fs::create_dir_all(path.join(".git")).expect("made");
            for name in ["a", ".DS_Store", ".git/config"] {
                fs::write(path.join(name), name).expect("written");
            }
            let mut folder = DiskFolder::new(path);
            assert_eq!(folder.names().expect("listed"), ["a"]);
            assert!(folder.put(".bashrc", b"x").is_err() && folder.put("a/.git/config", b"x").is_err());
            let parts = [(".bashrc".to_owned(), ctx.put(b"x").expect("in memory"))];
            assert!(export_item(ctx, &key("item"), &Artifact::tree(Files::NAME, parts), &folder).is_err());
        });
    }
}
