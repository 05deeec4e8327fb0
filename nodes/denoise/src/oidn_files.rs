//! Which file is the library of Open Image Denoise, and what is in it and in those that it loads. Nothing is loaded
//! here: keys hold digests of files, so that who looks at a pipeline runs no code of a library.

use crate::command::contents;
use serde_json::{Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// Names that systems have for it.
const NAMES: [&str; 3] = ["libOpenImageDenoise.so.2", "libOpenImageDenoise.so", "libOpenImageDenoise.2.dylib"];
/// Variable that names the library.
pub(crate) const VARIABLE: &str = "TAUFLOW_OIDN";
/// Libraries that it loads from its own folder; the names are followed by versions.
const BESIDE: [&str; 3] = ["libOpenImageDenoise_core", "libOpenImageDenoise_device_cpu", "libtbb"];
/// Where systems have libraries, beside the folders that they list.
const FOLDERS: [&str; 6] = ["/usr/local/lib", "/lib", "/usr/lib", "/lib64", "/usr/lib64", "/opt/homebrew/lib"];
/// Lists of folders that are read, of those that include each other.
const MOST_LISTS: usize = 256;

/// The configured name: from the params, or from the variable.
pub(crate) fn named(by_params: Option<&str>) -> Option<String> {
    by_params.map(str::to_owned).or_else(|| std::env::var(VARIABLE).ok().filter(|name| !name.is_empty()))
}

/// The library's file, of a path or a name; of none, the system's. Links are followed, because the library loads what
/// lies beside its file.
pub(crate) fn locate(named: Option<&str>) -> Option<PathBuf> {
    let file = match named {
        Some(path) if path.contains('/') => Some(PathBuf::from(path)).filter(|file| file.is_file()),
        Some(name) => search(&[name]),
        None => search(&NAMES),
    };
    fs::canonicalize(file?).ok()
}

/// The first file of one of these names, in the folders of the system.
fn search(names: &[&str]) -> Option<PathBuf> {
    let folders = folders();
    names.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name))).find(|file| file.is_file())
}

/// The folders in which the system looks for libraries, in its order.
fn folders() -> Vec<PathBuf> {
    let by_variable =
        |name: &str| std::env::var_os(name).map(|paths| std::env::split_paths(&paths).collect::<Vec<_>>());
    let mut folders: Vec<PathBuf> =
        ["LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"].into_iter().filter_map(by_variable).flatten().collect();
    folders.retain(|folder| folder.is_absolute());
    folders.extend(listed(Path::new("/etc/ld.so.conf")));
    folders.extend(FOLDERS.map(PathBuf::from));
    folders
}

/// The folders that a file lists, and those that it includes do.
fn listed(list: &Path) -> Vec<PathBuf> {
    let (mut folders, mut lists) = (Vec::new(), vec![list.to_owned()]);
    let mut at = 0;
    while at < lists.len().min(MOST_LISTS) {
        let text = fs::read_to_string(&lists[at]).unwrap_or_default();
        for line in text.lines().map(|line| line.split('#').next().unwrap_or_default().trim()) {
            match line.strip_prefix("include ").map(str::trim) {
                Some(pattern) => {
                    let new: Vec<PathBuf> =
                        included(pattern).into_iter().filter(|list| !lists.contains(list)).collect();
                    lists.extend(new);
                }
                None if line.starts_with('/') => folders.push(line.into()),
                None => {}
            }
        }
        at += 1;
    }
    folders
}

/// The files of a pattern such as `/etc/ld.so.conf.d/*.conf`, sorted.
fn included(pattern: &str) -> Vec<PathBuf> {
    let path = Path::new(pattern);
    let (Some(folder), Some(name)) = (path.parent(), path.file_name().and_then(|name| name.to_str())) else {
        return Vec::new();
    };
    let Some((start, end)) = name.split_once('*') else { return vec![path.to_owned()] };
    let fits = |name: &str| name.len() >= start.len() + end.len() && name.starts_with(start) && name.ends_with(end);
    let mut found = names(folder);
    found.retain(|name| fits(name));
    found.into_iter().map(|name| folder.join(name)).collect()
}

/// Names of what is in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let mut names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    names
}

/// The digests of the files that determine the library's results: its own file, and those in its folder that it loads.
///
/// A package may have one file under several names, as links or copies, so that digests stand for each name once.
pub(crate) fn identity(by_params: Option<&str>) -> Value {
    let named = named(by_params);
    let Some(file) = locate(named.as_deref()) else {
        // One that is named and is not there is an error of whoever uses it, never the same as none at all.
        return named.map_or(json!("none found"), |name| json!({ "not there": name }));
    };
    let mut found: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
    found.entry("libOpenImageDenoise").or_default().insert(contents(&file));
    if let Some(folder) = file.parent() {
        for name in names(folder) {
            let of = BESIDE.into_iter().find(|of| name.strip_prefix(of).is_some_and(|rest| rest.starts_with('.')));
            let beside = folder.join(&name);
            if let Some(of) = of
                && beside.is_file()
            {
                found.entry(of).or_default().insert(contents(&beside));
            }
        }
    }
    json!(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(folder: &Path) -> Value {
        identity(Some(&folder.join("libOpenImageDenoise.so").to_string_lossy()))
    }

    #[test]
    fn every_file_that_the_library_loads_decides_its_identity_and_no_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("writable");
        let missing = of(folder.path());
        let path = folder.path().join("libOpenImageDenoise.so");
        assert_eq!(missing, json!({ "not there": path.to_string_lossy() }), "{missing}");
        // Nothing of this can be loaded, so nothing is.
        write("libOpenImageDenoise.so", "no library");
        let alone = of(folder.path());
        assert_eq!(alone["libOpenImageDenoise"].as_array().map(Vec::len), Some(1), "{alone}");
        assert_ne!(alone, json!("none found"));
        let mut before = alone;
        for name in ["libOpenImageDenoise_core.so.2.5.1", "libOpenImageDenoise_device_cpu.so.2.5.1", "libtbb.so.12"] {
            for text in ["one", "two"] {
                write(name, text);
                let now = of(folder.path());
                assert_ne!(now, before, "{name} {text}");
                before = now;
            }
        }
        // The same under another name is the same library; other devices are never loaded.
        write("libtbb.so", "two");
        write("libOpenImageDenoise_device_cuda.so.2.5.1", "another device");
        write("libtbbmalloc.so", "another library");
        assert_eq!(of(folder.path()), before);
        write("libOpenImageDenoise.so", "another");
        assert_ne!(of(folder.path()), before);
    }

    #[test]
    fn a_link_is_the_file_that_it_leads_to() {
        let folder = tempfile::tempdir().expect("a folder");
        let real = folder.path().join("real");
        fs::create_dir(&real).expect("writable");
        for name in ["libOpenImageDenoise.so.2.5.1", "libtbb.so.12"] {
            fs::write(real.join(name), name).expect("writable");
        }
        let link = folder.path().join("libOpenImageDenoise.so");
        std::os::unix::fs::symlink(real.join("libOpenImageDenoise.so.2.5.1"), link).expect("writable");
        assert_eq!(of(folder.path())["libtbb"].as_array().map(Vec::len), Some(1));
    }

    #[test]
    fn folders_of_libraries_are_read_from_lists() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: String| fs::write(folder.path().join(name), text).expect("writable");
        let list = folder.path().join("ld.so.conf");
        // One that includes itself is read once.
        write("ld.so.conf", format!("/a/lib # here\n\ninclude {}/*.conf\n", folder.path().display()));
        write("b.conf", "/b/lib\nrelative\n".into());
        write("c.list", "/c/lib\n".into());
        let found = listed(&list);
        assert!(found.contains(&"/a/lib".into()) && found.contains(&"/b/lib".into()), "{found:?}");
        assert!(!found.contains(&"/c/lib".into()) && found.len() == 2, "{found:?}");
        assert!(folders().contains(&"/usr/lib".into()));
        assert_eq!(locate(Some("libNoSuchLibraryAnywhere.so")), None);
    }
}
