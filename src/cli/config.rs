//! The configuration file of a user: `$XDG_CONFIG_HOME/tauflow/config.yaml`, or below `~/.config`.

use super::CliError;
use serde::Deserialize;
use std::{
    env, io,
    path::{Path, PathBuf},
};
use tauflow_contract::read_regular;
use tauflow_upstream::{Address, UpstreamError};

/// Most bytes of the file.
const MOST_BYTES: u64 = 1 << 20;

/// What the file may say.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Config {
    /// The upstream of every command that reads results.
    pub(crate) upstream: Option<String>,
    /// The public key that must have signed it, or its file.
    pub(crate) upstream_key: Option<String>,
    /// The commands of `--executor command`.
    pub(crate) command: Option<Commands>,
    /// The class of nodes on which jobs measure, or `local`.
    pub(crate) timing: Option<String>,
}

/// How jobs are given to a scheduler.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Commands {
    /// Submits a job.
    pub(crate) submit: Option<String>,
    /// Prints the states of jobs.
    pub(crate) poll: Option<String>,
    /// Cancels jobs.
    pub(crate) cancel: Option<String>,
}

impl Config {
    /// Reads the user's file; a missing file says nothing.
    pub(crate) fn read() -> Result<Self, CliError> {
        let folder = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let folder = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")));
        folder.map_or_else(|| Ok(Self::default()), |folder| Self::of(&folder.join("tauflow/config.yaml")))
    }

    fn of(path: &Path) -> Result<Self, CliError> {
        let wrong = |why: String| CliError::Bad(format!("the configuration `{}` is invalid: {why}", path.display()));
        let bytes = match read_regular(path, MOST_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                return Ok(Self::default());
            }
            // A home that is another user's, as programs that change users leave it, has no file of this user.
            Err(_) if path.symlink_metadata().is_err_and(|e| e.kind() == io::ErrorKind::PermissionDenied) => {
                return Ok(Self::default());
            }
            Err(error) => return Err(wrong(error.to_string())),
        };
        let text = String::from_utf8(bytes).map_err(|error| wrong(error.to_string()))?;
        if text.lines().all(|line| line.trim().is_empty() || line.trim().starts_with('#')) {
            return Ok(Self::default());
        }
        let config: Self = serde_saphyr::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        match config.upstream.as_deref().map(str::parse) {
            Some(Ok(Address::Folder(folder))) if !folder.is_absolute() && folder != Path::new("") => {
                Err(wrong(format!("`upstream: {}` must be an absolute path or a URL", folder.display())))
            }
            Some(Err(error)) => Err(wrong(UpstreamError::to_string(&error))),
            _ => Ok(config),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_names_an_upstream_and_nothing_unknown() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("config.yaml");
        let read = |text: &str| {
            std::fs::write(&path, text).expect("writable");
            Config::of(&path)
        };
        assert_eq!(Config::of(&path).expect("a missing file says nothing"), Config::default());
        assert_eq!(read("# nothing\n\n").expect("a comment says nothing"), Config::default());
        assert_eq!(read("upstream: /lab/tauflow\n").expect("valid").upstream.as_deref(), Some("/lab/tauflow"));
        let known = read("command: { submit: 'qsub {script}' }\n").expect("valid").command.expect("it is named");
        assert_eq!((known.submit.as_deref(), known.poll), (Some("qsub {script}"), None));
        for (text, part) in [
            ("upstream: lab\n", "must be an absolute path"),
            ("upstream: s3://me:secret@bucket\n", "credentials come from the environment"),
            ("upstreem: /lab\n", "upstreem"),
            ("- upstream\n", "config.yaml"),
        ] {
            let CliError::Bad(message) = read(text).expect_err(text) else { panic!("{text}") };
            assert!(message.contains(part) && message.contains("is invalid"), "{message}");
        }
    }
}
