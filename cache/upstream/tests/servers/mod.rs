//! Servers for tests: S3 is `moto`, which a Python with that package runs; the web server is a few lines here.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Seek, SeekFrom, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicI64, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use tauflow_testing::{Need, set, skip};

/// A server of S3 with an empty bucket `lab`. It ends with this value.
pub struct S3 {
    child: Child,
    /// Its address.
    pub url: String,
}

impl S3 {
    /// None where no Python has `moto`. A server that checks keys knows none at all.
    pub fn start(checks: bool) -> Option<Self> {
        let Some(python) = set("TAUFLOW_MOTO") else {
            skip(Need::Moto, "TAUFLOW_MOTO names no Python with the package `moto`");
            return None;
        };
        // The port may be taken by somebody else in between; another is tried then.
        for _ in 0..5 {
            let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a free port").port();
            let mut command = Command::new(&python);
            command.args(["-c", "from moto.server import main; main()", "-H", "127.0.0.1", "-p", &port.to_string()]);
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
            if checks {
                command.env("INITIAL_NO_AUTH_ACTION_COUNT", "1");
            }
            let child = command.spawn().expect("TAUFLOW_MOTO names a Python");
            let server = Self { child, url: format!("http://127.0.0.1:{port}") };
            if server.makes_bucket(port) {
                return Some(server);
            }
        }
        panic!("the Python `{python}` does not start the server of `moto`");
    }

    fn makes_bucket(&self, port: u16) -> bool {
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_secs(60) {
            thread::sleep(Duration::from_millis(100));
            let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) else { continue };
            let request = "PUT /lab HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
            let mut answer = String::new();
            if stream.write_all(request.as_bytes()).and_then(|()| stream.read_to_string(&mut answer)).is_ok() {
                return answer.starts_with("HTTP/1.1 200");
            }
        }
        false
    }
}

impl Drop for S3 {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Files of a folder over HTTP, with ranges. It counts requests, and refuses all after the first few.
pub struct Web {
    /// The address of the folder.
    pub url: String,
    /// Requests so far.
    pub requests: Arc<AtomicU64>,
    /// Requests that are still answered.
    pub allowed: Arc<AtomicI64>,
}

impl Web {
    /// Serves a folder.
    pub fn serve(folder: PathBuf) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let url = format!("http://{}/shared", listener.local_addr().expect("it is bound"));
        let (requests, allowed) = (Arc::<AtomicU64>::default(), Arc::new(AtomicI64::new(i64::MAX)));
        let (counted, open) = (requests.clone(), allowed.clone());
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let (counted, open, folder) = (counted.clone(), open.clone(), folder.clone());
                thread::spawn(move || {
                    counted.fetch_add(1, Ordering::Relaxed);
                    // A server that is killed closes its connections without an answer.
                    if open.fetch_sub(1, Ordering::Relaxed) > 0 {
                        let _ = answer(stream, &folder);
                    }
                });
            }
        });
        Self { url, requests, allowed }
    }
}

fn answer(stream: TcpStream, folder: &Path) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream);
    let (mut line, mut range) = (String::new(), None);
    reader.read_line(&mut line)?;
    let path = line.split(' ').nth(1).unwrap_or_default().trim_start_matches("/shared/").to_owned();
    loop {
        line.clear();
        reader.read_line(&mut line)?;
        if let Some(asked) = line.to_ascii_lowercase().trim().strip_prefix("range: bytes=") {
            let (from, to) = asked.split_once('-').unwrap_or_default();
            range = Some((from.parse::<u64>().unwrap_or(0), to.parse::<u64>().unwrap_or(0)));
        }
        if line.trim().is_empty() {
            break;
        }
    }
    let mut stream = reader.into_inner();
    let Ok(mut file) = fs::File::open(folder.join(&path)) else {
        return stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
    };
    let size = file.metadata()?.len();
    let (from, to) = range.unwrap_or((0, size.saturating_sub(1)));
    let len = (to.min(size.saturating_sub(1)) + 1).saturating_sub(from);
    let head = match range {
        Some(_) => format!("206 Partial Content\r\nContent-Range: bytes {from}-{to}/{size}"),
        None => "200 OK".to_owned(),
    };
    let modified = "Last-Modified: Wed, 01 Jan 2025 00:00:00 GMT\r\nETag: \"x\"";
    write!(stream, "HTTP/1.1 {head}\r\n{modified}\r\nContent-Length: {len}\r\nConnection: close\r\n\r\n")?;
    file.seek(SeekFrom::Start(from))?;
    std::io::copy(&mut file.take(len), &mut stream).map(drop)
}
