//! HTTP for `object_store`, by `ureq`: requests with time limits, one after the other in each thread. It counts
//! requests and bytes, and remembers in plain words what failed last, without headers, queries and bodies of requests.

use crate::{address::is_loopback, traffic::Traffic};
use async_trait::async_trait;
use http::{HeaderValue, Method, header::CONTENT_LENGTH};
use http_body::Body as _;
use object_store::{
    ClientOptions,
    client::{
        HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody, HttpResponse, HttpService,
    },
};
use std::{
    collections::VecDeque,
    fmt,
    io::{self, Read},
    pin::Pin,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll, Waker},
    time::Duration,
};
use ureq::{
    Agent, SendBody,
    tls::{RootCerts, TlsConfig},
};

/// Time limits: for finding and reaching a host, for the begin of an answer, and for any progress of a body.
const CONNECT: Duration = Duration::from_secs(5);
const ANSWER: Duration = Duration::from_secs(60);
const PROGRESS: Duration = Duration::from_secs(30);
/// Most bytes of an answer. The longest file that is read whole is an index.
const MOST_ANSWER: u64 = (1 << 30) + (1 << 20);
/// Most bytes of a refusal that are looked at.
const MOST_REFUSAL: usize = 1 << 16;
/// Hosts from which machines in a data centre get their credentials, without encryption.
const METADATA: [&str; 4] = ["169.254.169.254", "169.254.170.2", "169.254.170.23", "metadata.google.internal"];

/// A client that all requests of an upstream share.
#[derive(Clone)]
pub(crate) struct Client(Arc<Shared>);

struct Shared {
    agent: Agent,
    /// Whether any host may be asked without encryption.
    plain: bool,
    requests: AtomicU64,
    sent: AtomicU64,
    received: AtomicU64,
    failed: Mutex<Option<String>>,
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Client").field(&self.traffic()).finish()
    }
}

/// Chunks that are read one after the other.
struct Chunks(VecDeque<bytes::Bytes>);

impl Read for Chunks {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        while let Some(first) = self.0.front_mut() {
            if first.is_empty() {
                self.0.pop_front();
                continue;
            }
            let n = first.len().min(to.len());
            to[..n].copy_from_slice(&first.split_to(n));
            return Ok(n);
        }
        Ok(0)
    }
}

/// The chunks of a body. All of it is in memory, so nothing is waited for.
fn chunks(mut body: HttpRequestBody) -> Result<Chunks, HttpError> {
    let mut context = Context::from_waker(Waker::noop());
    let mut chunks = VecDeque::new();
    while let Poll::Ready(Some(frame)) = Pin::new(&mut body).poll_frame(&mut context) {
        if let Ok(data) = frame?.into_data() {
            chunks.push_back(data);
        }
    }
    Ok(Chunks(chunks))
}

/// The code by which an object store names the reason of a refusal. The rest of its answer may repeat tokens.
fn code(refusal: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(refusal);
    let (_, after) = text.split_once("<Code>")?;
    let (code, _) = after.split_once("</Code>")?;
    let plain = !code.is_empty() && code.len() <= 60 && code.chars().all(|c| c.is_ascii_alphanumeric());
    plain.then(|| code.to_owned())
}

/// Whether a failure may pass by itself, and in plain words what it is.
fn told(error: &ureq::Error) -> (HttpErrorKind, String) {
    let kind = match error {
        ureq::Error::Timeout(_) => HttpErrorKind::Timeout,
        ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => HttpErrorKind::Connect,
        ureq::Error::Io(error) if error.kind() == io::ErrorKind::ConnectionRefused => HttpErrorKind::Connect,
        ureq::Error::Io(_) => HttpErrorKind::Interrupted,
        ureq::Error::Protocol(_) => HttpErrorKind::Request,
        ureq::Error::BodyExceedsLimit(_) => HttpErrorKind::Decode,
        _ => HttpErrorKind::Unknown,
    };
    let text = match error {
        ureq::Error::Timeout(_) => "no answer within the time limit".to_owned(),
        ureq::Error::HostNotFound => "the host is unknown".to_owned(),
        ureq::Error::Io(error) => error.to_string(),
        ureq::Error::BadUri(_) => "the address is not valid".to_owned(),
        other => other.to_string(),
    };
    (kind, text)
}

impl Client {
    pub fn new() -> Self {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let tls = TlsConfig::builder()
            .root_certs(RootCerts::PlatformVerifier)
            .unversioned_rustls_crypto_provider(provider)
            .build();
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .tls_config(tls)
            .user_agent(concat!("tauflow/", env!("CARGO_PKG_VERSION")))
            .timeout_resolve(Some(CONNECT))
            .timeout_connect(Some(CONNECT))
            .timeout_recv_response(Some(ANSWER))
            .timeout_per_read(Some(PROGRESS))
            .timeout_per_write(Some(PROGRESS))
            .build();
        let plain = std::env::var("AWS_ALLOW_HTTP").is_ok_and(|value| value == "true" || value == "1");
        Self(Arc::new(Shared {
            agent: config.new_agent(),
            plain,
            requests: AtomicU64::new(0),
            sent: AtomicU64::new(0),
            received: AtomicU64::new(0),
            failed: Mutex::default(),
        }))
    }

    pub fn traffic(&self) -> Traffic {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Traffic { requests: of(&self.0.requests), sent: of(&self.0.sent), received: of(&self.0.received) }
    }

    /// In plain words, what failed last.
    pub fn failed(&self) -> Option<String> {
        self.0.failed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn note(&self, what: String) {
        *self.0.failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(what);
    }

    fn send(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (mut head, body) = request.into_parts();
        let host = head.uri.host().unwrap_or_default().to_owned();
        let fail = |kind: HttpErrorKind, what: String| {
            let what = format!("{host}: {what}");
            self.note(what.clone());
            Err(HttpError::new(kind, io::Error::other(what)))
        };
        let encrypted = head.uri.scheme_str() == Some("https");
        if !encrypted && !self.0.plain && !is_loopback(&host) && !METADATA.contains(&host.as_str()) {
            let what = "it would be asked without encryption; use https, or set AWS_ALLOW_HTTP=true";
            return fail(HttpErrorKind::Unknown, what.to_owned());
        }
        let length = body.content_length();
        self.0.requests.fetch_add(1, Ordering::Relaxed);
        self.0.sent.fetch_add(length as u64, Ordering::Relaxed);
        let answer = if length > 0 || matches!(head.method, Method::PUT | Method::POST) {
            head.headers.insert(CONTENT_LENGTH, HeaderValue::from(length));
            let body = SendBody::from_owned_reader(chunks(body)?);
            self.0.agent.run(http::Request::from_parts(head, body))
        } else {
            head.headers.remove(CONTENT_LENGTH);
            self.0.agent.run(http::Request::from_parts(head, ()))
        };
        let read = answer.and_then(|mut answer| {
            let bytes = answer.body_mut().with_config().limit(MOST_ANSWER).read_to_vec()?;
            Ok((answer.into_parts().0, bytes))
        });
        let (head, bytes) = match read {
            Ok(read) => read,
            Err(error) => {
                let (kind, what) = told(&error);
                return fail(kind, what);
            }
        };
        self.0.received.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        if !head.status.is_success() {
            let code = code(&bytes[..bytes.len().min(MOST_REFUSAL)]);
            self.note(format!("{host}: {}{}", head.status, code.map_or_else(String::new, |code| format!(" ({code})"))));
        }
        Ok(HttpResponse::from_parts(head, bytes.into()))
    }
}

#[async_trait]
impl HttpService for Client {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        self.send(request)
    }
}

impl HttpConnector for Client {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_tells_its_code_and_nothing_else() {
        let refusal = b"<Error><Code>SignatureDoesNotMatch</Code><CanonicalRequest>token</CanonicalRequest></Error>";
        assert_eq!(code(refusal).as_deref(), Some("SignatureDoesNotMatch"));
        assert_eq!((code(b"<Code>a token: x</Code>"), code(b"<Code>"), code(b"no")), (None, None, None));
    }

    #[test]
    fn chunks_are_read_in_order_whatever_the_size_of_the_reads() {
        let parts: [&'static [u8]; 4] = [b"one", b"", b"two", b"three"];
        let payload: object_store::PutPayload = parts.iter().map(|part| bytes::Bytes::from_static(part)).collect();
        let mut reader = chunks(payload.into()).expect("it is in memory");
        let (mut all, mut buffer) = (Vec::new(), [0; 2]);
        while let Ok(n @ 1..) = reader.read(&mut buffer) {
            all.extend_from_slice(&buffer[..n]);
        }
        assert_eq!(all, b"onetwothree");
    }

    #[test]
    fn other_hosts_are_not_asked_without_encryption() {
        let client = Client::new();
        let request = http::Request::get("http://lab.example/x?secret").body(HttpRequestBody::empty()).expect("valid");
        assert!(client.send(request).is_err() || client.0.plain);
        let failed = client.failed().unwrap_or_default();
        assert!(client.0.plain || failed.contains("without encryption") && !failed.contains("secret"), "{failed}");
        assert_eq!(client.traffic().requests, u64::from(client.0.plain));
    }
}
