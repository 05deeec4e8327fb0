//! Object stores in a program that is built without them: none can be opened.

use crate::{
    UpstreamError,
    address::ObjectsAt,
    error::Failure,
    traffic::{Reads, Traffic},
};
use std::{ops::Range, path::Path};
use tauflow_cache::Digest;

/// No value of this type exists.
#[derive(Debug)]
pub(crate) enum Objects {}

impl Objects {
    /// Says how to build a program with object stores.
    ///
    /// # Errors
    /// Always.
    pub fn new(at: &ObjectsAt) -> Result<Self, UpstreamError> {
        Err(UpstreamError::Address {
            why: format!(
                "`{at}` is an object store or web server, and this program was built without the feature \
                 `objects`; build it with `cargo build --release`, which has it"
            ),
        })
    }

    pub fn at(&self) -> &ObjectsAt {
        match *self {}
    }

    pub fn traffic(&self) -> Traffic {
        match *self {}
    }

    pub fn is_web(&self) -> bool {
        match *self {}
    }

    pub fn url(&self, _: &str) -> String {
        match *self {}
    }

    pub fn small(&self, _: &str) -> Result<Option<Vec<u8>>, UpstreamError> {
        match *self {}
    }

    pub fn names(&self) -> Result<Vec<String>, UpstreamError> {
        match *self {}
    }

    pub fn packs(&self) -> Result<Vec<(String, u64)>, UpstreamError> {
        match *self {}
    }

    pub fn whole(&self, _: &str) -> Result<Vec<u8>, Failure> {
        match *self {}
    }

    pub fn read(&self, _: &Digest, _: &Reads, _: Range<u64>, _: Option<&Path>) -> Result<Vec<u8>, Failure> {
        match *self {}
    }

    pub fn seal(&self, _: &str, _: Vec<Vec<u8>>) -> Result<(), UpstreamError> {
        match *self {}
    }

    pub fn replace(&self, _: &str, _: Vec<u8>) -> Result<(), UpstreamError> {
        match *self {}
    }

    pub fn delete(&self, _: &str) {
        match *self {}
    }
}
