//! Foreign files are neither used nor changed.

use crate::{blob, fresh, open, record};
use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
};
use tauflow_cache::{CacheError, Digest, GcOptions, Store};

/// Everything below a folder: what files hold, and where links lead.
fn everything(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).expect("readable") {
        let path = entry.expect("readable").path();
        let meta = fs::symlink_metadata(&path).expect("it is there");
        if meta.is_symlink() {
            found.insert(path.clone(), format!("-> {}", fs::read_link(&path).expect("a link").display()));
        } else if meta.is_dir() {
            found.extend(everything(&path));
            found.insert(path, "folder".into());
        } else if meta.is_file() {
            found.insert(path.clone(), String::from_utf8_lossy(&fs::read(&path).expect("readable")).into_owned());
        } else {
            found.insert(path, "pipe".into());
        }
    }
    found
}

fn gc_all(store: &Store) {
    let options = GcOptions { max_bytes: Some(0), keep_within_secs: Some(0), now: 1 << 40, ..GcOptions::default() };
    store.gc(&options).expect("gc");
}

#[test]
fn a_folder_that_holds_something_else_is_refused_and_left_as_it_is() {
    let owner = "17-0123456789abcdef";
    let strangers = [
        ".bashrc".to_owned(),
        "tmp/letter".to_owned(),
        "trash/letter".to_owned(),
        "quarantine/0000000001-x.pack@12".to_owned(),
        "log/syslog".to_owned(),
        "locks/other".to_owned(),
        "leases/a.lease".to_owned(),
        "pins/mine".to_owned(),
        "CACHEDIR.TAG".to_owned(),
        format!("packs/0000000001-{owner}.pack"),
        format!("blobs/ab/{}", Digest::of(b"x")),
        format!("tmp/{owner}.0/deep"),
    ];
    for name in strangers {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let path = dir.path().join(&name);
        fs::create_dir_all(path.parent().expect("it has one")).expect("writable");
        fs::write(&path, "dear").expect("writable");
        let before = everything(dir.path());
        for opened in [Store::open(dir.path()), Store::open_existing(dir.path())] {
            let error = opened.expect_err(&name);
            assert!(matches!(error, CacheError::Foreign { .. }), "{name}: {error}");
            assert!(error.is_environment() && error.to_string().contains("--cache"), "{error}");
        }
        assert_eq!(everything(dir.path()), before, "{name}");
    }
    // A link is not what it leads to.
    let dir = tempfile::tempdir().expect("a temporary folder");
    let empty = tempfile::tempdir().expect("a temporary folder");
    symlink(empty.path(), dir.path().join("tmp")).expect("writable");
    assert!(matches!(Store::open(dir.path()), Err(CacheError::Foreign { .. })));
    assert!(everything(empty.path()).is_empty());
}

#[test]
fn what_an_unfinished_opening_leaves_is_taken_up() {
    let (dir, store) = fresh();
    drop(store);
    let owner = "17-0123456789abcdef";
    let tag = fs::read(dir.path().join("CACHEDIR.TAG")).expect("it is there");
    let folders = ["blobs", "packs", "log", "leases", "locks", "pins", "quarantine", "tmp", "trash"];
    let files = [format!("tmp/{owner}.0"), format!("leases/{owner}.lease"), "gc.lock".into(), "CACHEDIR.TAG".into()];
    for steps in 0..=folders.len() + files.len() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        fs::create_dir(dir.path().join("lost+found")).expect("writable");
        fs::write(dir.path().join("lost+found/part"), "found").expect("writable");
        for folder in folders.iter().take(steps) {
            fs::create_dir(dir.path().join(folder)).expect("writable");
        }
        for file in files.iter().take(steps.saturating_sub(folders.len())) {
            let bytes = if file == "CACHEDIR.TAG" { &tag[..] } else { b"" };
            fs::write(dir.path().join(file), bytes).expect("writable");
        }
        open(dir.path()).put(b"x").expect("put");
        assert!(open(dir.path()).contains(&Digest::of(b"x")));
        assert_eq!(fs::read(dir.path().join("lost+found/part")).expect("readable"), b"found");
    }
}

#[test]
fn looking_makes_nothing() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let missing = dir.path().join("a/b");
    for folder in [dir.path(), missing.as_path()] {
        let store = Store::open_existing(folder).expect("an empty one");
        assert!(!store.is_made());
        assert_eq!(store.stat().expect("stat"), tauflow_cache::Stat::default());
        assert!(!store.verify(None, 0, &mut |_, _| ()).expect("verify").is_damaged());
        assert_eq!(store.get(&Digest::of(b"x")).expect("get"), None);
        assert!(store.lookup("action", &record(1, "", vec![]).key).is_none());
        let refused = [
            store.put(b"x").map(drop),
            store.record(&record(1, "p", vec![])).map(drop),
            store.gc(&GcOptions::default()).map(drop),
            store.pin("a", &Digest::of(b"x")),
            store.claim(&record(1, "", vec![]).key).map(drop),
        ];
        for result in refused {
            assert!(matches!(result, Err(CacheError::NotMade { .. })), "{result:?}");
        }
        store.set_time(1).expect("nothing to note");
        store.flush().expect("nothing to write");
        drop(store);
        assert!(everything(dir.path()).is_empty());
    }
}

/// Runs in a child: opens a store, and writes to it at once.
#[test]
fn child_that_opens() {
    let Ok(dir) = std::env::var("TAUFLOW_CACHE_OPEN") else { return };
    let id = u64::from(std::process::id());
    for round in 0..40 {
        let store = open(&Path::new(&dir).join(round.to_string()));
        store.put(&blob(id, 3000)).expect("put");
        store.put(&blob(id, 80_000)).expect("put");
        store.record(&record(id, "p", vec![])).expect("record");
    }
}

#[test]
fn many_threads_and_processes_open_a_new_store_at_once() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let test = std::env::current_exe().expect("this program");
    let children: Vec<_> = (0..3)
        .map(|_| {
            let mut command = Command::new(&test);
            command.args(["--exact", "foreign::child_that_opens", "--nocapture"]);
            command.env("TAUFLOW_CACHE_OPEN", dir.path()).stdout(Stdio::null());
            command.spawn().expect("the child starts")
        })
        .collect();
    for round in 0..40 {
        let place = dir.path().join(round.to_string());
        thread::scope(|scope| {
            for n in 0..8_u64 {
                let place = &place;
                scope.spawn(move || {
                    let store = open(place);
                    store.put(&blob(n, 3000)).expect("put");
                    store.record(&record(n, "p", vec![])).expect("record");
                });
            }
        });
    }
    for mut child in children {
        assert!(child.wait().expect("the child ends").success());
    }
    for round in 0..40 {
        assert_eq!(open(&dir.path().join(round.to_string())).stat().expect("stat").blobs, 8 + 3 * 2);
    }
}

#[test]
fn a_collection_leaves_what_is_not_its_own() {
    let (dir, store) = fresh();
    let digest = store.put(&blob(1, 5000)).expect("put");
    let large = store.put(&blob(1, 100_000)).expect("put");
    store.record(&record(1, "p", vec![digest, large])).expect("record");
    drop(store);
    let others = tempfile::tempdir().expect("a temporary folder");
    let owner = "17-0123456789abcdef";
    let own = [
        format!("tmp/{owner}.0"),
        format!("trash/{}", Digest::of(b"y")),
        format!("quarantine/{}", Digest::of(b"y")),
        format!("quarantine/0000000001-{owner}.pack@10"),
        format!("packs/0000000009-{owner}.pack"),
        format!("log/0000000009-{owner}.log"),
        format!("leases/{owner}.lease"),
        format!("blobs/{}/{}", &Digest::of(b"y").hex()[..2], Digest::of(b"y")),
    ];
    // Links by names of the store's own form, and files by other names.
    for (n, name) in own.iter().enumerate() {
        let target = others.path().join(n.to_string());
        fs::write(&target, format!("letter {n}")).expect("writable");
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().expect("it has one")).expect("writable");
        symlink(&target, &path).expect("writable");
    }
    let foreign = [
        "tmp/letter",
        "tmp/17-0123456789abcdef",
        "tmp/a.0",
        "trash/letter",
        "quarantine/letter",
        "quarantine/a@7",
        "packs/0000000001-report.pack",
        "packs/2024-01.pack",
        "log/2024-report.log",
        "leases/car.lease",
        "blobs/letter",
        "blobs/ab/letter",
        "pins/list",
        "letter",
    ];
    for name in foreign {
        fs::create_dir_all(dir.path().join("blobs/ab")).expect("writable");
        fs::write(dir.path().join(name), "dear").expect("writable");
    }
    let folders = ["tmp/17-0123456789abcdef.5", "trash/deep", "quarantine/deep", "packs/deep"];
    folders.iter().for_each(|name| fs::create_dir(dir.path().join(name)).expect("writable"));
    let (inside, outside) = (everything(dir.path()), everything(others.path()));
    let store = open(dir.path());
    assert!(store.get(&digest).expect("get").is_some());
    drop(store);
    let store = open(dir.path());
    gc_all(&store);
    gc_all(&store);
    assert!(!store.contains(&digest) && !store.contains(&large), "its own goes");
    drop(store);
    assert_eq!(everything(others.path()), outside);
    let after = everything(dir.path());
    for name in own.iter().map(String::as_str).chain(foreign).chain(folders) {
        let path = dir.path().join(name);
        assert_eq!(after.get(&path), inside.get(&path), "{name}");
    }
}

#[test]
fn a_link_in_place_of_a_folder_is_refused() {
    for folder in ["blobs", "packs", "log", "leases", "locks", "pins", "quarantine", "tmp", "trash"] {
        let (dir, store) = fresh();
        let others = tempfile::tempdir().expect("a temporary folder");
        fs::write(others.path().join(Digest::of(b"y").to_string()), "y").expect("writable");
        let before = everything(others.path());
        fs::remove_dir_all(dir.path().join(folder)).expect("it was there");
        symlink(others.path(), dir.path().join(folder)).expect("writable");
        for result in [Store::open(dir.path()).map(drop), store.gc(&GcOptions::default()).map(drop)] {
            assert!(matches!(result, Err(CacheError::InTheWay { .. })), "{folder}: {result:?}");
        }
        drop(store);
        assert_eq!(everything(others.path()), before, "{folder}");
    }
}

#[test]
fn a_link_in_place_of_a_folder_of_blobs_is_not_followed() {
    let (dir, store) = fresh();
    let bytes = blob(1, 100_000);
    let digest = Digest::of(&bytes);
    let others = tempfile::tempdir().expect("a temporary folder");
    fs::write(others.path().join(digest.to_string()), &bytes).expect("writable");
    // Another's file of other content, with the name and the length of a blob in the same folder.
    let alike = Digest { hash: [digest.hash[0]; 32], size: 100_000 };
    fs::write(others.path().join(alike.to_string()), blob(2, 100_000)).expect("writable");
    let before = everything(others.path());
    symlink(others.path(), dir.path().join("blobs").join(&digest.hex()[..2])).expect("writable");
    for foreign in [digest, alike] {
        assert!(!store.contains(&foreign));
        assert_eq!(store.get(&foreign).expect("get"), None);
    }
    store.record(&record(7, "p", vec![alike])).expect("record");
    assert!(store.lookup_full("action", &record(7, "p", vec![]).key).is_none());
    assert!(store.verify(None, 0, &mut |_, _| ()).expect("verify").damaged.is_empty());
    assert_eq!(everything(others.path()), before, "nothing is set aside");
    let error = store.put(&blob(1, 100_000)).expect_err("its folder is another's");
    assert!(matches!(error, CacheError::InTheWay { .. }), "{error}");
    store.flush().expect("nothing of it is to be synced");
    gc_all(&store);
    drop(store);
    // Nor is it by a collection that puts back what another had in its trash.
    fs::write(dir.path().join("trash").join(digest.to_string()), b"damaged").expect("writable");
    let store = open(dir.path());
    let error = store.gc(&GcOptions::default()).expect_err("it cannot put it back");
    assert!(matches!(error, CacheError::InTheWay { .. }), "{error}");
    assert_eq!(everything(others.path()), before);
}

#[test]
fn a_folder_that_becomes_a_link_has_nothing_moved_out_of_it() {
    let (dir, store) = fresh();
    let digest = store.put(&blob(1, 100_000)).expect("put");
    assert!(store.get(&digest).expect("get").is_some(), "the folder is known as its own");
    let others = tempfile::tempdir().expect("a temporary folder");
    let target = others.path().join("ab");
    fs::create_dir(&target).expect("writable");
    fs::write(target.join(digest.to_string()), blob(2, 100_000)).expect("writable");
    let before = everything(others.path());
    let folder = dir.path().join("blobs").join(&digest.hex()[..2]);
    fs::remove_dir_all(&folder).expect("it is ours");
    symlink(&target, &folder).expect("writable");
    assert_eq!(store.get(&digest).expect("get"), None);
    assert_eq!(everything(others.path()), before);
    // Nor into one: the folder of what is set aside.
    fs::remove_file(&folder).expect("it is ours");
    fs::create_dir(&folder).expect("writable");
    fs::write(folder.join(digest.to_string()), blob(3, 100_000)).expect("writable");
    fs::remove_dir_all(dir.path().join("quarantine")).expect("it is ours");
    symlink(others.path(), dir.path().join("quarantine")).expect("writable");
    assert_eq!(store.get(&digest).expect("get"), None);
    assert_eq!(everything(others.path()), before);
}

#[test]
fn pipes_are_not_waited_for() {
    let (dir, store) = fresh();
    let owner = "17-0123456789abcdef";
    let digest = Digest::of(&blob(1, 100_000));
    let folder = dir.path().join("blobs").join(&digest.hex()[..2]);
    fs::create_dir(&folder).expect("writable");
    let pipes = [
        folder.join(digest.to_string()),
        dir.path().join(format!("packs/0000000001-{owner}.pack")),
        dir.path().join(format!("log/0000000001-{owner}.log")),
        dir.path().join(format!("leases/{owner}.lease")),
        dir.path().join("pins/list"),
        dir.path().join(format!("quarantine/{digest}")),
    ];
    for pipe in pipes {
        assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo starts").success());
    }
    assert_eq!(store.get(&digest).expect("get"), None);
    drop(store);
    let store = open(dir.path());
    store.stat().expect("stat");
    store.verify(None, 0, &mut |_, _| ()).expect("verify");
    store.pins().expect("pins");
    gc_all(&store);
    store.put(&blob(1, 100_000)).expect("put");
    assert!(store.get(&digest).expect("get").is_some(), "the blob lies where the pipe was");
}
