//! Keys and signatures of indices, in the format of `minisign`.
//!
//! An index names its pack, its blobs and its records by digest. Its signature therefore covers all that it lists.
//! Secret keys have a format of their own, because they are made and used here only.

use crate::{UpstreamError, error::At, folder::read_plain};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use ring::{
    rand::{SecureRandom, SystemRandom},
    signature::{Ed25519KeyPair, KeyPair},
};
use std::{
    fmt,
    fs::OpenOptions,
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// The algorithm of keys and signatures: Ed25519 over the message itself.
const ALGORITHM: &[u8; 2] = b"Ed";
/// The beginning of a secret key.
const SECRET: &[u8; 8] = b"tauflow1";
/// More than a key file or a signature has.
pub(crate) const MOST_BYTES: u64 = 4096;

/// The public key by which the indices of an upstream are verified.
#[derive(Clone, Debug)]
pub struct PublicKey {
    /// As `minisign` writes it.
    text: String,
    key: minisign_verify::PublicKey,
}

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for PublicKey {
    type Err = UpstreamError;

    /// Reads a key, or the text of a file with a comment and a key.
    fn from_str(text: &str) -> Result<Self, UpstreamError> {
        let line = text.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default();
        let wrong = || UpstreamError::Key {
            what: "public key",
            why:
                "it is not 56 letters and digits that begin with RW, as `tauflow cache keygen` and `minisign -G` print"
                    .to_owned(),
        };
        let key = minisign_verify::PublicKey::from_base64(line).map_err(|_| wrong())?;
        Ok(Self { text: line.to_owned(), key })
    }
}

impl PublicKey {
    /// Reads a key that is given itself, or as the path of its file.
    ///
    /// # Errors
    /// When it is neither.
    pub fn given(text: &str) -> Result<Self, UpstreamError> {
        let path = Path::new(text);
        if !path.is_file() {
            return text.parse();
        }
        let bytes = read_plain(path, MOST_BYTES).at("read the public key", path)?;
        String::from_utf8_lossy(&bytes).parse()
    }

    /// Whether a signature is one of this key for a message.
    pub(crate) fn verifies(&self, message: &[u8], signature: &[u8]) -> bool {
        let text = String::from_utf8_lossy(signature);
        minisign_verify::Signature::decode(&text).is_ok_and(|of| self.key.verify(message, &of, true).is_ok())
    }
}

/// A key that signs indices.
pub struct SecretKey {
    id: [u8; 8],
    pair: Ed25519KeyPair,
}

impl fmt::Debug for SecretKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SecretKey").finish_non_exhaustive()
    }
}

impl SecretKey {
    /// Makes a key. It is written to this file, which only its owner may read, and its public key to a file beside it.
    /// Gives the public key and its file.
    ///
    /// # Errors
    /// When a file cannot be written, or is there already.
    pub fn generate(path: &Path) -> Result<(PublicKey, PathBuf), UpstreamError> {
        let (random, mut id) = (SystemRandom::new(), [0; 8]);
        let no_entropy = |_| UpstreamError::Key { what: "secret key", why: "the system gives no random bytes".into() };
        random.fill(&mut id).map_err(no_entropy)?;
        let pair = Ed25519KeyPair::generate_pkcs8(&random).map_err(no_entropy)?;
        let bytes = [SECRET.as_slice(), &id, pair.as_ref()].concat();
        let secret = format!("untrusted comment: tauflow secret key, keep it private\n{}\n", STANDARD.encode(&bytes));
        let public = Self::parse(&secret)?.public()?;
        let refused = |path: &Path, error: &io::Error| {
            let remedy = match error.kind() {
                io::ErrorKind::AlreadyExists => "; choose another name, keys are never replaced",
                io::ErrorKind::NotFound => "; make the directory first",
                _ => "",
            };
            let why = format!("`{}` cannot be written ({error}){remedy}", path.display());
            UpstreamError::Key { what: "name of the key", why }
        };
        let write = |path: &Path, mode: u32, text: &str| {
            let made = OpenOptions::new().write(true).create_new(true).mode(mode).open(path);
            made.and_then(|mut file| file.write_all(text.as_bytes())).map_err(|error| refused(path, &error))
        };
        let mut beside = path.as_os_str().to_owned();
        beside.push(".pub");
        let beside = PathBuf::from(beside);
        // A secret key without its public key would be of no use.
        if beside.symlink_metadata().is_ok() {
            return Err(refused(&beside, &io::ErrorKind::AlreadyExists.into()));
        }
        write(path, 0o600, &secret)?;
        write(&beside, 0o644, &format!("untrusted comment: tauflow public key\n{public}\n"))?;
        Ok((public, beside))
    }

    /// Reads a key from its file.
    ///
    /// # Errors
    /// When the file cannot be read, or has no secret key.
    pub fn read(path: &Path) -> Result<Self, UpstreamError> {
        let bytes = read_plain(path, MOST_BYTES).at("read the secret key", path)?;
        Self::parse(&String::from_utf8_lossy(&bytes))
    }

    fn parse(text: &str) -> Result<Self, UpstreamError> {
        let line = text.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or_default();
        let bytes = STANDARD.decode(line).unwrap_or_default();
        let read = || {
            let (id, pair) = bytes.strip_prefix(SECRET.as_slice())?.split_first_chunk::<8>()?;
            Some(Self { id: *id, pair: Ed25519KeyPair::from_pkcs8(pair).ok()? })
        };
        read().ok_or_else(|| UpstreamError::Key {
            what: "secret key",
            why: "its file was not written by `tauflow cache keygen FILE`".to_owned(),
        })
    }

    /// Its public key.
    ///
    /// # Errors
    /// Never for a key that was read or made.
    pub fn public(&self) -> Result<PublicKey, UpstreamError> {
        let bytes = [ALGORITHM.as_slice(), &self.id, self.pair.public_key().as_ref()].concat();
        STANDARD.encode(bytes).parse()
    }

    /// Signs a message. The comment is signed, too.
    pub(crate) fn sign(&self, message: &[u8], comment: &str) -> String {
        let signature = self.pair.sign(message);
        let both = [signature.as_ref(), comment.as_bytes()].concat();
        let line = STANDARD.encode([ALGORITHM.as_slice(), &self.id, signature.as_ref()].concat());
        let global = STANDARD.encode(self.pair.sign(&both));
        format!("untrusted comment: signature of tauflow\n{line}\ntrusted comment: {comment}\n{global}\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_is_of_one_key_and_one_message() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let make = |name: &str| {
            let path = folder.path().join(name);
            let (public, beside) = SecretKey::generate(&path).expect("writable");
            assert_eq!(
                PublicKey::given(&beside.display().to_string()).expect("its file").to_string(),
                public.to_string()
            );
            (SecretKey::read(&path).expect("its own file"), public)
        };
        let ((secret, public), (other, _)) = (make("a"), make("b"));
        assert!(public.to_string().starts_with("RW") && public.to_string().len() == 56, "{public}");
        let signature = secret.sign(b"message", "comment");
        assert!(public.verifies(b"message", signature.as_bytes()));
        assert!(!public.verifies(b"massage", signature.as_bytes()));
        assert!(!public.verifies(b"message", signature.replace("comment: comment", "comment: commend").as_bytes()));
        assert!(!public.verifies(b"message", other.sign(b"message", "comment").as_bytes()));
        assert!(!public.verifies(b"message", b"") && !public.verifies(b"message", &[255; 300]));
        // Nobody overwrites a key, and nobody else reads it.
        assert!(SecretKey::generate(&folder.path().join("a")).is_err());
        let mode = std::os::unix::fs::PermissionsExt::mode(
            &std::fs::metadata(folder.path().join("a")).expect("it is there").permissions(),
        );
        assert_eq!(mode & 0o777, 0o600);
        let beside = folder.path().join("a.pub");
        assert!(matches!(SecretKey::read(&beside), Err(UpstreamError::Key { .. })));
        assert!(matches!("RWxyz".parse::<PublicKey>(), Err(UpstreamError::Key { .. })));
    }

    /// A key and a signature that the program `minisign` made, as its documentation shows them.
    #[test]
    fn signatures_of_minisign_count() {
        let key = "RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3";
        let signature = "untrusted comment: signature from minisign secret key
RUQf6LRCGA9i559r3g7V1qNyJDApGip8MfqcadIgT9CuhV3EMhHoN1mGTkUidF/z7SrlQgXdy8ofjb7bNJJylDOocrCo8KLzZwo=
trusted comment: timestamp:1633700835\tfile:test\tprehashed
wLMDjy9FLAuxZ3q4NlEvkgtyhrr0gtTu6KC4KBJdITbbOeAi1zBIYo0v4iTgt8jJpIidRJnp94ABQkJAgAooBQ==";
        let key: PublicKey = key.parse().expect("it is one");
        assert!(key.verifies(b"test", signature.as_bytes()));
        assert!(!key.verifies(b"Test", signature.as_bytes()));
    }
}
