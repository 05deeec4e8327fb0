//! Addresses of upstreams: directories, and URLs of object stores.

use crate::UpstreamError;
use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// Where an upstream is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A directory.
    Folder(PathBuf),
    /// A prefix in an object store, or a directory of a web server.
    Objects(ObjectsAt),
}

/// A prefix in an object store, or a directory of a web server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectsAt {
    pub(crate) service: Service,
    /// The bucket or container; for a web server, the host with its port.
    pub(crate) bucket: String,
    /// The path, without slashes at its ends.
    pub(crate) prefix: String,
}

/// The protocol of an object store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Service {
    S3,
    Google,
    Azure,
    /// A web server that serves files. It cannot be written.
    Https,
    /// The same without encryption, on this machine.
    Http,
}

const SERVICES: [(&str, Service); 5] = [
    ("s3", Service::S3),
    ("gs", Service::Google),
    ("az", Service::Azure),
    ("https", Service::Https),
    ("http", Service::Http),
];

/// Whether a host, with or without a port, is this machine.
pub(crate) fn is_loopback(host: &str) -> bool {
    let bare = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    bare == "localhost" || bare.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

impl FromStr for Address {
    type Err = UpstreamError;

    fn from_str(text: &str) -> Result<Self, UpstreamError> {
        // The text is not repeated where it may contain a password.
        let wrong = |why: String| UpstreamError::Address { why };
        let Some((scheme, rest)) = text.split_once("://") else {
            if let Some((name, _)) = SERVICES.iter().find(|(name, _)| text.starts_with(&format!("{name}:"))) {
                return Err(wrong(format!(
                    "a URL begins with `{name}://`; for a directory of this name, write `./{name}:`"
                )));
            }
            return Ok(Self::Folder(PathBuf::from(text)));
        };
        if rest.contains(['@', '?', '#']) {
            return Err(wrong(format!(
                "the URL ({scheme}://...) contains `@`, `?` or `#`; credentials come from the environment only, see \
                 docs/many_machines.md"
            )));
        }
        let Some((_, service)) = SERVICES.iter().find(|(name, _)| *name == scheme) else {
            return Err(wrong(format!(
                "`{text}` has the unknown scheme `{scheme}`; give a directory, s3://BUCKET/PREFIX, gs://BUCKET/PREFIX, \
                 az://CONTAINER/PREFIX or https://HOST/PATH"
            )));
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let prefix = prefix.trim_matches('/');
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.:[]".contains(c);
        if bucket.is_empty() || !bucket.chars().all(is_plain) {
            return Err(wrong(format!("`{text}` names no bucket or host after `://`")));
        }
        let is_segment = |segment: &str| {
            !matches!(segment, "" | "." | "..")
                && segment.chars().all(|c| c.is_ascii_graphic() && !"\\%*\"<>".contains(c))
        };
        if !prefix.is_empty() && !prefix.split('/').all(is_segment) {
            return Err(wrong(format!(
                "`{text}` has a path that is not usable: use names of ASCII letters, digits and `-_.`, without `..`"
            )));
        }
        if *service == Service::Http && !is_loopback(bucket) {
            return Err(wrong(format!("`{text}` is not encrypted; use https://, http:// is for this machine only")));
        }
        Ok(Self::Objects(ObjectsAt { service: *service, bucket: bucket.to_owned(), prefix: prefix.to_owned() }))
    }
}

impl fmt::Display for ObjectsAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = SERVICES.iter().find(|(_, service)| *service == self.service).map_or("", |(name, _)| name);
        write!(f, "{name}://{}", self.bucket)?;
        if self.prefix.is_empty() { Ok(()) } else { write!(f, "/{}", self.prefix) }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder(folder) => folder.display().fmt(f),
            Self::Objects(at) => at.fmt(f),
        }
    }
}

impl From<&Path> for Address {
    fn from(folder: &Path) -> Self {
        Self::Folder(folder.to_owned())
    }
}

impl Address {
    /// Its directory, if it is one.
    pub fn folder(&self) -> Option<&Path> {
        match self {
            Self::Folder(folder) => Some(folder),
            Self::Objects(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_directories_or_urls_without_credentials() {
        let of = |text: &str| text.parse::<Address>();
        assert_eq!(of("/lab/shared").ok(), Some(Address::Folder("/lab/shared".into())));
        for (text, name) in [
            ("s3://bucket/a/b/", "s3://bucket/a/b"),
            ("gs://bucket", "gs://bucket"),
            ("az://container/x", "az://container/x"),
            ("https://lab.example:8443/data", "https://lab.example:8443/data"),
            ("http://127.0.0.1:80/x", "http://127.0.0.1:80/x"),
            ("http://localhost:9", "http://localhost:9"),
            ("http://[::1]:9", "http://[::1]:9"),
        ] {
            let address = of(text).expect(text);
            assert_eq!((address.to_string().as_str(), address.folder()), (name, None));
        }
        for (text, part) in [
            ("s3://key:secret@bucket/x", "credentials come from the environment"),
            ("https://lab/x?sig=secret", "credentials come from the environment"),
            ("ftp://lab/x", "unknown scheme `ftp`"),
            ("s3:/bucket/x", "begins with `s3://`"),
            ("s3:///x", "no bucket"),
            ("s3://bucket/a/../b", "not usable"),
            ("s3://bucket/a//b", "not usable"),
            ("http://lab.example/x", "not encrypted"),
            ("http://127.0.0.1.evil.example/x", "not encrypted"),
        ] {
            let error = of(text).expect_err(text).to_string();
            assert!(error.contains(part) && !error.contains("secret"), "{error}");
        }
    }
}
