//! Directories to which artifacts are exported, and the media type of plain file trees.

use crate::{Artifact, Context, Digest, ItemKey, KindError, Media, Stored};
use std::collections::BTreeMap;

/// A folder that is being written. Names are relative, with `/` between folders.
pub trait WriteFiles {
    /// Writes a file.
    ///
    /// # Errors
    /// If it cannot be written.
    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), KindError>;

    /// How images are to be written whose radiance may be exposed.
    fn radiance(&self) -> Radiance {
        Radiance::default()
    }
}

/// How images are written whose radiance may be exposed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Radiance {
    /// The factor that raw radiance is multiplied by to be exposed, if it is known.
    pub exposure: Option<f64>,
    /// True writes raw radiance, whatever the images hold.
    pub raw: bool,
}

/// A folder that is being read. Names are relative, with `/` between folders.
pub trait ReadFiles {
    /// The names of all files, sorted.
    ///
    /// # Errors
    /// If the folder cannot be listed.
    fn names(&self) -> Result<Vec<String>, KindError>;

    /// The bytes of a file; `None` if it is not there.
    ///
    /// # Errors
    /// If it is there and cannot be read.
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, KindError>;

    /// The bytes of a file that must be there.
    ///
    /// # Errors
    /// If it is not there, or cannot be read.
    fn need(&self, name: &str) -> Result<Vec<u8>, KindError> {
        self.get(name)?
            .ok_or_else(|| KindError::Input(format!("missing file `{name}`; `export` writes the expected files")))
    }
}

/// A folder in memory.
pub type FileTree = BTreeMap<String, Vec<u8>>;

impl WriteFiles for FileTree {
    fn put(&mut self, name: &str, bytes: &[u8]) -> Result<(), KindError> {
        self.insert(name.to_owned(), bytes.to_vec());
        Ok(())
    }
}

impl ReadFiles for FileTree {
    fn names(&self) -> Result<Vec<String>, KindError> {
        Ok(self.keys().cloned().collect())
    }

    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, KindError> {
        Ok(BTreeMap::get(self, name).cloned())
    }
}

/// A tree of files: pages and pictures for people, or what a source reads from outside.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Files(pub FileTree);

impl Media for Files {
    const NAME: &'static str = "tauflow/files";
    const DOC: &'static str = "A tree of files; exported as they are.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let file = |(name, digest): (&String, &Digest)| Ok((name.clone(), ctx.get(digest)?));
        Ok(Self(artifact.parts.iter().map(file).collect::<Result<_, KindError>>()?))
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let part = |(name, bytes): (&String, &Vec<u8>)| Ok((name.clone(), ctx.put(bytes)?));
        Ok(Stored::tree(self.0.iter().map(part).collect::<Result<Vec<_>, KindError>>()?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        artifact.parts.iter().try_for_each(|(name, digest)| to.put(name, &ctx.get(digest)?))
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let part = |name: String| {
            // A part's name is a path below the folder that it is written to.
            ItemKey::new(name.as_str()).map_err(|error| KindError::Input(error.to_string()))?;
            Ok((name.clone(), ctx.put(&from.need(&name)?)?))
        };
        Ok(Stored::tree(from.names()?.into_iter().map(part).collect::<Result<Vec<_>, KindError>>()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MemoryBlobs, Silent};
    use std::sync::atomic::AtomicBool;

    #[test]
    fn files_come_back_from_what_export_wrote() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let files = Files(FileTree::from([("a/b.txt".into(), b"1".to_vec()), ("c".into(), Vec::new())]));
        let stored = files.store(&ctx).expect("in memory");
        assert_eq!(stored.handle().load(&ctx).expect("whole"), files);
        assert_eq!(Files::import(&ctx, &files.0).expect("own files").artifact(), stored.artifact());
        let outside = FileTree::from([("../a".into(), Vec::new())]);
        assert!(Files::import(&ctx, &outside).is_err(), "a name that leads out of the folder");
    }
}
