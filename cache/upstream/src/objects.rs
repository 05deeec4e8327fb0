//! An upstream in an object store or on a web server, through the crate `object_store`. Knows no contents.
//!
//! Credentials come from the environment, as each service documents it. No error repeats what a server answered,
//! because that may contain tokens.

use crate::{
    UpstreamError,
    address::{ObjectsAt, Service},
    error::Failure,
    http::Client,
    parts::Parts,
    traffic::{Reads, Traffic},
};
use bytes::Bytes;
use object_store::{
    BackoffConfig, Error, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload, RetryConfig,
    aws::AmazonS3Builder, azure::MicrosoftAzureBuilder, gcp::GoogleCloudStorageBuilder, http::HttpBuilder, path::Path,
};
use std::{
    collections::VecDeque,
    future::Future,
    ops::Range,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tauflow_cache::Digest;

/// Attempts after the first one, and how long they go on. Waits begin at 0.2 s and double.
const RETRIES: usize = 5;
const RETRY_FOR: Duration = Duration::from_secs(60);
/// Files above this size are sent in parts of this size. Each part is repeated alone if it fails.
const PART: usize = 64 << 20;
/// The first read of a pack, and the largest one. Reads of a pack grow, because the blobs of a run lie together.
const FIRST_READ: u64 = 256 << 10;
const LARGEST_READ: u64 = 8 << 20;
/// Packs up to this size are read whole.
const READ_WHOLE: u64 = 1 << 20;

/// Waits for an answer. Requests are made by this thread, so the runtime only has to wait between attempts.
fn wait<T>(future: impl Future<Output = Result<T, Error>>) -> Result<T, Error> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build();
    let runtime = runtime.map_err(|error| Error::Generic { store: "upstream", source: Box::new(error) })?;
    runtime.block_on(future)
}

/// The files of an upstream in an object store.
#[derive(Debug)]
pub(crate) struct Objects {
    at: ObjectsAt,
    store: Arc<dyn ObjectStore>,
    client: Client,
    /// Parts of packs that were read.
    parts: Mutex<Parts>,
}

impl Objects {
    /// Connects to nothing yet.
    ///
    /// # Errors
    /// When the environment configures the service in a way that cannot be used.
    pub fn new(at: &ObjectsAt) -> Result<Self, UpstreamError> {
        let client = Client::new();
        let backoff = BackoffConfig { init_backoff: Duration::from_millis(200), ..BackoffConfig::default() };
        let retry = RetryConfig { backoff, max_retries: RETRIES, retry_timeout: RETRY_FOR };
        let connector = client.clone();
        let store: Result<Arc<dyn ObjectStore>, Error> = match at.service {
            Service::S3 => AmazonS3Builder::from_env()
                .with_bucket_name(&at.bucket)
                .with_retry(retry)
                .with_http_connector(connector)
                .build()
                .map(|store| Arc::new(store) as _),
            Service::Google => GoogleCloudStorageBuilder::from_env()
                .with_bucket_name(&at.bucket)
                .with_retry(retry)
                .with_http_connector(connector)
                .build()
                .map(|store| Arc::new(store) as _),
            Service::Azure => MicrosoftAzureBuilder::from_env()
                .with_container_name(&at.bucket)
                .with_retry(retry)
                .with_http_connector(connector)
                .build()
                .map(|store| Arc::new(store) as _),
            Service::Https | Service::Http => HttpBuilder::new()
                .with_url(ObjectsAt { prefix: String::new(), ..at.clone() }.to_string())
                .with_retry(retry)
                .with_http_connector(connector)
                .build()
                .map(|store| Arc::new(store) as _),
        };
        let store = store.map_err(|_| UpstreamError::Remote {
            action: "use",
            place: at.to_string(),
            why: "the environment does not configure this service completely; see docs/many_machines.md".to_owned(),
        })?;
        Ok(Self { at: at.clone(), store, client, parts: Mutex::default() })
    }

    pub fn at(&self) -> &ObjectsAt {
        &self.at
    }

    pub fn traffic(&self) -> Traffic {
        self.client.traffic()
    }

    /// Whether it is a web server, which lists nothing and is not written.
    pub fn is_web(&self) -> bool {
        matches!(self.at.service, Service::Https | Service::Http)
    }

    fn path(&self, name: &str) -> Path {
        Path::from_iter(self.at.prefix.split('/').chain(name.split('/')).filter(|part| !part.is_empty()))
    }

    /// The URL of a file.
    pub fn url(&self, name: &str) -> String {
        format!("{}/{name}", self.at)
    }

    /// The meaning of an error. It repeats no text of the server.
    fn why(&self, error: &Error) -> String {
        let failed = self.client.failed();
        let failed = failed.map_or_else(String::new, |failed| format!(" ({failed})"));
        match error {
            Error::NotFound { .. } => format!("it is not there{failed}"),
            Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
                format!("access is denied{failed}; check the credentials in the environment")
            }
            Error::NotSupported { .. } | Error::NotImplemented { .. } => {
                format!("the server does not support it{failed}")
            }
            _ if failed.is_empty() => "no request could be made; check the credentials in the environment".to_owned(),
            _ if failed.contains("169.254.") || failed.contains("metadata.google") => {
                format!("the environment has no credentials, and the machine offers none{failed}")
            }
            _ => format!("the request failed{failed}"),
        }
    }

    pub fn error(&self, action: &'static str, error: &Error) -> UpstreamError {
        UpstreamError::Remote { action, place: self.at.to_string(), why: self.why(error) }
    }

    /// Whether one file is not there, or all of it fails.
    fn failure(&self, name: &str, error: &Error) -> Failure {
        let text = format!("`{}` cannot be read: {}", self.url(name), self.why(error));
        match error {
            Error::NotFound { .. } | Error::NotSupported { .. } | Error::InvalidPath { .. } => Failure::File(text),
            _ => Failure::Place(text),
        }
    }

    /// A small file, if it is there.
    pub fn small(&self, name: &str) -> Result<Option<Vec<u8>>, UpstreamError> {
        let path = self.path(name);
        match wait(async { self.store.get(&path).await?.bytes().await }) {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            // A bucket that is missing is not an empty one.
            Err(Error::NotFound { .. }) if !self.client.failed().is_some_and(|f| f.contains("NoSuchBucket")) => {
                Ok(None)
            }
            Err(error) => Err(self.error("read", &error)),
        }
    }

    /// The names of all files, from the upstream's root.
    pub fn names(&self) -> Result<Vec<String>, UpstreamError> {
        let mut all = Vec::new();
        for folder in ["", "packs"] {
            let prefix = self.path(folder);
            let prefix = (!prefix.as_ref().is_empty()).then_some(&prefix);
            let found = wait(self.store.list_with_delimiter(prefix)).map_err(|error| self.error("list", &error))?;
            let name =
                |path: &Path| path.as_ref().strip_prefix(&self.at.prefix).map(|n| n.trim_matches('/').to_owned());
            all.extend(found.objects.iter().filter_map(|object| name(&object.location)));
            if folder.is_empty() {
                all.extend(found.common_prefixes.iter().filter_map(name).filter(|name| name != "packs"));
            }
        }
        Ok(all)
    }

    /// The names of the files in `packs`, and their sizes.
    pub fn packs(&self) -> Result<Vec<(String, u64)>, UpstreamError> {
        let prefix = self.path("packs");
        let found = wait(self.store.list_with_delimiter(Some(&prefix))).map_err(|error| self.error("list", &error))?;
        let named = |object: &object_store::ObjectMeta| Some((object.location.filename()?.to_owned(), object.size));
        Ok(found.objects.iter().filter_map(named).collect())
    }

    /// All bytes of a file.
    pub fn whole(&self, name: &str) -> Result<Vec<u8>, Failure> {
        let path = self.path(name);
        let read = wait(async { self.store.get(&path).await?.bytes().await });
        read.map(|bytes| bytes.to_vec()).map_err(|error| self.failure(name, &error))
    }

    fn range(&self, name: &str, range: Range<u64>) -> Result<Bytes, Failure> {
        let path = self.path(name);
        wait(self.store.get_range(&path, range)).map_err(|error| self.failure(name, &error))
    }

    /// A range of a pack. Small ranges are read together with what lies around them, which waits in a directory.
    pub fn read(
        &self,
        pack: &Digest,
        reads: &Reads,
        range: Range<u64>,
        folder: Option<&std::path::Path>,
    ) -> Result<Vec<u8>, Failure> {
        let name = format!("packs/{pack}.pack");
        if range.end - range.start >= LARGEST_READ / 2 {
            return self.range(&name, range).map(|bytes| bytes.to_vec());
        }
        let mut reads = reads.lock().unwrap_or_else(PoisonError::into_inner);
        let parts = || self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = parts().get(pack, &range) {
            return Ok(found);
        }
        let len = if pack.size <= READ_WHOLE { READ_WHOLE } else { (FIRST_READ << (*reads).min(20)).min(LARGEST_READ) };
        let start = parts().unread(pack, range.start).unwrap_or(0).max(range.start - range.start % len);
        let end = (start + len).max(range.end).min(pack.size);
        *reads += 1;
        let bytes = self.range(&name, start..end)?;
        let (from, to) = ((range.start - start) as usize, (range.end - start) as usize);
        if bytes.len() < to {
            return Err(Failure::File(format!("`{}` is truncated", self.url(&name))));
        }
        let found = bytes.slice(from..to).to_vec();
        parts().keep(*pack, start, bytes, folder);
        Ok(found)
    }

    /// Writes a file that never changes, unless it is there. A file is visible once it is complete.
    pub fn seal(&self, name: &str, chunks: Vec<Vec<u8>>) -> Result<(), UpstreamError> {
        if self.is_web() {
            return Err(UpstreamError::Remote {
                action: "write to",
                place: self.at.to_string(),
                why: "a web server is for reading only; push to the directory or bucket behind it".to_owned(),
            });
        }
        let path = self.path(name);
        let size: usize = chunks.iter().map(Vec::len).sum();
        let chunks: Vec<Bytes> = chunks.into_iter().map(Bytes::from).collect();
        if size > PART {
            return wait(self.in_parts(&path, chunks)).map_err(|error| self.error("write to", &error));
        }
        let payload: PutPayload = chunks.into_iter().collect();
        let put = |mode: PutMode| wait(self.store.put_opts(&path, payload.clone(), PutOptions::from(mode)));
        match put(PutMode::Create) {
            Ok(_) => Ok(()),
            Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => {
                // A truncated one is written again. The name is the digest of the content, so nothing is lost.
                match wait(self.store.head(&path)) {
                    Ok(there) if there.size != size as u64 => {
                        put(PutMode::Overwrite).map(drop).map_err(|error| self.error("write to", &error))
                    }
                    _ => Ok(()),
                }
            }
            // A service without conditional writes.
            Err(Error::NotImplemented { .. } | Error::NotSupported { .. }) => {
                put(PutMode::Overwrite).map(drop).map_err(|error| self.error("write to", &error))
            }
            Err(error) => Err(self.error("write to", &error)),
        }
    }

    /// Writes a file that may change.
    pub fn replace(&self, name: &str, content: Vec<u8>) -> Result<(), UpstreamError> {
        let put = wait(self.store.put(&self.path(name), content.into()));
        put.map(drop).map_err(|error| self.error("write to", &error))
    }

    /// Deletes a file.
    pub fn delete(&self, name: &str) {
        let _ = wait(self.store.delete(&self.path(name))); // it may never have been written
    }

    async fn in_parts(&self, path: &Path, chunks: Vec<Bytes>) -> Result<(), Error> {
        let mut upload = self.store.put_multipart(path).await?;
        let mut open: VecDeque<Bytes> = chunks.into();
        while !open.is_empty() {
            let (mut part, mut room) = (Vec::new(), PART);
            while let Some(mut chunk) = open.pop_front() {
                let rest = chunk.split_off(chunk.len().min(room));
                room -= chunk.len();
                part.push(chunk);
                if !rest.is_empty() {
                    open.push_front(rest);
                    break;
                }
            }
            if let Err(error) = upload.put_part(part.into_iter().collect()).await {
                // Parts that nobody completes cost storage.
                let _ = upload.abort().await;
                return Err(error);
            }
        }
        upload.complete().await.map(drop)
    }
}
