//! Finds asset files: folders, paths and patterns, relative to the working directory. Knows nothing of what is in them,
//! but for the external files that a `.gltf` names.

use super::{
    gltf::{relative_path, uris},
    refusal::Refusal,
};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    fs,
    io::{self, Read},
    os::unix::fs::MetadataExt,
    path::{Component, Path, PathBuf},
};
use tauflow_contract::{ItemKey, KindError, SourceItem, open_regular, read_regular};

/// Part name of the file itself.
pub const MAIN: &str = "file";

/// Endings of the files that folders are searched for.
const ENDINGS: [&str; 4] = ["hdr", "exr", "glb", "gltf"];

/// Longest key that is made: cells of a matrix need some of the 200 letters that a key may have.
const LONGEST: usize = 180;

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

/// Folders that were seen, however many links lead to them.
#[derive(Default)]
struct Visited(BTreeSet<(u64, u64)>);

impl Visited {
    /// True if this is a folder that was not seen before.
    fn first(&mut self, folder: &fs::Metadata) -> bool {
        self.0.insert((folder.dev(), folder.ino()))
    }
}

/// The files that are wanted in folders and those below, each folder once. Links to folders come last, so that a
/// folder is found by its own name where it has one in here.
///
/// # Errors
/// If a folder cannot be listed.
pub fn search(folders: &[String], wanted: &dyn Fn(&Path) -> bool) -> Result<Vec<PathBuf>, KindError> {
    let (mut found, mut seen) = (Vec::new(), Visited::default());
    let mut own: VecDeque<PathBuf> = folders.iter().map(PathBuf::from).collect();
    let mut links = VecDeque::new();
    while let Some(folder) = own.pop_front().or_else(|| links.pop_front()) {
        if !seen.first(&fs::metadata(&folder).map_err(|e| failed(&folder, &e))?) {
            continue;
        }
        for path in entries(&folder)? {
            if path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.')) {
                continue;
            }
            if path.is_dir() {
                if path.is_symlink() { links.push_back(path) } else { own.push_back(path) }
            } else if wanted(&path) {
                found.push(path);
            }
        }
    }
    Ok(found)
}

/// True if `name` fits a pattern of `*` (any letters) and `?` (any letter).
///
/// Where a letter does not fit, the last `*` takes one more: earlier ones need not be tried again.
fn fits(pattern: &[char], name: &[char]) -> bool {
    let (mut p, mut n) = (0, 0);
    // What follows the last `*`, and the letters up to the end of what it takes.
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        match (pattern.get(p), star) {
            (Some('*'), _) => {
                p += 1;
                star = Some((p, n));
            }
            (Some(letter), _) if *letter == '?' || *letter == name[n] => {
                p += 1;
                n += 1;
            }
            (_, Some((after, taken))) => {
                (p, n) = (after, taken + 1);
                star = Some((after, n));
            }
            (_, None) => return false,
        }
    }
    pattern[p..].iter().all(|letter| *letter == '*')
}

/// `paths` with each folder once: by its own name where it has one, not by that of a link.
fn each_once(paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let (links, own): (Vec<PathBuf>, Vec<PathBuf>) = paths.into_iter().partition(|path| path.is_symlink());
    let mut seen = Visited::default();
    let first = |path: &PathBuf| fs::metadata(path).map_or(true, |m| !m.is_dir() || seen.first(&m));
    own.into_iter().chain(links).filter(first).collect()
}

/// Every path that fits a pattern, part by part.
///
/// # Errors
/// If a folder cannot be listed.
pub fn expand(pattern: &str) -> Result<Vec<PathBuf>, KindError> {
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
        paths = each_once(next);
    }
    Ok(paths)
}

/// `text` with every letter that a key cannot hold replaced by `_`.
pub fn ascii(text: &str) -> String {
    let plain: String = text
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-' | '=' | '+') { c } else { '_' })
        .collect();
    let plain = if plain.len() > 160 { plain[plain.len() - 160..].to_owned() } else { plain };
    if plain.is_empty() || plain.starts_with('.') { format!("_{plain}") } else { plain }
}

/// Whether a path leads to something that is no regular file, or to nothing. Files that cannot be inspected are not
/// refused here: reading them will report the reason.
fn is_refused(path: &Path) -> bool {
    match fs::metadata(path) {
        Ok(metadata) => !metadata.is_file(),
        Err(error) => error.kind() != io::ErrorKind::PermissionDenied,
    }
}

/// Why an item without files is refused. Nothing else of it is known to its action, so it is always the same.
pub fn refusal() -> Refusal {
    Refusal::new(
        "file",
        "no regular file, but a link that leads nowhere, a FIFO, a socket or a device",
        "put a file in its place, or take it away",
    )
}

/// Most bytes of JSON that are looked through for names of files.
const MOST_JSON: u64 = 1 << 28;

/// The JSON of a file: of a GLB no more than its header and its first chunk, as a GLB of that chunk alone.
fn read_head(path: &Path) -> io::Result<Vec<u8>> {
    let mut head = Vec::new();
    open_regular(path)?.take(20).read_to_end(&mut head)?;
    let word = |at: usize| head.get(at..at + 4).and_then(|four| Some(u32::from_le_bytes(four.try_into().ok()?)));
    let (true, Some(size)) = (head.starts_with(b"glTF"), word(12)) else { return read_regular(path, MOST_JSON) };
    let len = 20 + u64::from(size);
    if len > MOST_JSON {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    let mut bytes = Vec::new();
    open_regular(path)?.take(len).read_to_end(&mut bytes)?;
    if let Some(length) = bytes.get_mut(8..12) {
        length.copy_from_slice(&(len as u32).to_le_bytes()); // below MOST_JSON
    }
    Ok(bytes)
}

/// The external files that a file names and that are there; none if it cannot be read, which its import will tell.
fn externals(path: &Path) -> Vec<(String, PathBuf)> {
    let ending = ending(&path.to_string_lossy());
    if ending != "gltf" && ending != "glb" {
        return Vec::new();
    }
    let Ok(bytes) = read_head(path) else { return Vec::new() };
    let folder = path.parent().unwrap_or(Path::new(""));
    let named = uris(&bytes).into_iter().enumerate();
    let mut seen = BTreeSet::new();
    let there = named.filter_map(|(number, uri)| {
        // A file that has several spellings is read once.
        let path = relative_path(&uri).filter(|path| seen.insert(path.clone()))?;
        let file = folder.join(path);
        file.is_file().then(|| (external(number), file))
    });
    there.collect()
}

/// The items of the files that `folders` hold and `patterns` fit. A file that is not regular is an item without files.
///
/// # Errors
/// If a folder or file is not there, or none is found.
pub fn items(folders: &[String], patterns: &[String]) -> Result<Vec<SourceItem>, KindError> {
    if let Some(folder) = folders.iter().find(|folder| !Path::new(folder).is_dir()) {
        return Err(KindError::Input(format!(
            "assets: `{folder}` is no folder here; name one, e.g. --set 'assets.folders=[path/to/assets]'"
        )));
    }
    let mut found = search(folders, &|path| ENDINGS.contains(&ending(&path.to_string_lossy()).as_str()))?;
    for pattern in patterns {
        let there = |path: &PathBuf| path.symlink_metadata().is_ok() && !path.is_dir();
        let paths: Vec<PathBuf> = expand(pattern)?.into_iter().filter(there).collect();
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
    let item = |(key, path): (ItemKey, PathBuf)| {
        let mut files = Vec::new();
        if !is_refused(&path) {
            files.extend(externals(&path));
            files.insert(0, (MAIN.to_owned(), path));
        }
        SourceItem { key, files }
    };
    Ok(named(found)?.into_iter().map(item).collect())
}

/// A key for each path: its file name; that with its folder's before it where several have it; then numbered. A name
/// that one file alone has is its key, whatever the others are called.
fn named(paths: Vec<PathBuf>) -> Result<Vec<(ItemKey, PathBuf)>, KindError> {
    let text =
        |part: Option<&std::ffi::OsStr>| ascii(&part.map_or(String::new(), |p| p.to_string_lossy().into_owned()));
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    paths.iter().for_each(|p| *counts.entry(text(p.file_name())).or_default() += 1);
    let mut taken: BTreeSet<String> = counts.iter().filter(|(_, n)| **n == 1).map(|(name, _)| name.clone()).collect();
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    let mut out = Vec::with_capacity(paths.len());
    for path in paths {
        let mut name = text(path.file_name());
        if counts.get(&name).is_some_and(|n| *n > 1) {
            let long = format!("{}-{name}", text(path.parent().and_then(Path::file_name)));
            // No key begins with a dot.
            let long = long[long.len().saturating_sub(LONGEST)..].trim_start_matches('.');
            let number = numbers.entry(long.to_owned()).or_default();
            name = loop {
                *number += 1;
                let name = if *number > 1 { format!("{number}-{long}") } else { long.to_owned() };
                if taken.insert(name.clone()) {
                    break name;
                }
            };
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
    fn names_that_meet_are_told_apart() {
        let keys = |paths: &[&str]| -> Vec<String> {
            let named = named(paths.iter().map(PathBuf::from).collect()).expect("keys for all");
            named.into_iter().map(|(key, _)| key.to_string()).collect()
        };
        // A file that is called as another would be keeps its name.
        assert_eq!(keys(&["2-b-x.hdr", "b/x.hdr", "c/b/x.hdr"]), ["2-b-x.hdr", "b-x.hdr", "3-b-x.hdr"]);
        assert_eq!(keys(&["a-x.hdr", "a/x.hdr", "b/x.hdr"]), ["a-x.hdr", "2-a-x.hdr", "b-x.hdr"]);
        // Names of names: each of them would be called as the next.
        let paths = ["2-b-x.hdr", "a/2-b-x.hdr", "b/x.hdr", "c/b/x.hdr", "d/b/x.hdr"];
        let found = keys(&paths);
        assert_eq!(found.iter().collect::<BTreeSet<_>>().len(), paths.len(), "{found:?}");
        let long = "x".repeat(300);
        let paths = [format!("{long}a/{long}.hdr"), format!("{long}b/{long}.hdr"), format!("{long}b/y{long}.hdr")];
        let found = keys(&[&paths[0], &paths[1], &paths[2]]);
        assert_eq!(found.iter().collect::<BTreeSet<_>>().len(), 3, "{found:?}");
    }

    #[test]
    fn patterns_of_many_stars_are_quick() {
        let letters = |text: &str| text.chars().collect::<Vec<_>>();
        let pattern = letters(&"*a".repeat(30));
        assert!(!fits(&pattern, &letters(&format!("{}b", "a".repeat(200)))));
        assert!(fits(&pattern, &letters(&"a".repeat(200))));
    }

    #[test]
    fn missing_folders_and_files_say_what_to_do() {
        for error in [items(&["no-such-folder".into()], &[]), items(&[], &["no-such-*.glb".into()]), items(&[], &[])] {
            let text = error.expect_err("nothing there").to_string();
            assert!(text.starts_with("assets: ") && text.contains(';'), "{text}");
        }
    }
}
