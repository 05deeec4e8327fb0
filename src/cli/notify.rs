//! `run --notify URL`: tells a web service that a run has ended.
//!
//! HTTP is spoken here; for HTTPS the program `curl` is started, because no library for encryption is a dependency. A
//! message that does not arrive is a note, never an error of the run.

use crate::runs::{Outcome, RunRecord};
use serde_json::json;
use std::{
    io::{self, BufRead, BufReader, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    process::{Command, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

/// Time for the whole message.
const LIMIT: Duration = Duration::from_secs(10);
/// Bytes of the first line of an answer, at most.
const MOST_ANSWER: u64 = 4096;

/// Where to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Address {
    url: String,
    encrypted: bool,
    /// `HOST[:PORT]`, as written.
    authority: String,
    /// From the first slash on.
    path: String,
}

/// Reads a URL.
pub(super) fn address(text: &str) -> Result<Address, String> {
    let (encrypted, rest) = match (text.strip_prefix("http://"), text.strip_prefix("https://")) {
        (Some(rest), _) => (false, rest),
        (_, Some(rest)) => (true, rest),
        _ => return Err("it must begin with http:// or https://".into()),
    };
    if text.chars().any(|c| c.is_whitespace() || c.is_control() || !c.is_ascii()) {
        return Err("it holds signs that no URL has; write them as %20 and the like".into());
    }
    let rest = rest.split('#').next().unwrap_or_default();
    let end = rest.find(['/', '?']).unwrap_or(rest.len());
    let (authority, path) = rest.split_at(end);
    if authority.is_empty() || authority.starts_with(':') {
        return Err("it names no host".into());
    }
    if authority.contains('@') {
        return Err("names and passwords in URLs are not supported; put a token into the path".into());
    }
    let path = if path.starts_with('/') { path.to_owned() } else { format!("/{path}") };
    Ok(Address { url: text.to_owned(), encrypted, authority: authority.to_owned(), path })
}

impl Address {
    /// Scheme and host: the path may hold a token.
    fn public(&self) -> String {
        format!("http{}://{}/...", if self.encrypted { "s" } else { "" }, self.authority)
    }
}

/// A command line without what is secret in the URL.
pub(super) fn without_secret(command: Vec<String>, to: &Address) -> Vec<String> {
    command.into_iter().map(|word| word.replace(&to.url, &to.public())).collect()
}

/// The message that is sent.
fn message(record: &RunRecord) -> String {
    let first = record.failures.first().map(|failure| json!({ "action": failure.only(), "message": failure.message }));
    json!({
        "pipeline": record.pipeline,
        "id": record.id,
        "host": record.machine.host,
        "state": record.outcome,
        "seconds": record.elapsed_s,
        "ran": record.total(|node| node.ran),
        "failures": record.failed,
        "first_failure": first,
        "error": record.error,
    })
    .to_string()
}

/// Sends how a run ended; a note says why it did not arrive.
pub(super) fn send(to: &Address, record: &RunRecord) -> Option<String> {
    if record.outcome == Outcome::Running {
        return None;
    }
    post(to, message(record), LIMIT).err().map(|why| format!("{} was not notified: {why}", to.public()))
}

/// Posts a body within a time limit, which holds for the look-up of the name, too.
fn post(to: &Address, body: String, limit: Duration) -> Result<(), String> {
    let (tell, told) = mpsc::channel();
    let address = to.clone();
    let asking = thread::Builder::new().spawn(move || {
        let sent = if address.encrypted { by_curl(&address, &body, limit) } else { plainly(&address, &body, limit) };
        // Nobody waits any longer.
        drop(tell.send(sent));
    });
    asking.map_err(|error| format!("no thread can be started: {error}"))?;
    told.recv_timeout(limit).unwrap_or_else(|_| Err(format!("no answer within {} s", limit.as_secs_f64())))
}

fn plainly(to: &Address, body: &str, limit: Duration) -> Result<(), String> {
    // The port, unless one follows the host; an IPv6 address stands in brackets.
    let named = to.authority.rsplit_once(':').is_some_and(|(_, port)| !port.is_empty() && !port.contains(']'));
    let host = to.authority.trim_end_matches(':');
    let socket = if named { host.to_owned() } else { format!("{host}:80") };
    let told = |error: io::Error| error.to_string();
    let mut last = "the name has no address".to_owned();
    for address in socket.to_socket_addrs().map_err(told)? {
        let mut stream = match TcpStream::connect_timeout(&address, limit) {
            Ok(stream) => stream,
            Err(error) => {
                last = error.to_string();
                continue;
            }
        };
        stream.set_read_timeout(Some(limit)).and_then(|()| stream.set_write_timeout(Some(limit))).map_err(told)?;
        let head = format!(
            "POST {} HTTP/1.1\r\nHost: {}\r\nUser-Agent: tauflow/{}\r\nContent-Type: application/json\r\n\
             Content-Length: {}\r\nConnection: close\r\n\r\n",
            to.path,
            to.authority,
            env!("CARGO_PKG_VERSION"),
            body.len()
        );
        stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(body.as_bytes())).map_err(told)?;
        let mut answer = Vec::new();
        BufReader::new(stream.take(MOST_ANSWER)).read_until(b'\n', &mut answer).map_err(told)?;
        let answer = String::from_utf8_lossy(&answer).trim().to_owned();
        return match answer.split(' ').nth(1) {
            Some(status) if answer.starts_with("HTTP/") && status.starts_with('2') => Ok(()),
            _ if answer.is_empty() => Err("the connection was closed without an answer".into()),
            _ => Err(format!("the answer was `{}`", answer.chars().take(100).collect::<String>())),
        };
    }
    Err(last)
}

fn by_curl(to: &Address, body: &str, limit: Duration) -> Result<(), String> {
    let mut curl = Command::new("curl");
    curl.args(["--silent", "--show-error", "--fail", "--proto", "=https", "--request", "POST"]);
    curl.args(["--header", "Content-Type: application/json", "--data-binary", "@-"]);
    curl.args(["--max-time", &limit.as_secs().max(1).to_string(), "--output", "/dev/null", "--url", &to.url]);
    let mut child =
        curl.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().map_err(|error| match error
            .kind()
        {
            io::ErrorKind::NotFound => "https needs the program `curl`, which is not installed".to_owned(),
            _ => format!("curl cannot be started: {error}"),
        })?;
    if let Some(mut stdin) = child.stdin.take() {
        // Its exit status says what came of it.
        let _ = stdin.write_all(body.as_bytes());
    }
    let output = child.wait_with_output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(());
    }
    Err(String::from_utf8_lossy(&output.stderr).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{net::TcpListener, time::Instant};

    /// A server that answers once; what it was asked.
    fn server(answer: &'static str) -> (String, thread::JoinHandle<String>) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("bound").port();
        let serving = thread::spawn(move || {
            let (mut stream, _) = listener.accept().expect("a client");
            let mut asked = Vec::new();
            let mut chunk = [0; 1024];
            while !String::from_utf8_lossy(&asked).ends_with('}') {
                match stream.read(&mut chunk).expect("readable") {
                    0 => break,
                    count => asked.extend(&chunk[..count]),
                }
            }
            stream.write_all(answer.as_bytes()).expect("writable");
            String::from_utf8_lossy(&asked).into_owned()
        });
        (format!("http://127.0.0.1:{port}/hook?token=1"), serving)
    }

    #[test]
    fn urls_are_read_or_refused() {
        let of = |text: &str| address(text).map(|a| (a.authority, a.path, a.encrypted));
        assert_eq!(of("http://h:8/a?b#c"), Ok(("h:8".into(), "/a?b".into(), false)));
        assert_eq!(of("https://h?b"), Ok(("h".into(), "/?b".into(), true)));
        for bad in ["h/a", "ftp://h", "http://", "http://:80/", "http://u:p@h/", "http://h/a b", "http://h/\r\nX: y"] {
            assert!(of(bad).is_err(), "{bad}");
        }
        let to = address("http://h/secret").expect("a URL");
        let words = vec!["run".into(), "--notify=http://h/secret".into()];
        assert_eq!(without_secret(words, &to), ["run", "--notify=http://h/..."]);
    }

    #[test]
    fn a_body_is_posted_and_only_success_counts() {
        let (url, serving) = server("HTTP/1.1 204 No Content\r\n\r\n");
        let body = || "{\"a\":1}".to_owned();
        assert_eq!(post(&address(&url).expect("a URL"), body(), LIMIT), Ok(()));
        let asked = serving.join().expect("it served");
        assert!(asked.starts_with("POST /hook?token=1 HTTP/1.1\r\nHost: 127.0.0.1:"), "{asked}");
        assert!(asked.contains("Content-Length: 7\r\n") && asked.ends_with("\r\n\r\n{\"a\":1}"), "{asked}");
        let (url, _serving) = server("HTTP/1.1 500 Oh\r\n\r\n");
        let said = post(&address(&url).expect("a URL"), body(), LIMIT);
        assert_eq!(said, Err("the answer was `HTTP/1.1 500 Oh`".into()));
    }

    #[test]
    fn a_server_that_is_silent_costs_the_time_limit_and_no_more() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}/", listener.local_addr().expect("bound"));
        let start = Instant::now();
        let said = post(&address(&url).expect("a URL"), "{}".into(), Duration::from_millis(200));
        assert!(said.is_err() && start.elapsed() < LIMIT, "{said:?}");
    }
}
