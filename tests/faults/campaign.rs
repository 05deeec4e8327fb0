//! What all faults share: processes on caches, what an undisturbed run gives, and the account of what was done.

use crate::child::{CACHE, LEDGER, TEXT};
use std::{
    collections::{BTreeMap, HashSet},
    fs,
    io::Read,
    os::unix::{fs::MetadataExt, process::ExitStatusExt},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::OnceLock,
    time::{Duration, Instant},
};
use tauflow_cache::Key;
use tempfile::TempDir;

/// Small blobs and large ones, memoised sub-actions, a filter, two inputs that meet, gathers.
pub const PIPELINE: &str = "
pipeline: faults
nodes:
  numbers: {kind: numbers, params: {count: 24}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, add: 1, pad: 70000}}
  rounded: {kind: round, inputs: {in: long}, params: {to: 30}}
  gate: {kind: below, inputs: {in: rounded}, params: {limit: 300}}
  pairs: {kind: pair, inputs: {left: gate, right: long}}
  shares: {kind: shares, inputs: {in: pairs, of: gate.others}}
  total: {kind: total, inputs: {in: [shares, gate.others]}}
";

/// A gather of more than 1,000 items that only memory holds, and one of as many that are stored.
pub const WIDE: &str = "
pipeline: wide
nodes:
  numbers: {kind: numbers, params: {count: 1100}}
  long: {kind: affine, inputs: {in: numbers}, params: {mul: 2, add: 1, pad: 500}, transient: true}
  rounded: {kind: round, inputs: {in: long}, params: {to: 30}}
  sum: {kind: total, inputs: {in: long}}
  total: {kind: total, inputs: {in: rounded}}
";

/// Numbers that are the same each time.
pub struct Random(pub u64);

impl Random {
    /// A number below `limit`.
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % limit.max(1)
    }
}

/// One sort of fault.
pub struct Campaign {
    name: String,
    folder: TempDir,
    caches: u32,
    cuts: u32,
    random: Random,
    /// Outputs by pipeline, as an undisturbed run gives them.
    expected: BTreeMap<String, String>,
    /// What an undisturbed run takes.
    pub undisturbed: Duration,
}

/// A process that runs a pipeline.
pub struct Process(Child);

/// How it ended.
#[derive(Debug)]
pub struct Ended {
    /// By a kill.
    pub killed: bool,
    pub code: i32,
    pub text: String,
}

impl Ended {
    fn outputs(&self) -> String {
        self.text.lines().filter(|line| line.starts_with("output ")).map(|line| format!("{line}\n")).collect()
    }
}

/// The library that makes calls fail, compiled once.
fn shim() -> &'static Path {
    static SHIM: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = SHIM.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("shim.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/shim.rs");
        let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
        let options = ["--edition", "2024", "--crate-type", "cdylib", "-O", "-o"];
        let done = Command::new(rustc).args(options).arg(&path).arg(source).output().expect("rustc starts");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        (folder, path)
    });
    path
}

/// A folder in memory where there is room: what the library does to calls needs no disk, and syncs take no time there.
fn in_memory() -> TempDir {
    let room = Command::new("df").args(["--output=avail", "-k", "/dev/shm"]).output().ok();
    let room = room.and_then(|df| String::from_utf8_lossy(&df.stdout).lines().last()?.trim().parse::<u64>().ok());
    let memory = room.filter(|kib| *kib > 1 << 20).and_then(|_| TempDir::new_in("/dev/shm").ok());
    memory.unwrap_or_else(|| TempDir::new().expect("a temporary folder"))
}

impl Campaign {
    pub fn new(name: &str) -> Self {
        Self::within(name, in_memory())
    }

    /// On a disk, whose slowness brings processes to meet at other places.
    pub fn on_disk(name: &str) -> Self {
        Self::within(name, TempDir::new().expect("a temporary folder"))
    }

    fn within(name: &str, folder: TempDir) -> Self {
        let mut campaign = Self {
            name: name.into(),
            folder,
            caches: 0,
            cuts: 0,
            random: Random(name.len() as u64),
            expected: BTreeMap::new(),
            undisturbed: Duration::ZERO,
        };
        let start = Instant::now();
        campaign.learn(PIPELINE);
        // On a machine with other work, kills need not wait for it.
        campaign.undisturbed = start.elapsed().min(Duration::from_millis(100));
        campaign
    }

    pub fn random(&mut self, limit: u64) -> u64 {
        self.random.below(limit)
    }

    /// Learns what a pipeline gives undisturbed.
    pub fn learn(&mut self, text: &str) {
        if self.expected.contains_key(text) {
            return;
        }
        let cache = self.fresh();
        let ended = self.start(&cache, text, &[]).wait();
        assert_eq!(ended.code, 0, "{ended:?}");
        assert!(ended.outputs().lines().count() >= 4, "{ended:?}");
        self.expected.insert(text.into(), ended.outputs());
    }

    /// An empty cache.
    pub fn fresh(&mut self) -> PathBuf {
        // One at a time: what a campaign leaves would fill a small disk.
        let last = self.folder.path().join(format!("cache{}", self.caches));
        let _ = fs::remove_dir_all(last.with_extension("mirror"));
        let _ = fs::remove_dir_all(last);
        for cut in self.cuts.saturating_sub(4)..=self.cuts {
            let _ = fs::remove_dir_all(self.folder.path().join(format!("cut{cut}")));
        }
        self.caches += 1;
        self.forgets();
        self.folder.path().join(format!("cache{}", self.caches))
    }

    /// What a power cut leaves of a cache whose processes ran with [`Campaign::mirror`]: what was synced, and nothing
    /// else.
    pub fn power_cut(&mut self, cache: &Path) -> PathBuf {
        let root = fs::metadata(cache).map_or(0, |meta| meta.ino());
        self.cuts += 1;
        let left = self.folder.path().join(format!("cut{}", self.cuts));
        rebuild(&self.mirror(cache), &format!("d{root}"), &left);
        left
    }

    /// Where the library notes what was synced of a cache.
    pub fn mirror(&self, cache: &Path) -> PathBuf {
        let mirror = cache.with_extension("mirror");
        fs::create_dir_all(&mirror).expect("writable");
        mirror
    }

    /// Lines of the ledger for a pipeline's text.
    pub fn done(&self, text: &str) -> Vec<String> {
        let of = Key::of(text.as_bytes()).short();
        let ledger = fs::read_to_string(self.ledger()).expect("readable");
        ledger.lines().filter_map(|line| Some(line.strip_prefix(&of)?.trim().to_owned())).collect()
    }

    /// Begins the ledger anew: what was done may have to be done again.
    pub fn forgets(&self) {
        fs::write(self.ledger(), "").expect("writable");
    }

    fn ledger(&self) -> PathBuf {
        self.folder.path().join("ledger")
    }

    /// Starts a process on a cache, with more variables of the environment.
    pub fn start_with(&self, cache: &Path, text: &str, more: &[(&str, &str)]) -> Process {
        Process(self.command(cache, text).envs(more.iter().copied()).spawn().expect("the child starts"))
    }

    /// Starts a process on a cache; `shim` says what happens to it, if anything.
    pub fn start(&self, cache: &Path, text: &str, faults: &[(&str, &str)]) -> Process {
        let mut command = self.command(cache, text);
        if !faults.is_empty() {
            command.env("LD_PRELOAD", shim()).envs(faults.iter().copied());
        }
        Process(command.spawn().expect("the child starts"))
    }

    fn command(&self, cache: &Path, text: &str) -> Command {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(["--exact", "child::child", "--nocapture", "--test-threads=1"]);
        command.env(CACHE, cache).env(LEDGER, self.ledger()).env(TEXT, text).env_remove("RUST_BACKTRACE");
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        command
    }

    /// Checks what a process that came through says.
    pub fn same(&self, ended: &Ended, text: &str) {
        assert_eq!(ended.outputs(), self.expected[text], "{}: {}", self.name, ended.text);
    }

    /// The same command comes through now, with the same outputs.
    pub fn ends_alike(&self, cache: &Path) {
        self.comes_through(cache, PIPELINE);
    }

    /// A command comes through now, with the outputs of an undisturbed one.
    pub fn comes_through(&self, cache: &Path, text: &str) {
        let ended = self.start(cache, text, &[]).wait();
        assert_eq!(ended.code, 0, "{}: {ended:?}", self.name);
        self.same(&ended, text);
    }

    /// As [`Campaign::ends_alike`]; and nothing in the ledger was done twice.
    pub fn ends_well(&self, cache: &Path) {
        self.ends_alike(cache);
        self.nothing_twice();
    }

    /// Nothing in the ledger was done twice.
    pub fn nothing_twice(&self) {
        let ledger = fs::read_to_string(self.ledger()).expect("readable");
        let mut seen = HashSet::new();
        // A line that a kill cut off has no end.
        for line in ledger.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
            assert!(seen.insert(line), "{}: done again though it was done: {line}", self.name);
        }
    }

    /// Tells how many faults there were.
    pub fn made(&self, count: u64) {
        println!("{count:>6} {}", self.name);
    }
}

/// Makes a folder as the mirror has it: `name` says of which inode.
fn rebuild(mirror: &Path, name: &str, folder: &Path) {
    fs::create_dir_all(folder).expect("writable");
    let listed = fs::read_to_string(mirror.join(name)).unwrap_or_default(); // one that was never synced is empty
    for line in listed.lines() {
        let (inode, name) = line.split_once(' ').expect("an inode and a name");
        if inode.starts_with('d') {
            rebuild(mirror, inode, &folder.join(name));
        } else {
            fs::write(folder.join(name), fs::read(mirror.join(inode)).unwrap_or_default()).expect("writable");
        }
    }
}

impl Process {
    /// Kills it; whether it was still there to be killed.
    pub fn kill(&mut self) -> bool {
        let _ = self.0.kill(); // it may be gone
        let status = self.0.wait().expect("it can be waited for");
        status.signal() == Some(9)
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        self.0.id()
    }

    pub fn goes_on(&mut self) -> bool {
        self.0.try_wait().expect("it can be asked").is_none()
    }

    /// Waits for its end.
    pub fn wait(mut self) -> Ended {
        let mut text = String::new();
        let stdout = self.0.stdout.take();
        stdout.map(|mut out| out.read_to_string(&mut text)).transpose().expect("text");
        let status = self.0.wait().expect("it can be waited for");
        Ended { killed: status.signal() == Some(9), code: status.code().unwrap_or(-1), text }
    }
}
