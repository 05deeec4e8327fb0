//! The Rust type of an artifact: its name, and how it is loaded, stored, exported and imported.
//!
//! A media type is declared once, by one type. Ports are constants with that type (see [`crate::Each`], [`crate::All`]
//! and [`crate::Out`]), so that a kind cannot read a wrong type.

use crate::{All, Artifact, Collection, Context, Digest, ItemKey, KindError, ReadFiles, WriteFiles};
use std::marker::PhantomData;

/// A media type.
///
/// `import` reads what `export` wrote, and stores an artifact of the same content: so programs outside can make
/// inputs of ours.
pub trait Media: Sized + 'static {
    /// Its name, e.g. `tauflow/ladder`.
    const NAME: &'static str;
    /// A line for people: what it holds, and what `export` writes.
    const DOC: &'static str;

    /// Loads the whole of it.
    ///
    /// # Errors
    /// If a blob is missing or is not what it should be.
    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError>;

    /// Stores it.
    ///
    /// # Errors
    /// If the store cannot be written, or the value is inconsistent.
    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError>;

    /// Writes it as files that other programs read.
    ///
    /// # Errors
    /// As [`Media::load`], and if a file cannot be written.
    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError>;

    /// Stores what files say that `export` wrote, or that were made alike.
    ///
    /// # Errors
    /// If a file is missing or is not what it should be; if the store cannot be written.
    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError>;
}

/// An artifact that is known to be of a media type, since the type itself made it or its name was checked.
#[derive(Debug)]
pub struct Stored<M> {
    artifact: Artifact,
    media: PhantomData<fn() -> M>,
}

impl<M> Clone for Stored<M> {
    fn clone(&self) -> Self {
        Self { artifact: self.artifact.clone(), media: PhantomData }
    }
}

impl<M: Media> Stored<M> {
    /// One blob.
    pub fn blob(digest: Digest) -> Self {
        Self { artifact: Artifact::blob(M::NAME, digest), media: PhantomData }
    }

    /// Named blobs.
    pub fn tree(parts: impl IntoIterator<Item = (String, Digest)>) -> Self {
        Self { artifact: Artifact::tree(M::NAME, parts), media: PhantomData }
    }

    /// The artifact.
    pub fn artifact(&self) -> &Artifact {
        &self.artifact
    }

    /// The artifact, taken.
    pub fn into_artifact(self) -> Artifact {
        self.artifact
    }

    /// As a handle.
    pub fn handle(&self) -> Handle<'_, M> {
        Handle { artifact: &self.artifact, media: PhantomData }
    }
}

/// An artifact on a port, not loaded yet.
#[derive(Debug)]
pub struct Handle<'a, M> {
    artifact: &'a Artifact,
    media: PhantomData<fn() -> M>,
}

impl<M> Clone for Handle<'_, M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Handle<'_, M> {}

impl<'a, M: Media> Handle<'a, M> {
    /// Takes an artifact for what its name says.
    ///
    /// # Errors
    /// [`KindError::Input`] if it is of another media type.
    pub fn new(artifact: &'a Artifact) -> Result<Self, KindError> {
        if artifact.media != M::NAME {
            return Err(KindError::Input(format!("found a `{}` instead of a `{}`", artifact.media, M::NAME)));
        }
        Ok(Self { artifact, media: PhantomData })
    }

    /// The artifact.
    pub fn artifact(self) -> &'a Artifact {
        self.artifact
    }

    /// Loads it.
    ///
    /// # Errors
    /// As [`Media::load`].
    pub fn load(self, ctx: &Context<'_>) -> Result<M, KindError> {
        M::load(ctx, self.artifact)
    }

    /// The same artifact, to be handed on.
    pub fn to_stored(self) -> Stored<M> {
        Stored { artifact: self.artifact.clone(), media: PhantomData }
    }
}

/// The items on a port that takes whole collections.
#[derive(Debug)]
pub struct Items<'a, M> {
    collection: &'a Collection,
    media: PhantomData<fn() -> M>,
}

impl<M> Clone for Items<'_, M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Items<'_, M> {}

impl<'a, M: Media> Items<'a, M> {
    /// Takes a collection for what the names of its items say.
    ///
    /// # Errors
    /// [`KindError::Input`] if an item is of another media type.
    pub fn new(collection: &'a Collection) -> Result<Self, KindError> {
        for (key, artifact) in collection.iter() {
            Handle::<M>::new(artifact).map_err(|error| KindError::Input(format!("item `{key}`: {error}")))?;
        }
        Ok(Self { collection, media: PhantomData })
    }

    /// The items in the order of their keys.
    pub fn iter(self) -> impl Iterator<Item = (&'a ItemKey, Handle<'a, M>)> {
        self.collection.iter().map(|(key, artifact)| (key, Handle { artifact, media: PhantomData }))
    }

    /// An item.
    pub fn get(self, key: &str) -> Option<Handle<'a, M>> {
        self.collection.get(key).map(|artifact| Handle { artifact, media: PhantomData })
    }

    /// The item of a key that the port `other` has, of items that came in by `port`.
    ///
    /// # Errors
    /// [`KindError::Input`] if there is none.
    pub fn need(self, port: All<M>, key: &ItemKey, other: &str) -> Result<Handle<'a, M>, KindError> {
        self.get(key.as_str()).ok_or_else(|| {
            let port = port.name();
            KindError::Input(format!("`{port}` lacks the item `{key}` of `{other}`; connect the same items"))
        })
    }

    /// How many.
    pub fn len(self) -> usize {
        self.collection.len()
    }

    /// True if there is none.
    pub fn is_empty(self) -> bool {
        self.collection.is_empty()
    }

    /// Content digest of the collection.
    pub fn digest(self) -> Digest {
        self.collection.digest()
    }
}

/// Stands for any media type, on ports that only wait for what they are given.
#[derive(Clone, Copy, Debug)]
pub enum Any {}

impl Any {
    /// The media type of such a port.
    pub const NAME: &'static str = "*";
}

/// Row of the table of media types: a [`Media`] type without its type.
#[derive(Clone, Copy)]
pub struct MediaRow {
    /// [`Media::NAME`].
    pub name: &'static str,
    /// [`Media::DOC`].
    pub doc: &'static str,
    /// [`Media::export`].
    pub export: fn(&Context<'_>, &Artifact, &mut dyn WriteFiles) -> Result<(), KindError>,
    /// [`Media::import`].
    pub import: fn(&Context<'_>, &dyn ReadFiles) -> Result<Artifact, KindError>,
}

impl MediaRow {
    /// The row of a type.
    pub const fn of<M: Media>() -> Self {
        Self {
            name: M::NAME,
            doc: M::DOC,
            export: M::export,
            import: |ctx, from| Ok(M::import(ctx, from)?.into_artifact()),
        }
    }
}

impl std::fmt::Debug for MediaRow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("MediaRow").field(&self.name).finish()
    }
}

/// File that holds a record of one JSON blob.
pub const RECORD_FILE: &str = "value.json";

/// Makes media types of records: values that are one JSON blob. The files are the same JSON, set out for people.
#[macro_export]
macro_rules! json_media {
    ($($type:ty, $name:literal, $doc:literal;)+) => {$(
        impl $crate::Media for $type {
            const NAME: &'static str = $name;
            const DOC: &'static str = $doc;

            fn load(ctx: &$crate::Context<'_>, artifact: &$crate::Artifact) -> Result<Self, $crate::KindError> {
                ctx.json(artifact, "")
            }

            fn store(&self, ctx: &$crate::Context<'_>) -> Result<$crate::Stored<Self>, $crate::KindError> {
                Ok($crate::Stored::blob(ctx.put_json(self)?))
            }

            fn export(
                ctx: &$crate::Context<'_>,
                artifact: &$crate::Artifact,
                to: &mut dyn $crate::WriteFiles,
            ) -> Result<(), $crate::KindError> {
                to.put($crate::RECORD_FILE, &$crate::pretty_json(&Self::load(ctx, artifact)?)?)
            }

            fn import(
                ctx: &$crate::Context<'_>,
                from: &dyn $crate::ReadFiles,
            ) -> Result<$crate::Stored<Self>, $crate::KindError> {
                $crate::parse_json::<Self>($crate::RECORD_FILE, &from.need($crate::RECORD_FILE)?)?.store(ctx)
            }
        }
    )+};
}

/// JSON set out for people, with a line feed at the end.
///
/// # Errors
/// [`KindError::Internal`] if the value cannot be JSON.
pub fn pretty_json<T: serde::Serialize>(value: &T) -> Result<Vec<u8>, KindError> {
    let mut text =
        serde_json::to_vec_pretty(value).map_err(|e| KindError::Internal(format!("cannot write JSON: {e}")))?;
    text.push(b'\n');
    Ok(text)
}

/// The value of a JSON file.
///
/// # Errors
/// [`KindError::Input`] with the file's name, and the line and column that is wrong.
pub fn parse_json<T: serde::de::DeserializeOwned>(file: &str, bytes: &[u8]) -> Result<T, KindError> {
    serde_json::from_slice(bytes).map_err(|e| KindError::Input(format!("`{file}`: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FileTree, Files, MemoryBlobs, Silent};
    use serde::{Deserialize, Serialize};
    use std::sync::atomic::AtomicBool;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Note {
        text: String,
    }
    json_media! { Note, "test/note", "A note."; }

    #[test]
    fn records_come_back_from_what_export_wrote() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let stored = Note { text: "a".into() }.store(&ctx).expect("in memory");
        let mut tree = FileTree::new();
        Note::export(&ctx, stored.artifact(), &mut tree).expect("whole");
        assert_eq!(tree[RECORD_FILE], b"{\n  \"text\": \"a\"\n}\n");
        assert_eq!(Note::import(&ctx, &tree).expect("own files").artifact(), stored.artifact());
        let gone = Note::import(&ctx, &FileTree::new()).expect_err("no file");
        assert!(gone.to_string().contains("`value.json`"), "{gone}");
    }

    #[test]
    fn an_artifact_of_another_type_is_refused() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let files = Files::default().store(&ctx).expect("in memory").into_artifact();
        let error = Handle::<Note>::new(&files).expect_err("another type");
        assert!(error.to_string().contains("tauflow/files") && error.to_string().contains("test/note"), "{error}");
        let key = ItemKey::new("k").expect("plain");
        let collection: Collection = [(key, files)].into_iter().collect();
        assert!(Items::<Note>::new(&collection).is_err());
        let items = Items::<Files>::new(&collection).expect("files");
        assert_eq!(items.len(), 1);
        const PORT: All<Files> = All::new("pages", "Pages.");
        let [there, missing] = ["k", "l"].map(|key| ItemKey::new(key).expect("plain"));
        assert_eq!(items.need(PORT, &there, "notes").expect("there").artifact(), collection.get("k").expect("there"));
        let told = items.need(PORT, &missing, "notes").expect_err("missing").to_string();
        assert!(["`pages`", "`l`", "`notes`"].iter().all(|name| told.contains(name)), "{told}");
    }
}
