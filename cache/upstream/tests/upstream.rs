//! Pushes, pulls, and everything that can be wrong with an upstream.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, Mutex},
    thread,
};
use tauflow_cache::{Digest, Key, Record, Store, tree};
use tauflow_upstream::{
    Address, Pulled, Pushed, Reader, SecretKey, Sender, Upstream, UpstreamError, Wanted, all, pull, push,
};
use tempfile::TempDir;

const ALL: Wanted<'_> = Wanted { namespaces: &["action"], sound: &|record| record.preimage != "forged" };

fn anything(_: &Record) -> bool {
    true
}

struct Lab {
    folder: TempDir,
}

impl Lab {
    fn new() -> Self {
        Self { folder: TempDir::new().expect("a temporary folder") }
    }

    fn store(&self, name: &str) -> Store {
        Store::open(&self.folder.path().join(name)).expect("writable")
    }

    fn dir(&self) -> PathBuf {
        self.folder.path().join("shared")
    }

    fn address(&self) -> Address {
        Address::Folder(self.dir())
    }

    fn push(&self, store: &Store) -> Pushed {
        let upstream = Upstream::create(&self.address()).expect("writable");
        push(store, &upstream, &all(store, &["action"]), &anything, false, &mut |_, _| {}).expect("writable")
    }

    fn pull(&self, store: &Store) -> Pulled {
        let upstream = Upstream::open(&self.address()).expect("it is there");
        pull(store, &upstream, ALL, &mut |_, _| {}).expect("writable")
    }

    /// A store that looks in the upstream for what it lacks, and the notes of that.
    fn reading(&self, name: &str) -> (Store, Arc<Mutex<Vec<String>>>) {
        let (notes, dir) = (Arc::<Mutex<Vec<String>>>::default(), self.address());
        let told = notes.clone();
        let tell = move |note: &str| told.lock().expect("no test panics with it").push(note.to_owned());
        let opening = move || Upstream::open(&dir);
        let mut store = self.store(name);
        let sound = |record: &Record| record.preimage != "forged";
        store.look_beyond(Arc::new(Reader::new(Box::new(opening), &["action"], sound, Box::new(tell))));
        (store, notes)
    }

    fn files(&self, extension: &str) -> Vec<PathBuf> {
        let entries = fs::read_dir(self.dir().join("packs")).expect("readable");
        let mut found: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
        found.retain(|path| path.extension().is_some_and(|e| e == extension));
        found.sort();
        found
    }
}

/// A record with a blob of its own, and a tree that lists another.
fn add(store: &Store, name: &str) -> Record {
    let put = |bytes: &[u8]| store.put(bytes).expect("writable");
    let (blob, leaf) = (put(format!("blob of {name}").as_bytes()), put(format!("leaf of {name}").as_bytes()));
    let listing = put(&tree::encode(&[leaf], &[], b""));
    let record = Record {
        namespace: "action".into(),
        key: Key::of(name.as_bytes()),
        label: "kind".into(),
        preimage: String::new(),
        payload: blob.to_string(),
        recipe: String::new(),
        derived: false,
        transient: false,
        refs: vec![blob],
        trees: vec![listing],
        wall_us: 5,
        bytes: 6,
        when: 7,
        maker: "a, tauflow 1".into(),
        fetched: false,
    };
    store.record(&record).expect("writable");
    record
}

fn change(path: &Path, with: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).expect("readable");
    with(&mut bytes);
    fs::write(path, bytes).expect("writable");
}

#[test]
fn a_sender_sends_the_blobs_that_a_known_record_lacks_there() {
    let lab = Lab::new();
    let (a, b) = (lab.store("a"), lab.store("b"));
    let record = Record { transient: true, ..add(&b, "x") };
    b.replace(&record).expect("writable");
    // The first machine had the blobs in memory alone.
    a.record(&record).expect("writable");
    assert_eq!((lab.push(&a).records, lab.push(&a).blobs), (1, 0));
    let sender = Sender::new(Upstream::create(&lab.address()).expect("writable"));
    for _ in 0..2 {
        sender.send(&b, &[], &[("action", record.key)]).expect("writable");
        assert_eq!(lab.files("pack").len(), 1, "once is enough");
    }
    let c = lab.store("c");
    assert_eq!(lab.pull(&c).records, 1);
    for digest in c.reach(&record.refs, &record.trees).expect("readable") {
        assert!(c.get(&digest).expect("readable").is_some(), "{digest}");
    }
}

#[test]
fn what_one_machine_pushes_another_pulls_and_few_files_hold_it() {
    let lab = Lab::new();
    let (a, b) = (lab.store("a"), lab.store("b"));
    let records: Vec<Record> = (0..500).map(|n| add(&a, &n.to_string())).collect();
    let pushed = lab.push(&a);
    assert_eq!((pushed.records, pushed.blobs, pushed.same, pushed.incomplete), (500, 1500, 0, 0));
    assert_eq!((lab.files("pack").len(), lab.files("index").len()), (1, 1));
    let pulled = lab.pull(&b);
    assert_eq!((pulled.records, pulled.blobs, pulled.bytes), (500, 1500, pushed.bytes));
    assert_eq!(pulled.notes, [""; 0]);
    for record in &records {
        let pulled = Record { fetched: true, ..record.clone() };
        assert_eq!(b.lookup_full("action", &record.key).as_deref(), Some(&pulled));
        assert!(b.reach(&record.refs, &record.trees).expect("readable").iter().all(|blob| b.contains(blob)));
    }
    // Nothing is copied twice.
    let again = lab.push(&b);
    assert_eq!((again.records, again.blobs, again.same), (0, 0, 500));
    assert_eq!(lab.files("index").len(), 1);
    let again = lab.pull(&b);
    assert_eq!((again.records, again.blobs, again.same), (0, 0, 500));
}

#[test]
fn a_dry_run_counts_and_writes_nothing() {
    let lab = Lab::new();
    let a = lab.store("a");
    add(&a, "x");
    let upstream = Upstream::create(&lab.address()).expect("writable");
    let dry = push(&a, &upstream, &all(&a, &["action"]), &anything, true, &mut |_, _| {}).expect("readable");
    assert_eq!((dry.records, dry.blobs), (1, 3));
    assert_eq!((lab.files("pack").len(), lab.files("index").len()), (0, 0));
    assert_eq!(lab.push(&a), dry);
}

#[test]
fn machines_push_at_once() {
    let lab = Lab::new();
    let stores: Vec<Store> = (0..4).map(|n| lab.store(&format!("s{n}"))).collect();
    for (n, store) in stores.iter().enumerate() {
        add(store, "common");
        (0..50).for_each(|k| drop(add(store, &format!("{n}-{k}"))));
    }
    thread::scope(|scope| stores.iter().for_each(|store| drop(scope.spawn(|| lab.push(store)))));
    let all = lab.store("all");
    let pulled = lab.pull(&all);
    assert_eq!((pulled.records, pulled.notes.len(), pulled.conflicts), (201, 0, 0));
    assert_eq!(fs::read_dir(lab.dir().join("tmp")).expect("readable").count(), 0);
}

#[test]
fn a_damaged_blob_is_a_miss_that_names_its_pack_and_takes_only_its_record_along() {
    let lab = Lab::new();
    let (a, b) = (lab.store("a"), lab.store("b"));
    add(&a, "x");
    add(&a, "y");
    lab.push(&a);
    let pack = &lab.files("pack")[0];
    change(pack, |bytes| bytes[0] ^= 1);
    let pulled = lab.pull(&b);
    assert_eq!((pulled.records, pulled.incomplete, pulled.notes.len()), (1, 1, 1), "{pulled:?}");
    assert!(pulled.notes[0].contains(&pack.display().to_string()) && pulled.notes[0].contains("is damaged"));
    // A sound copy from another machine heals that, once the damaged index is gone.
    fs::remove_file(&lab.files("index")[0]).expect("writable");
    change(pack, |bytes| bytes[0] ^= 1);
    lab.push(&a);
    assert_eq!(lab.pull(&b).records, 1);
}

#[test]
fn a_truncated_a_missing_and_a_strange_pack_and_a_truncated_index_are_notes() {
    for damage in 0..4 {
        let lab = Lab::new();
        let (a, b) = (lab.store("a"), lab.store("b"));
        let record = add(&a, "x");
        lab.push(&a);
        let (pack, index) = (lab.files("pack")[0].clone(), lab.files("index")[0].clone());
        // What a pull says, which looks at the sizes of packs first, and what is said by a store that reads the blob.
        let (listed, read) = match damage {
            0 => {
                change(&pack, |bytes| bytes.truncate(3));
                ("is missing or truncated", "is truncated")
            }
            1 => {
                fs::remove_file(&pack).expect("writable");
                ("is missing or truncated", "cannot be read")
            }
            2 => {
                // A pipe that nobody writes to would keep a reader waiting.
                fs::remove_file(&pack).expect("writable");
                let made = Command::new("mkfifo").arg(&pack).status().expect("coreutils");
                assert!(made.success());
                ("is missing or truncated", "is not a regular file")
            }
            _ => {
                change(&index, |bytes| bytes.truncate(bytes.len() - 9));
                ("is damaged or truncated", "is damaged or truncated")
            }
        };
        let pulled = lab.pull(&b);
        assert_eq!((pulled.records, pulled.blobs), (0, 0));
        assert!(pulled.notes.iter().any(|note| note.contains(listed)), "{pulled:?}");
        assert!(b.lookup("action", &Key::of(b"x")).is_none());
        let (c, told) = lab.reading("c");
        assert_eq!(c.get(&record.refs[0]).expect("readable"), None);
        let told = notes(&told);
        assert!(told.iter().any(|note| note.contains(read)), "{told:?}");
    }
}

#[test]
fn an_index_that_lies_about_places_is_met_with_notes() {
    let lab = Lab::new();
    let (a, b) = (lab.store("a"), lab.store("b"));
    add(&a, "x");
    lab.push(&a);
    let index = lab.files("index")[0].clone();
    let text = fs::read_to_string(&index).expect("readable");
    for (from, to) in [("\"}\n", "\"}\n{\"weird\":1}\n"), (",0]", &format!(",{}]", u64::MAX)), ("{", "")] {
        assert!(text.contains(from), "{from} in {text}");
        let lie = text.replacen(from, to, 1);
        fs::remove_file(lab.files("index").pop().expect("one is there")).expect("writable");
        let name = format!("{}.index", Digest::of(lie.as_bytes()));
        fs::write(lab.dir().join("packs").join(name), lie).expect("writable");
        let pulled = lab.pull(&b);
        assert_eq!(pulled.records, 0, "{to}");
        assert_eq!(pulled.notes.len(), 1, "{pulled:?}");
    }
}

#[test]
fn what_is_here_stays_and_forged_keys_are_ignored() {
    let lab = Lab::new();
    let (a, b) = (lab.store("a"), lab.store("b"));
    let of_a = add(&a, "x");
    let mine = Record { payload: "mine".into(), refs: Vec::new(), trees: Vec::new(), ..of_a.clone() };
    b.record(&mine).expect("writable");
    let forged = Record { key: Key::of(b"forged"), preimage: "forged".into(), ..of_a };
    a.record(&forged).expect("writable");
    lab.push(&a);
    let pulled = lab.pull(&b);
    assert_eq!((pulled.records, pulled.conflicts, pulled.notes.len()), (0, 1, 1), "{pulled:?}");
    assert_eq!(b.read("action", &mine.key), Some(mine));
    assert_eq!(b.read("action", &forged.key), None);
}

#[test]
fn records_without_their_blobs_and_of_other_namespaces_stay_at_home() {
    let lab = Lab::new();
    let a = lab.store("a");
    let whole = add(&a, "x");
    let lost = Record { key: Key::of(b"lost"), refs: vec![Digest::of(b"nowhere")], ..whole.clone() };
    let passed_on = Record { key: Key::of(b"passed on"), transient: true, ..lost.clone() };
    let memo = Record { namespace: "memo".into(), ..whole };
    [&lost, &passed_on, &memo].iter().for_each(|record| drop(a.record(record).expect("writable")));
    let pushed = lab.push(&a);
    assert_eq!((pushed.records, pushed.incomplete), (2, 1));
    let b = lab.store("b");
    assert_eq!(lab.pull(&b).records, 2);
    assert_eq!((b.read("action", &lost.key), b.read("memo", &memo.key)), (None, None));
    assert_eq!(b.read("action", &passed_on.key), Some(Record { fetched: true, ..passed_on }));
}

#[test]
fn other_folders_are_refused_and_stay_as_they_are() {
    let lab = Lab::new();
    assert!(matches!(Upstream::open(&lab.address()), Err(UpstreamError::Io { .. })));
    fs::create_dir(lab.dir()).expect("writable");
    assert!(matches!(Upstream::open(&lab.address()), Err(UpstreamError::NotUpstream { .. })));
    fs::write(lab.dir().join("thesis.tex"), "precious").expect("writable");
    assert!(matches!(Upstream::create(&lab.address()), Err(UpstreamError::NotUpstream { .. })));
    assert_eq!(fs::read_dir(lab.dir()).expect("readable").count(), 1);
    fs::write(lab.dir().join("UPSTREAM"), "tauflow-upstream 9\n").expect("writable");
    let error = Upstream::open(&lab.address()).expect_err("of another format");
    assert!(error.to_string().contains("tauflow-upstream 9"), "{error}");
}

fn notes(of: &Mutex<Vec<String>>) -> Vec<String> {
    of.lock().expect("no test panics with it").clone()
}

#[test]
fn a_store_finds_records_at_once_and_blobs_when_it_reads_them() {
    let lab = Lab::new();
    let a = lab.store("a");
    let records: Vec<Record> = (0..500).map(|n| add(&a, &n.to_string())).collect();
    lab.push(&a);
    let (b, told) = lab.reading("b");
    let mut keys: Vec<Key> = records.iter().map(|record| record.key).collect();
    keys.push(Key::of(b"nobody has done it"));
    let found = b.lookup_many("action", &keys);
    // The upstream may go away now: its indices are in memory.
    assert!(found[500].is_none() && found[..500].iter().all(Option::is_some));
    for (record, found) in records.iter().zip(found.iter().flatten()) {
        assert_eq!((&record.payload, &record.refs), (&found.payload, &found.refs));
        assert!(found.transient, "its blobs are elsewhere, and that is no loss");
        assert!(found.fetched && found.maker == record.maker, "its origin is known");
    }
    drop(b);
    let b = lab.store("b");
    assert_eq!(all(&b, &["action"]).len(), 500, "the records were copied");
    assert!(!b.contains(&records[7].refs[0]), "the blobs were not");
    assert!(!b.verify(None, 0, &mut |_, _| {}).expect("readable").is_damaged());
    drop(b);
    let (b, _) = lab.reading("b");
    assert!(b.contains(&records[7].refs[0]));
    assert_eq!(b.get(&records[7].refs[0]).expect("readable").as_deref(), Some(&b"blob of 7"[..]));
    assert_eq!(b.get(&Digest::of(b"nowhere")).expect("readable"), None);
    drop(b);
    assert!(lab.store("b").contains(&records[7].refs[0]), "a blob that was read stays");
    assert_eq!(notes(&told), [""; 0]);
}

#[test]
fn a_damaged_pack_is_told_once_and_its_blobs_are_misses() {
    let lab = Lab::new();
    let a = lab.store("a");
    let records: Vec<Record> = (0..20).map(|n| add(&a, &n.to_string())).collect();
    lab.push(&a);
    change(&lab.files("pack")[0], |bytes| bytes.iter_mut().for_each(|byte| *byte ^= 1));
    let (b, told) = lab.reading("b");
    for record in &records {
        assert!(b.contains(&record.refs[0]), "the index says so");
        assert_eq!(b.get(&record.refs[0]).expect("readable"), None);
        assert!(!b.contains(&record.refs[0]), "it cannot be had");
    }
    let told = notes(&told);
    assert!(told.len() == 1 && told[0].contains(&lab.files("pack")[0].display().to_string()), "{told:?}");
}

#[test]
fn of_two_packs_with_a_blob_the_sound_one_serves() {
    let lab = Lab::new();
    let stores = [lab.store("a"), lab.store("b")];
    let record = add(&stores[0], "x");
    add(&stores[1], "x");
    add(&stores[1], "y");
    // Both push at the same time, so that neither sees the pack of the other.
    let upstreams = [0, 1].map(|_| Upstream::create(&lab.address()).expect("writable"));
    lab.push(&stores[0]);
    let first = lab.files("index").remove(0);
    let aside = lab.folder.path().join("aside");
    fs::rename(&first, &aside).expect("writable");
    push(&stores[1], &upstreams[1], &all(&stores[1], &["action"]), &anything, false, &mut |_, _| {}).expect("writable");
    fs::rename(&aside, &first).expect("writable");
    let packs = lab.files("pack");
    assert_eq!(packs.len(), 2);
    for (n, pack) in packs.iter().enumerate() {
        change(pack, |bytes| bytes.iter_mut().for_each(|byte| *byte ^= 1));
        let (c, _) = lab.reading(&format!("c{n}"));
        assert_eq!(c.get(&record.refs[0]).expect("readable").as_deref(), Some(&b"blob of x"[..]));
        change(pack, |bytes| bytes.iter_mut().for_each(|byte| *byte ^= 1));
    }
}

#[test]
fn an_upstream_that_fails_is_a_miss_with_one_note() {
    let lab = Lab::new();
    let (b, told) = lab.reading("b");
    let mine = add(&b, "mine");
    for n in 0..10_u32 {
        assert!(b.lookup("action", &Key::of(&n.to_le_bytes())).is_none());
        assert_eq!(b.get(&Digest::of(&n.to_le_bytes())).expect("readable"), None);
    }
    assert_eq!(b.lookup("action", &mine.key).as_deref(), Some(&mine));
    let told = notes(&told);
    assert!(told.len() == 1 && told[0].starts_with("the upstream is not used: "), "{told:?}");
}

#[test]
fn what_is_here_wins_over_the_upstream_and_forged_keys_are_misses() {
    let lab = Lab::new();
    let a = lab.store("a");
    let of_a = add(&a, "x");
    let forged = Record { key: Key::of(b"forged"), preimage: "forged".into(), ..of_a.clone() };
    a.record(&forged).expect("writable");
    lab.push(&a);
    let (b, _) = lab.reading("b");
    let mine = Record { payload: "mine".into(), refs: Vec::new(), trees: Vec::new(), ..of_a };
    b.record(&mine).expect("writable");
    assert_eq!(b.lookup("action", &mine.key).as_deref(), Some(&mine));
    assert_eq!(b.lookup("action", &forged.key), None);
}

#[test]
fn a_damaged_blob_of_the_store_comes_back_from_the_upstream() {
    let lab = Lab::new();
    let a = lab.store("a");
    let big = vec![7_u8; 1 << 17];
    let digest = a.put(&big).expect("writable");
    let record = Record { key: Key::of(b"big"), refs: vec![digest], ..add(&a, "y") };
    a.record(&record).expect("writable");
    lab.push(&a);
    drop(a);
    let mut open = vec![lab.folder.path().join("a")];
    while let Some(path) = open.pop() {
        match path.is_dir() {
            true => open.extend(fs::read_dir(&path).expect("readable").map(|entry| entry.expect("readable").path())),
            false if fs::metadata(&path).expect("readable").len() == 1 << 17 => change(&path, |bytes| bytes[9] = 0),
            false => {}
        }
    }
    let (a, _) = lab.reading("a");
    assert_eq!(a.get(&digest).expect("readable"), Some(big));
}

#[test]
fn a_push_that_signs_passes_over_packs_without_a_signature_and_signs_them() {
    let lab = Lab::new();
    let a = lab.store("a");
    add(&a, "x");
    lab.push(&a);
    let path = lab.folder.path().join("key");
    let (public, _) = SecretKey::generate(&path).expect("writable");
    let pinned = || Upstream::open(&lab.address()).expect("it is there").pinned(Some(public.clone()));
    let contents = pinned().contents().expect("readable");
    assert_eq!((contents.records(), contents.notes.len()), (0, 1), "{:?}", contents.notes);
    assert!(contents.notes[0].contains("has no signature of the key") && contents.notes[0].contains("packs/"));
    let key = SecretKey::read(&path).expect("its own file");
    let signing = Upstream::open(&lab.address()).expect("it is there").signing(key).expect("its own key");
    let signed = push(&a, &signing, &all(&a, &["action"]), &anything, false, &mut |_, _| {}).expect("writable");
    assert_eq!((signed.records, signed.notes), (1, Vec::new()));
    let contents = pinned().contents().expect("readable");
    assert_eq!((contents.records(), contents.notes), (1, Vec::new()));
    assert_eq!((lab.files("index").len(), lab.files("minisig").len()), (1, 1), "the same pack, now signed");
    let b = lab.store("b");
    assert_eq!(pull(&b, &pinned(), ALL, &mut |_, _| {}).expect("writable").records, 1);
    change(&lab.files("minisig")[0], |bytes| {
        let at = bytes.len() - 20;
        bytes[at] ^= 1;
    });
    let contents = pinned().contents().expect("readable");
    assert!(contents.notes[0].contains("has a signature that is not one of the key"), "{:?}", contents.notes);
    assert_eq!(contents.records(), 0);
}
