//! Upstreams in object stores and on web servers: requests, writers at once, servers that end, wrong credentials.

#![cfg(feature = "objects")]

mod servers;

use servers::{S3, Web};
use std::{
    path::Path,
    process::Command,
    sync::{Arc, Mutex, atomic::Ordering},
    thread,
};
use tauflow_cache::{Key, Record, Store};
use tauflow_upstream::{Address, Reader, SecretKey, Upstream, UpstreamError, Wanted, all, pull, push};
use tempfile::TempDir;

const ALL: Wanted<'_> = Wanted { namespaces: &["action"], sound: &|_| true };
const SECRET: &str = "wJalrXUtnFEMIsecret";
/// The address of an upstream, for a test that runs in a process with credentials of its own.
const CHILD: &str = "TAUFLOW_TEST_UPSTREAM";

fn store(folder: &TempDir, name: &str) -> Store {
    Store::open(&folder.path().join(name)).expect("writable")
}

/// A record with a blob of its own.
fn add(store: &Store, name: &str) -> Record {
    let blob = store.put(format!("blob of {name}").as_bytes()).expect("writable");
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
        trees: Vec::new(),
        wall_us: 5,
        bytes: 6,
        when: 7,
        maker: String::new(),
        fetched: false,
    };
    store.record(&record).expect("writable");
    record
}

fn send(store: &Store, upstream: &Upstream) -> Result<u64, UpstreamError> {
    push(store, upstream, &all(store, &["action"]), &|_| true, false, &mut |_, _| {}).map(|pushed| pushed.records)
}

type Notes = Arc<Mutex<Vec<String>>>;

fn reading(mut store: Store, address: &Address, kept: &Path) -> (Store, Arc<Reader>, Notes) {
    let (notes, address, kept) = (Notes::default(), address.clone(), kept.to_owned());
    let told = notes.clone();
    let tell = move |note: &str| told.lock().expect("no test panics with it").push(note.to_owned());
    let opening = move || Ok(Upstream::open(&address)?.keeping(&kept));
    let reader = Arc::new(Reader::new(Box::new(opening), &["action"], |_| true, Box::new(tell)));
    store.look_beyond(reader.clone());
    (store, reader, notes)
}

fn told(notes: &Notes) -> Vec<String> {
    notes.lock().expect("no test panics with it").clone()
}

fn parse(text: &str) -> Address {
    text.parse().expect("an address")
}

/// A folder that a web server serves, with this many records.
fn served(folder: &TempDir, count: usize) -> (Web, Vec<Record>) {
    let a = store(folder, "a");
    let records: Vec<Record> = (0..count).map(|n| add(&a, &n.to_string())).collect();
    let shared = folder.path().join("shared");
    send(&a, &Upstream::create(&Address::Folder(shared.clone())).expect("writable")).expect("writable");
    (Web::serve(shared), records)
}

#[test]
fn many_results_take_few_requests() {
    let folder = TempDir::new().expect("a temporary folder");
    let (web, records) = served(&folder, 6000);
    let kept = folder.path().join("kept");
    let (b, reader, notes) = reading(store(&folder, "b"), &parse(&web.url), &kept);
    let keys: Vec<Key> = records.iter().map(|record| record.key).collect();
    assert!(b.lookup_many("action", &keys).iter().all(Option::is_some));
    for record in &records {
        assert!(b.get(&record.refs[0]).expect("readable").is_some());
    }
    assert_eq!(told(&notes), [""; 0]);
    let asked = reader.traffic().expect("it was asked").requests;
    assert_eq!(asked, web.requests.load(Ordering::Relaxed), "what is told is what was asked");
    // The marker, the list, the index, and the pack, which is small.
    assert!(asked <= 4, "{asked}");
    // Another process of this machine does not read the index again.
    let (c, reader, _) = reading(store(&folder, "c"), &parse(&web.url), &kept);
    assert!(c.lookup("action", &keys[0]).is_some());
    assert_eq!(reader.traffic().expect("it was asked").requests, 2);
}

#[test]
fn a_server_that_ends_is_one_note_and_what_it_has_is_a_miss() {
    let folder = TempDir::new().expect("a temporary folder");
    let (web, records) = served(&folder, 20);
    web.allowed.store(3, Ordering::Relaxed);
    let (b, _, notes) = reading(store(&folder, "b"), &parse(&web.url), &folder.path().join("kept"));
    assert!(b.lookup("action", &records[0].key).is_some());
    assert!(b.contains(&records[0].refs[0]), "the index says so");
    for record in &records {
        assert_eq!(b.get(&record.refs[0]).expect("readable"), None);
    }
    assert!(!b.contains(&records[0].refs[0]), "it cannot be had");
    assert!(b.lookup("action", &records[1].key).is_none());
    let notes = told(&notes);
    assert!(notes.len() == 1 && notes[0].starts_with("the upstream is not used any more: "), "{notes:?}");
    assert!(web.requests.load(Ordering::Relaxed) >= 6, "it was asked again before it was given up");
    let read = Upstream::open(&parse(&web.url)).expect_err("it is gone").to_string();
    assert!(read.contains("cannot read") && read.contains("127.0.0.1"), "{read}");
}

#[test]
fn a_web_server_is_for_reading() {
    let folder = TempDir::new().expect("a temporary folder");
    let (web, _) = served(&folder, 1);
    let b = store(&folder, "b");
    add(&b, "new");
    let upstream = Upstream::open(&parse(&web.url)).expect("it is there");
    let error = send(&b, &upstream).expect_err("it is read-only").to_string();
    assert!(error.contains("a web server is for reading only"), "{error}");
    let error = Upstream::open(&parse(&format!("{}/nowhere", web.url))).expect_err("nothing is there").to_string();
    assert!(error.contains("is not an upstream"), "{error}");
}

/// Runs a test of this file in a process that has an upstream and credentials.
fn child(test: &str, s3: &S3, address: &str) {
    let mut command = Command::new(std::env::current_exe().expect("this program"));
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("AWS_")) {
        command.env_remove(name);
    }
    command.args(["--exact", test, "--nocapture"]).env(CHILD, address).env("AWS_ENDPOINT_URL", &s3.url);
    command.env("AWS_ACCESS_KEY_ID", "AKIDEXAMPLE").env("AWS_SECRET_ACCESS_KEY", SECRET);
    let done = command.output().expect("it starts");
    let text = [done.stdout, done.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    assert!(done.status.success(), "{text}");
    assert!(text.contains("1 passed"), "{text}");
}

#[test]
fn s3_holds_what_several_write_at_once() {
    let Ok(address) = std::env::var(CHILD) else {
        if let Some(s3) = S3::start(false) {
            child("s3_holds_what_several_write_at_once", &s3, "s3://lab/results/tauflow");
        }
        return;
    };
    let (folder, address) = (TempDir::new().expect("a temporary folder"), parse(&address));
    let stores: Vec<Store> = (0..3).map(|n| store(&folder, &format!("s{n}"))).collect();
    for (n, store) in stores.iter().enumerate() {
        add(store, "common");
        (0..500).for_each(|k| drop(add(store, &format!("{n}-{k}"))));
    }
    let write = |store: &Store| Upstream::create(&address).and_then(|upstream| send(store, &upstream));
    thread::scope(|scope| {
        let all: Vec<_> = stores.iter().map(|store| scope.spawn(|| write(store))).collect();
        all.into_iter().for_each(|one| assert!(one.join().expect("no panic").expect("writable") >= 500));
    });
    // The same again changes nothing.
    assert_eq!(write(&stores[0]).expect("writable"), 0);
    let upstream = Upstream::open(&address).expect("it is there").keeping(&folder.path().join("kept"));
    assert_eq!(upstream.contents().expect("readable").records(), 1501);
    let b = store(&folder, "b");
    let pulled = pull(&b, &upstream, ALL, &mut |_, _| {}).expect("readable");
    assert_eq!((pulled.records, pulled.notes.len(), pulled.conflicts), (1501, 0, 0));
    let asked = upstream.traffic().expect("it is no directory").requests;
    assert!(asked <= 11, "{asked}");
    let (c, _, notes) = reading(store(&folder, "c"), &address, &folder.path().join("kept"));
    let record = c.lookup("action", &Key::of(b"1-77")).expect("it was written");
    assert_eq!(c.get(&record.refs[0]).expect("readable").as_deref(), Some(&b"blob of 1-77"[..]));
    assert_eq!(told(&notes), [""; 0]);
    // A large blob goes in parts. Its ranges are read alone.
    let d = store(&folder, "d");
    let big: Vec<u8> = (0..150_000_000_u32).map(|n| (n ^ (n >> 11)) as u8).collect();
    let digest = d.put(&big).expect("writable");
    d.record(&Record { key: Key::of(b"big"), refs: vec![digest], ..add(&d, "small") }).expect("writable");
    assert_eq!(write(&d).expect("writable"), 2);
    let (e, _, notes) = reading(store(&folder, "e"), &address, &folder.path().join("kept"));
    assert!(e.get(&digest).expect("readable") == Some(big), "{:?}", told(&notes));
    // Signed.
    let (public, _) = SecretKey::generate(&folder.path().join("key")).expect("writable");
    let key = SecretKey::read(&folder.path().join("key")).expect("its own file");
    let signed = |upstream: Upstream| upstream.pinned(Some(public.clone())).contents().expect("readable");
    let contents = signed(Upstream::open(&address).expect("it is there"));
    assert_eq!((contents.records(), contents.notes.len()), (0, 5), "{:?}", contents.notes);
    assert!(contents.notes[0].contains(&public.to_string()), "{:?}", contents.notes);
    let upstream = Upstream::open(&address).expect("it is there").signing(key).expect("its own key");
    send(&b, &upstream).expect("writable");
    assert_eq!(signed(Upstream::open(&address).expect("it is there")).records(), 1501);
    // A bucket that is missing, and a prefix of somebody else.
    let error = Upstream::create(&parse("s3://nobody/x")).expect_err("no bucket").to_string();
    assert!(error.contains("NoSuchBucket"), "{error}");
    let error = Upstream::create(&parse("s3://lab/results")).expect_err("it is somebody's");
    assert!(matches!(error, UpstreamError::NotUpstream { .. }), "{error}");
}

#[test]
fn wrong_credentials_are_an_error_that_does_not_repeat_them() {
    let Ok(address) = std::env::var(CHILD) else {
        if let Some(s3) = S3::start(true) {
            child("wrong_credentials_are_an_error_that_does_not_repeat_them", &s3, "s3://lab/x");
        }
        return;
    };
    let folder = TempDir::new().expect("a temporary folder");
    for error in [Upstream::open(&parse(&address)), Upstream::create(&parse(&address))] {
        let error = error.expect_err("the key is unknown").to_string();
        assert!(error.contains("access is denied") && error.contains("InvalidAccessKeyId"), "{error}");
        assert!(!error.contains(SECRET) && !error.contains("AKIDEXAMPLE"), "{error}");
    }
    let (b, _, notes) = reading(store(&folder, "b"), &parse(&address), &folder.path().join("kept"));
    let mine = add(&b, "mine");
    assert!(b.lookup("action", &Key::of(b"x")).is_none() && b.lookup("action", &Key::of(b"y")).is_none());
    assert_eq!(b.lookup("action", &mine.key).as_deref(), Some(&mine));
    let notes = told(&notes);
    assert!(notes.len() == 1 && notes[0].starts_with("the upstream is not used: "), "{notes:?}");
}
