//! Headless Chromium for tests of pages, driven over pipes by the Chrome DevTools Protocol: messages in JSON that end
//! with a zero byte. Needs no crate for WebSockets.

use crate::{Need, skip};
use serde_json::{Value, json};
use std::{
    fs::{self, File, OpenOptions},
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicU32, Ordering},
    thread,
    time::{Duration, Instant},
};

/// How long a page may take to come to a state; more than a busy machine needs.
const PATIENCE: Duration = Duration::from_secs(180);

/// How often a browser is started that ends before it has a page.
const STARTS: usize = 3;

const ENDED: &str = "the browser has ended";

/// A browser with one page.
pub struct Browser {
    child: Child,
    to: File,
    from: BufReader<File>,
    folder: PathBuf,
    session: Option<String>,
    last: u64,
    problems: Vec<String>,
}

/// The browser's program, `TAUFLOW_CHROMIUM` or a usual name.
fn program() -> Option<String> {
    let usual = ["chromium", "chromium-browser", "google-chrome", "chrome"].map(str::to_owned);
    let runs = |name: &String| {
        let quiet = Command::new(name).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        quiet.is_ok_and(|status| status.success())
    };
    crate::set("TAUFLOW_CHROMIUM").into_iter().chain(usual).find(runs)
}

fn mkfifo(path: &Path) -> bool {
    Command::new("mkfifo").arg(path).status().is_ok_and(|status| status.success())
}

impl Browser {
    /// Starts a browser; without one, says that the test is skipped.
    ///
    /// # Panics
    /// If the browser cannot be driven.
    pub fn start(test: &str) -> Option<Self> {
        let Some(program) = program() else {
            skip(Need::Chromium, format!("{test}: there is no Chromium; install it, or name it in TAUFLOW_CHROMIUM"));
            return None;
        };
        // A browser that starts beside others ends at once now and then, before any page is open. That says nothing
        // about the page.
        let mut ends = Vec::new();
        while ends.len() < STARTS {
            let Some(begun) = Self::begin(&program) else {
                skip(Need::Fifo, format!("{test}: mkfifo does not run here"));
                return None;
            };
            match begun {
                Ok(browser) => return Some(browser),
                Err(end) => ends.push(end),
            }
            eprintln!("{test}: the browser ended as it started: {}", ends[ends.len() - 1]);
        }
        panic!("{test}: {program} ended {STARTS} times as it started: {ends:?}");
    }

    /// A browser with an empty page; if it ended before that, its status and the end of its messages. None without
    /// `mkfifo`.
    fn begin(program: &str) -> Option<Result<Self, String>> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("tauflow-browser-{}-{number}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("temporary files can be written");
        let (to, from) = (folder.join("to"), folder.join("from"));
        if !mkfifo(&to) || !mkfifo(&from) {
            return None;
        }
        let script = r#"exec "$0" --headless --no-sandbox --disable-gpu-sandbox --use-angle=swiftshader \
            --enable-unsafe-swiftshader --disable-dev-shm-usage --no-first-run --disable-extensions \
            --disable-background-networking --user-data-dir="$3" --remote-debugging-pipe about:blank 3<"$1" 4>"$2""#;
        let child = Command::new("sh")
            .args(["-c", script, program])
            .args([&to, &from, &folder.join("profile")])
            .env("TMPDIR", &folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(folder.join("messages")).expect("temporary files can be written"))
            .spawn()
            .expect("sh runs");
        // A FIFO opens once both ends are there, and the shell opens them in this order.
        let to = OpenOptions::new().write(true).open(to).expect("the browser reads it");
        let from = BufReader::new(File::open(from).expect("the browser writes it"));
        let (last, problems) = (0, Vec::new());
        let mut own = Self { child, to, from, folder, session: None, last, problems };
        let Ok(page) = own.exchange("Target.createTarget", json!({ "url": "about:blank" })) else {
            return Some(Err(own.end()));
        };
        let attached = own.call("Target.attachToTarget", json!({ "targetId": page["targetId"], "flatten": true }));
        own.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            own.call(&format!("{domain}.enable"), json!({}));
        }
        Some(Ok(own))
    }

    /// Ends the browser; its status and the end of its messages.
    fn end(&mut self) -> String {
        let _ = self.child.kill();
        let status = self.child.wait().map_or_else(|error| error.to_string(), |status| status.to_string());
        let messages = fs::read(self.folder.join("messages")).unwrap_or_default();
        let messages = String::from_utf8_lossy(&messages[messages.len().saturating_sub(2000)..]).into_owned();
        format!("{status}; {messages}")
    }

    /// Sends a command, and waits for its answer.
    ///
    /// # Panics
    /// If the browser has ended, or refuses the command.
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        self.exchange(method, params).unwrap_or_else(|error| {
            assert!(error != json!(ENDED), "{method}: {ENDED}: {}", self.end());
            panic!("{method}: {error}")
        })
    }

    /// Sends a command; its answer, or the browser's error, which is text if the browser has ended.
    fn exchange(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.last += 1;
        let mut message = json!({ "id": self.last, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.to.write_all(&bytes).and_then(|()| self.to.flush()).map_err(|_| json!(ENDED))?;
        loop {
            let message = self.receive()?;
            if message["id"] == json!(self.last) {
                return message.get("error").map_or_else(|| Ok(message["result"].clone()), |error| Err(error.clone()));
            }
        }
    }

    /// The next message, or [`ENDED`].
    fn receive(&mut self) -> Result<Value, Value> {
        let mut bytes = Vec::new();
        self.from.read_until(0, &mut bytes).expect("the pipe is there");
        if bytes.pop() != Some(0) {
            return Err(json!(ENDED));
        }
        let message: Value = serde_json::from_slice(&bytes).expect("the browser sends JSON");
        let params = &message["params"];
        match message["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.problems.push(format!("exception: {}", params["exceptionDetails"])),
            Some("Runtime.consoleAPICalled")
                if ["error", "warning", "assert"].map(|t| json!(t)).contains(&params["type"]) =>
            {
                self.problems.push(format!("console: {}", params["args"]));
            }
            Some("Log.entryAdded") if ["error", "warning"].map(|t| json!(t)).contains(&params["entry"]["level"]) => {
                self.problems.push(format!("log: {}", params["entry"]));
            }
            Some("Network.requestWillBeSent") => {
                let url = params["request"]["url"].as_str().unwrap_or_default();
                if !["file:", "data:", "blob:", "about:"].iter().any(|scheme| url.starts_with(scheme)) {
                    self.problems.push(format!("network: {url}"));
                }
            }
            _ => {}
        }
        Ok(message)
    }

    /// Makes the window this wide and high; narrow ones are of a device with a touch screen.
    pub fn size(&mut self, width: u32, height: u32) {
        let touch = width < 700;
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": touch });
        self.call("Emulation.setDeviceMetricsOverride", metrics);
        self.call("Emulation.setTouchEmulationEnabled", json!({ "enabled": touch }));
    }

    /// Opens a file as a new document, and waits until it is loaded.
    ///
    /// # Panics
    /// If the file is missing, or the page is never loaded.
    pub fn open(&mut self, page: &Path) {
        let path = fs::canonicalize(page).expect("the page is there");
        for (url, scheme) in [("about:blank".to_owned(), "about:"), (format!("file://{}", path.display()), "file:")] {
            let to = self.call("Page.navigate", json!({ "url": url }));
            assert!(to.get("errorText").is_none(), "{to}");
            self.wait(&format!("location.protocol === '{scheme}' && document.readyState === 'complete'"));
        }
    }

    /// The value of an expression, after its promise.
    ///
    /// # Panics
    /// If it throws.
    pub fn eval(&mut self, expression: &str) -> Value {
        self.attempt(expression).unwrap_or_else(|thrown| panic!("{expression}: {thrown}"))
    }

    /// The value of an expression, or what is thrown, which may be that the document has just gone.
    fn attempt(&mut self, expression: &str) -> Result<Value, Value> {
        let params = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true, "replMode": true });
        let answer = self.exchange("Runtime.evaluate", params)?;
        match answer.get("exceptionDetails") {
            Some(thrown) => Err(thrown.clone()),
            None => Ok(answer["result"]["value"].clone()),
        }
    }

    /// Waits until an expression is true; until then, it may throw.
    ///
    /// # Panics
    /// If it does not become so.
    pub fn wait(&mut self, expression: &str) {
        let began = Instant::now();
        loop {
            let found = self.attempt(expression);
            if found == Ok(json!(true)) {
                return;
            }
            assert!(found != Err(json!(ENDED)), "{ENDED}: {}", self.end());
            let (now, problems) = (began.elapsed(), &self.problems);
            assert!(now < PATIENCE, "never true: {expression}; last {found:?}; the page's problems: {problems:?}");
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Presses and releases a key.
    pub fn key(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            let text = if kind == "keyDown" && key.chars().count() == 1 { key } else { "" };
            self.call("Input.dispatchKeyEvent", json!({ "type": kind, "key": key, "text": text }));
        }
    }

    /// Moves fingers from points to points of the screen; each is [x, y].
    pub fn touch(&mut self, from: &[[f64; 2]], to: &[[f64; 2]]) {
        let points = |at: &[[f64; 2]]| -> Value {
            at.iter().enumerate().map(|(id, [x, y])| json!({ "x": x, "y": y, "id": id })).collect()
        };
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchStart", "touchPoints": points(from) }));
        for step in 1..=4 {
            let share = f64::from(step) / 4.0;
            let between = |(a, b): (&[f64; 2], &[f64; 2])| [0, 1].map(|k| a[k] + share * (b[k] - a[k]));
            let at: Vec<[f64; 2]> = from.iter().zip(to).map(between).collect();
            self.call("Input.dispatchTouchEvent", json!({ "type": "touchMove", "touchPoints": points(&at) }));
        }
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] }));
    }

    /// The window as a PNG in base64.
    pub fn screenshot(&mut self) -> String {
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        shot["data"].as_str().expect("a picture").to_owned()
    }

    /// Errors and warnings of the page so far, and its requests to the network.
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// Forgets the problems so far.
    pub fn forgive(&mut self) {
        self.problems.clear();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.end();
        // Its processes end a little later, and write until then.
        for _ in 0..40 {
            match fs::remove_dir_all(&self.folder) {
                Err(_) if self.folder.exists() => thread::sleep(Duration::from_millis(50)),
                _ => return,
            }
        }
    }
}
