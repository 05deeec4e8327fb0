//! A campaign of faults against the store and the engine.
//!
//! Processes are killed at random moments and at every call that changes a file. The power goes, and what was not
//! synced is undone. Disks are full or read-only. Files and folders are damaged or missing. A clock jumps. Several
//! processes run at once, a collection runs beside a run, and signals come. After each, the same command must end with
//! the outputs of an undisturbed run. Nothing that was announced as done may be done again.
//!
//! `cargo test --release --test faults -- --nocapture` prints how many faults of each kind there were; `TAUFLOW_SLOW=1`
//! makes more of them.

#[path = "../support/kinds.rs"]
mod kinds;
#[path = "../support/media.rs"]
mod media;

mod campaign;
mod child;
mod processes;

use campaign::{Campaign, PIPELINE, WIDE};
use std::{fs, path::Path, process::Command, thread, time::Duration};
use tauflow_cache::{GcOptions, Store};
use tauflow_testing::slow;

#[test]
fn kill_9_at_random_moments() {
    let mut campaign = Campaign::new("kill -9 at a random moment");
    // Every call that changes a file has its own kill elsewhere. Here it is what lies between: a moment that is one in
    // a hundred of a run is met surely by this many.
    let runs = if slow() { 600 } else { 200 };
    let mut kills = 0;
    while kills < runs {
        let cache = campaign.fresh();
        // Row of processes on one cache, each killed, until one comes through or the row is long enough.
        for _ in 0..8 {
            let delay = campaign.random(campaign.undisturbed.as_micros() as u64);
            let mut child = campaign.start(&cache, PIPELINE, &[]);
            thread::sleep(Duration::from_micros(delay));
            let killed = child.kill();
            kills += u64::from(killed);
            if !killed {
                break;
            }
        }
        campaign.ends_well(&cache);
    }
    campaign.made(kills);
}

/// Kills before a call are those of `power_cuts`, where another process goes on, too. After a call, files are as they
/// are before the next one, but for what other threads do: a few of these will do.
#[test]
fn kill_9_at_every_call_that_changes_a_file() {
    for (fault, slow_stride) in [("half", 1), ("after", 11)] {
        let mut campaign = Campaign::new(&format!("kill -9 {fault} a write, sync, rename, create or remove"));
        let stride = if slow() { slow_stride } else { 17 };
        let mut at = 1 + campaign.random(stride);
        let mut kills = 0;
        loop {
            let cache = campaign.fresh();
            let ended = campaign.start(&cache, PIPELINE, &[("SHIM_FAULT", fault), ("SHIM_AT", &at.to_string())]).wait();
            if !ended.killed {
                assert_eq!(ended.code, 0, "{ended:?}");
                break;
            }
            kills += 1;
            campaign.ends_well(&cache);
            at += stride;
        }
        assert!(kills > 20, "a run makes hundreds of calls: {kills}");
        campaign.made(kills);
    }
}

#[test]
fn a_disk_that_is_full_or_read_only_from_some_call_on() {
    // Both fail the same calls, and differ in the error alone.
    for (fault, told, slow_stride) in [("full", "disk is full", 1), ("read_only", "Read-only file system", 7)] {
        let mut campaign = Campaign::new(&format!("{fault} disk"));
        let stride = if slow() { slow_stride } else { 29 };
        let mut at = 1 + campaign.random(stride);
        let mut faults = 0;
        loop {
            let cache = campaign.fresh();
            let ended = campaign.start(&cache, PIPELINE, &[("SHIM_FAULT", fault), ("SHIM_AT", &at.to_string())]).wait();
            assert!(!ended.killed, "{ended:?}");
            if ended.code == 0 {
                break; // what failed was of no consequence: an index file at the end
            }
            assert_eq!(ended.code, 3, "{ended:?}");
            assert!(ended.text.contains(told), "call {at}: {ended:?}");
            faults += 1;
            campaign.ends_well(&cache);
            at += stride;
        }
        assert!(faults > 10, "{faults}");
        campaign.made(faults);
    }
}

#[test]
fn files_of_the_cache_damaged_cut_and_deleted() {
    let mut campaign = Campaign::new("file of the cache damaged, cut or deleted");
    let rounds = if slow() { 600 } else { 40 };
    let cache = campaign.fresh();
    campaign.ends_well(&cache);
    for _ in 0..rounds {
        let mut files = Vec::new();
        list(&cache, &mut files);
        files.retain(|path| fs::metadata(path).is_ok_and(|meta| meta.len() > 0));
        let path = &files[campaign.random(files.len() as u64) as usize];
        if path.ends_with("FORMAT") {
            continue; // a cache of an unknown format is refused, and told
        }
        let mut bytes = fs::read(path).expect("readable");
        let at = campaign.random(bytes.len() as u64) as usize;
        match campaign.random(4) {
            0 => bytes.truncate(at),
            1 => bytes[at] ^= 1 << campaign.random(8),
            2 => bytes[at..].iter_mut().take(512).for_each(|byte| *byte = 0),
            _ => bytes.clear(),
        }
        if bytes.is_empty() { fs::remove_file(path) } else { fs::write(path, &bytes) }.expect("writable");
        campaign.ends_alike(&cache);
    }
    campaign.made(rounds);
    let mut campaign = Campaign::new("folder of the cache deleted");
    let folders = ["packs", "log", "blobs", "leases", "locks", "tmp", "trash", "quarantine", "pins", ""];
    for folder in folders {
        let cache = campaign.fresh();
        campaign.ends_well(&cache);
        fs::remove_dir_all(cache.join(folder)).expect("it was there");
        campaign.ends_alike(&cache);
    }
    campaign.made(folders.len() as u64);
}

fn list(folder: &Path, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(folder).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() { list(&path, found) } else { found.push(path) }
    }
    found.sort();
}

#[test]
fn a_wide_gather_and_an_export_after_damage() {
    let mut campaign = Campaign::new("kill, and then blobs lost, of a gather over 1,100 items");
    let exports = [format!("#export long\n{WIDE}"), format!("#export sum\n{WIDE}")];
    campaign.learn(WIDE);
    let rounds = if slow() { 60 } else { 6 };
    for round in 0..rounds {
        let cache = campaign.fresh();
        if round % 3 == 1 {
            let mut child = campaign.start(&cache, WIDE, &[]);
            thread::sleep(Duration::from_millis(campaign.random(200)));
            child.kill();
        }
        campaign.comes_through(&cache, WIDE);
        let mut files = Vec::new();
        list(&cache.join("packs"), &mut files);
        if round % 2 == 0 {
            files.iter().for_each(|path| fs::remove_file(path).expect("writable"));
        } else {
            // A hole of a third of each pack: some hundreds of blobs, and their listings.
            for path in files.iter().filter(|path| path.extension().is_some_and(|ending| ending == "pack")) {
                let mut bytes = fs::read(path).expect("readable");
                let at = campaign.random(bytes.len() as u64) as usize;
                let len = bytes.len() / 3;
                bytes[at..].iter_mut().take(len).for_each(|byte| *byte = 0);
                fs::write(path, &bytes).expect("writable");
            }
        }
        let export = &exports[campaign.random(2) as usize];
        let ended = campaign.start(&cache, export, &[]).wait();
        assert_eq!(ended.code, 0, "{ended:?}");
        let items = if export.starts_with("#export long") { 1100 } else { 1 };
        assert_eq!(ended.text.lines().filter(|line| line.starts_with("output ")).count(), items, "{ended:?}");
        campaign.comes_through(&cache, WIDE);
    }
    campaign.made(rounds);
}

#[test]
fn power_cuts() {
    let mut campaign =
        Campaign::new("kill -9 and power cut before a call that changes a file, and a cut after the next run");
    // It reads the large blobs, which a commit mark vouches for.
    let edited = PIPELINE.replace("to: 30", "to: 40");
    campaign.learn(&edited);
    let stride = if slow() { 1 } else { 17 };
    let mut at = 1 + campaign.random(stride);
    let mut cuts = 0;
    loop {
        let cache = campaign.fresh();
        let mirror = campaign.mirror(&cache).to_string_lossy().into_owned();
        let faults = [("SHIM_MIRROR", mirror.as_str()), ("SHIM_FAULT", "before"), ("SHIM_AT", &at.to_string())];
        let ended = campaign.start(&cache, PIPELINE, &faults).wait();
        let cut = campaign.power_cut(&cache);
        // Without a cut, another process goes on where the first one died. Of what it leaves, a cut takes nothing.
        let next = campaign.start(&cache, PIPELINE, &faults[..1]).wait();
        assert_eq!(next.code, 0, "call {at}: {next:?}");
        campaign.same(&next, PIPELINE);
        campaign.nothing_twice();
        let after = campaign.power_cut(&cache);
        campaign.ends_well(&after);
        campaign.comes_through(&after, &edited);
        let again = campaign.done(&edited);
        let early = |line: &&String| line.starts_with("numbers ") || line.starts_with("long ");
        assert_eq!(again.iter().find(early), None, "call {at}: a commit mark vouched for what was not durable");
        campaign.forgets();
        campaign.ends_alike(&cut);
        cuts += 2;
        if !ended.killed {
            assert_eq!(ended.code, 0, "{ended:?}");
            break;
        }
        at += stride;
    }
    assert!(cuts > 20, "a run makes hundreds of calls: {cuts}");
    campaign.made(cuts);
}

#[test]
fn a_clock_that_jumps() {
    let mut campaign = Campaign::new("clock that jumps by years at every reading");
    let rounds = if slow() { 20 } else { 4 };
    let cache = campaign.fresh();
    for _ in 0..rounds {
        let ended = campaign.start(&cache, PIPELINE, &[("SHIM_FAULT", "clock")]).wait();
        assert_eq!(ended.code, 0, "{ended:?}");
        campaign.same(&ended, PIPELINE);
        // A collection in between goes by those times, and harms nobody.
        let store = Store::open(&cache).expect("readable");
        store.gc(&GcOptions { keep_within_secs: Some(1), now: 1 << 31, ..GcOptions::default() }).expect("it works");
        campaign.forgets();
    }
    campaign.ends_well(&cache);
    campaign.made(rounds);
}

#[test]
fn processes_at_once() {
    let other = PIPELINE.replace("mul: 2", "mul: 3");
    for (count, several) in [(2, false), (4, false), (2, true), (4, true)] {
        let what = if several { "of two pipelines" } else { "of one pipeline" };
        let mut campaign =
            Campaign::on_disk(&format!("{count} processes at once {what}, one killed in half the rounds"));
        campaign.learn(&other);
        let rounds = if slow() { 40 } else { 4 };
        for round in 0..rounds {
            let cache = campaign.fresh();
            let text = |n: usize| if several && n % 2 == 1 { other.as_str() } else { PIPELINE };
            let mut children: Vec<_> = (0..count).map(|n| campaign.start(&cache, text(n), &[])).collect();
            if round % 2 == 1 {
                thread::sleep(Duration::from_micros(campaign.random(campaign.undisturbed.as_micros() as u64)));
                children[0].kill();
            }
            for (n, child) in children.into_iter().enumerate() {
                let ended = child.wait();
                if n > 0 || round % 2 == 0 {
                    assert_eq!(ended.code, 0, "{ended:?}");
                    campaign.same(&ended, text(n));
                }
            }
            campaign.ends_well(&cache);
        }
        campaign.made(rounds);
    }
}

#[test]
fn a_collection_beside_a_run() {
    let mut campaign = Campaign::on_disk("collection beside a run");
    let edited = PIPELINE.replace("add: 1", "add: 2");
    campaign.learn(&edited);
    let rounds = if slow() { 100 } else { 10 };
    let mut collections = 0;
    for round in 0..rounds {
        let cache = campaign.fresh();
        // Some of it is there already, and in the collection's way; or the collection finds an empty folder, as the run
        // does.
        if round % 2 == 0 {
            campaign.ends_well(&cache);
        }
        let mut child = campaign.start(&cache, &edited, &[]);
        let store = Store::open(&cache).expect("readable");
        while child.goes_on() {
            store.gc(&GcOptions { max_bytes: Some(0), now: 1 << 40, ..GcOptions::default() }).expect("it works");
            collections += 1;
        }
        let ended = child.wait();
        assert_eq!(ended.code, 0, "{ended:?}");
        campaign.same(&ended, &edited);
        campaign.forgets();
        drop(store);
        campaign.ends_well(&cache);
    }
    assert!(collections >= rounds, "they met: {collections}");
    campaign.made(collections);
}

#[test]
fn signals() {
    const SMALL: &str = "\
pipeline: small
nodes:
  scenes: { kind: scene_generation, params: { pool: 8, regimes: [L0], contexts: [open, enclosed] } }
";
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("small.yaml");
    fs::write(&file, SMALL).expect("writable");
    let command = |cache: &str, lock: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tauflow"));
        command
            .args(["run", "small.yaml", lock])
            .current_dir(folder.path())
            .env("TAUFLOW_CACHE", folder.path().join(cache));
        command.stderr(std::process::Stdio::null());
        command
    };
    assert!(command("first", "--update-lock").status().expect("it starts").success());
    let rounds = if slow() { 20 } else { 8 };
    let mut random = campaign::Random(5);
    let mut met = 0;
    for round in 0..rounds {
        let cache = format!("cache{round}");
        let mut child = command(&cache, "--locked").spawn().expect("it starts");
        thread::sleep(Duration::from_millis(5 + random.below(150)));
        let signal = if round % 2 == 0 { "-INT" } else { "-TERM" };
        Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill starts");
        let code = child.wait().expect("it ends").code();
        met += u64::from(code == Some(130));
        // It had not set itself up to be told, was told, or was through.
        assert!(matches!(code, None | Some(130 | 0)), "{code:?}");
        assert!(command(&cache, "--locked").status().expect("it starts").success(), "the same command goes on");
        // One at a time: all of them would fill a small disk.
        fs::remove_dir_all(folder.path().join(&cache)).expect("it is there");
    }
    assert!(met > 0, "some were told in time");
    println!("{rounds:>6} SIGINT and SIGTERM, of which {met} stopped a run");
}
