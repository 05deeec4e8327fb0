//! Finds asset files: folders, paths and patterns, relative to the working directory. Knows nothing of what is in them,
//! but for the external files that a `.gltf` names.

use super::gltf::{relative_path, uris};
use std::{
    collections::BTreeMap,
    fs, io,
    path::{Component, Path, PathBuf},
};
use tauflow_contract::{ItemKey, KindError, SourceItem};

/// Part name of the file itself.
pub const MAIN: &str = "file";

/// Endings of the files that folders are searched for.
const ENDINGS: [&str; 4] = ["hdr", "exr", "glb", "gltf"];

/// Deepest folder below one that is named.
const DEEPEST: usize = 16;

/// Part name of the `number`-th external file.
pub fn external(number: usize) -> String {
    format!("external/{number:04}")
}

/// The lower-case ending of a name, without the dot.
pub fn ending(name: &str) -> String {
    name.rsplit_once('.').map_or(String::new(), |(_, ending)| ending.to_ascii_lowercase())
}

fn failed(path: &Path, error: &io::Error) -> KindError {
    KindError::Environment(format!("cannot list `{}`: {error}; mend the path or its permissions", path.display()))
}

/// Entries of a folder, in order of name.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, KindError> {
    let mut out = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| failed(folder, &e))? {
        out.push(entry.map_err(|e| failed(folder, &e))?.path());
    }
    out.sort();
    Ok(out)
}

fn search(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), KindError> {
    if depth > DEEPEST {
        return Ok(());
    }
    for path in entries(folder)? {
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if hidden {
            continue;
        }
        if path.is_dir() {
            search(&path, depth + 1, found)?;
        } else if ENDINGS.contains(&ending(&path.to_string_lossy()).as_str()) {
            found.push(path);
        }
    }
    Ok(())
}

/// True if `name` fits a pattern of `*` (any letters) and `?` (any letter).
fn fits(pattern: &[char], name: &[char]) -> bool {
    match (pattern.first(), name.first()) {
        (None, None) => true,
        (Some('*'), _) => fits(&pattern[1..], name) || (!name.is_empty() && fits(pattern, &name[1..])),
        (Some('?'), Some(_)) => fits(&pattern[1..], &name[1..]),
        (Some(p), Some(n)) => p == n && fits(&pattern[1..], &name[1..]),
        _ => false,
    }
}

/// Every path that fits a pattern, part by part.
fn expand(pattern: &str) -> Result<Vec<PathBuf>, KindError> {
    let mut paths = vec![PathBuf::new()];
    for part in Path::new(pattern).components() {
        let text = part.as_os_str().to_string_lossy().into_owned();
        let mut next = Vec::new();
        for path in paths {
            if !matches!(part, Component::Normal(_)) || !text.contains(['*', '?']) {
                next.push(path.join(&text));
                continue;
            }
            let folder = if path.as_os_str().is_empty() { Path::new(".") } else { &path };
            if !folder.is_dir() {
                continue;
            }
            let letters: Vec<char> = text.chars().collect();
            for entry in entries(folder)? {
                let Some(name) = entry.file_name().map(|n| n.to_string_lossy().into_owned()) else { continue };
                if fits(&letters, &name.chars().collect::<Vec<_>>()) {
                    next.push(path.join(name));
                }
            }
        }
        paths = next;
    }
    Ok(paths)
}

/// `text` with every letter that a key cannot hold replaced by `_`.
fn ascii(text: &str) -> String {
    let plain: String = text
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '=' | '+') { c } else { '_' })
        .collect();
    let plain = if plain.len() > 160 { plain[plain.len() - 160..].to_owned() } else { plain };
    if plain.trim_matches('.').is_empty() { format!("_{plain}") } else { plain }
}

/// The external files that a file names and that are there.
fn externals(path: &Path) -> Result<Vec<(String, PathBuf)>, KindError> {
    let ending = ending(&path.to_string_lossy());
    if ending != "gltf" && ending != "glb" {
        return Ok(Vec::new());
    }
    let bytes = fs::read(path).map_err(|e| {
        KindError::Environment(format!("cannot read `{}`: {e}; mend it or take it away", path.display()))
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let named = uris(&bytes).into_iter().enumerate();
    let there = named.filter_map(|(number, uri)| {
        let file = folder.join(relative_path(&uri)?);
        file.is_file().then(|| (external(number), file))
    });
    Ok(there.collect())
}

/// The items of the files that `folders` hold and `patterns` fit.
///
/// # Errors
/// If a folder or file is not there, or none is found.
pub fn items(folders: &[String], patterns: &[String]) -> Result<Vec<SourceItem>, KindError> {
    let mut found = Vec::new();
    for folder in folders {
        if !Path::new(folder).is_dir() {
            return Err(KindError::Input(format!(
                "assets: `{folder}` is no folder here; name one, e.g. --set 'assets.folders=[path/to/assets]'"
            )));
        }
        search(Path::new(folder), 0, &mut found)?;
    }
    for pattern in patterns {
        let paths: Vec<PathBuf> = expand(pattern)?.into_iter().filter(|p| p.is_file()).collect();
        if paths.is_empty() {
            return Err(KindError::Input(format!("assets: no file fits `{pattern}`; mend the path")));
        }
        found.extend(paths);
    }
    found.sort();
    found.dedup();
    if found.is_empty() {
        return Err(KindError::Input(format!(
            "assets: no .hdr, .exr, .glb or .gltf file in `{}`; name folders or files that hold some",
            folders.join("`, `")
        )));
    }
    named(found)?
        .into_iter()
        .map(|(key, path)| {
            let mut files = vec![(MAIN.to_owned(), path.clone())];
            files.extend(externals(&path)?);
            Ok(SourceItem { key, files })
        })
        .collect()
}

/// A key for each path: its file name; that with its folder's before it where two are the same; then numbered.
fn named(paths: Vec<PathBuf>) -> Result<Vec<(ItemKey, PathBuf)>, KindError> {
    let text =
        |part: Option<&std::ffi::OsStr>| ascii(&part.map_or(String::new(), |p| p.to_string_lossy().into_owned()));
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    paths.iter().for_each(|p| *counts.entry(text(p.file_name())).or_default() += 1);
    let mut taken: BTreeMap<String, usize> = BTreeMap::new();
    let mut out = Vec::with_capacity(paths.len());
    for path in paths {
        let mut name = text(path.file_name());
        if counts.get(&name).is_some_and(|n| *n > 1) {
            name = format!("{}-{name}", text(path.parent().and_then(Path::file_name)));
        }
        let number = taken.entry(name.clone()).or_default();
        *number += 1;
        if *number > 1 {
            name = format!("{}-{name}", *number);
        }
        let key = ItemKey::new(name).map_err(|e| KindError::Input(format!("assets: `{}`: {e}", path.display())))?;
        out.push((key, path));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_and_names() {
        let fit = |p: &str, n: &str| fits(&p.chars().collect::<Vec<_>>(), &n.chars().collect::<Vec<_>>());
        assert!(fit("*.glb", "a.glb") && fit("a?c*", "abcd") && fit("*", "") && fit("**b", "aab"));
        assert!(!fit("*.glb", "a.gltf") && !fit("?", ""));
        assert_eq!(ascii("Kürbis 1.glb"), "K_rbis_1.glb");
        let paths = ["a/x.glb", "b/x.glb", "b/y.glb", "c/b/x.glb"].map(PathBuf::from).to_vec();
        let keys: Vec<String> = named(paths).expect("fine").into_iter().map(|(k, _)| k.to_string()).collect();
        assert_eq!(keys, ["a-x.glb", "b-x.glb", "y.glb", "2-b-x.glb"]);
    }

    #[test]
    fn missing_folders_and_files_say_what_to_do() {
        for error in [items(&["no-such-folder".into()], &[]), items(&[], &["no-such-*.glb".into()]), items(&[], &[])] {
            let text = error.expect_err("nothing there").to_string();
            assert!(text.starts_with("assets: ") && text.contains(';'), "{text}");
        }
    }
}
