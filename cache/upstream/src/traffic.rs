//! Counts requests to object stores, and names the variables that configure them.

use std::sync::Mutex;

/// Requests to an upstream so far, and their bytes without headers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Requests, repeated ones included.
    pub requests: u64,
    /// Bytes sent.
    pub sent: u64,
    /// Bytes received.
    pub received: u64,
}

/// The number of reads of a pack so far. The lock is held while it is read, so that no part is read twice.
pub(crate) type Reads = Mutex<u32>;

/// Whether an environment variable configures how an upstream is reached.
pub fn reads(variable: &str) -> bool {
    let beginnings = ["AWS_", "AZURE_", "GOOGLE_", "SSL_CERT_"];
    let proxies = ["HTTPS_PROXY", "HTTP_PROXY", "ALL_PROXY", "NO_PROXY"];
    variable == "HOME"
        || proxies.contains(&variable.to_ascii_uppercase().as_str())
        || beginnings.iter().any(|beginning| variable.starts_with(beginning))
}
